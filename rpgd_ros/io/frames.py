# SPDX-License-Identifier: Apache-2.0
"""The names of the frames that a result speaks of."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

NONE: Final[Mapping[str, str]] = MappingProxyType({})


class Frames(NamedTuple):
    """Names as TF has them.

    Attributes:
        world: Parent frame of the transform.
        mocap: Its child frame.
        optical: Optical frame by camera, where it is not `<camera>_optical_frame`.

    """

    world: str
    mocap: str
    optical: Mapping[str, str] = NONE

    def optical_frame(self, camera: str) -> str:
        """Return the name of a camera's optical frame."""
        return self.optical.get(camera, f'{camera}_optical_frame')
