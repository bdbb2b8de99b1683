# SPDX-License-Identifier: Apache-2.0
"""What the writers of `calibrate_bag` share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from rpgd_ros.apps.bag_images import BagImages, find_images
from rpgd_ros.apps.bag_run import BagRun
from rpgd_ros.core.errors import InputError, Reason


class Written(NamedTuple):
    """A file that a run left.

    Attributes:
        what: Key of the option that asked for it.
        path: Where.

    """

    what: str
    path: Path


@dataclass(eq=False)
class Outputs:
    """What became of the outputs of a run, also where it ends before its time.

    Attributes:
        written: What is whole, in its order.
        begun: What is being written, None = nothing.

    """

    written: list[Written] = field(default_factory=list)
    begun: Path | None = None

    def sentence(self) -> str:
        """Say what is left of a run that was stopped."""
        paths = ', '.join(str(one.path) for one in self.written)
        said = [f'written before: {paths}'] if paths else []
        # Files come whole or not at all; pictures in a folder come one by one.
        if self.begun is not None and self.begun.is_dir():
            said.append(f'{self.begun} may hold a part')
        return '; '.join(said) or 'nothing was written'


@dataclass(frozen=True, eq=False)
class Job:
    """What all writers are given.

    Attributes:
        run: The run.
        given: `camera=topic` of images.
        progress: Told the stage and the share done.
        warn: Told what a person should know.

    """

    run: BagRun
    given: Sequence[str]
    progress: Callable[[str, float], None]
    warn: Callable[[str], None]

    @cached_property
    def images(self) -> BagImages:
        """The images of the recording."""
        return find_images(self.run, self.given)


def make_folder(folder: Path) -> None:
    """Make a folder that may be there already.

    Raises:
        InputError: NOT_WRITABLE.

    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        msg = f'{folder} cannot be made: {error.strerror or error}'
        raise InputError(Reason.NOT_WRITABLE, msg) from error
