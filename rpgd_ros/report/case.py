# SPDX-License-Identifier: Apache-2.0
"""What a report is about: a recording, what was found in it, or why nothing was."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpgd_ros.core import Camera, Observations
from rpgd_ros.core.errors import CalibrationError
from rpgd_ros.core.result import Calibration


class StreamCount(NamedTuple):
    """What became of the messages of one stream.

    Attributes:
        stream: `mocap`, or the camera's name.
        topic: Where they came.
        received: How many.
        kept: How many could be used.
        paired: How many met a skeleton; None for the MoCap itself.
        dropped: Messages that were not kept, and joints that were missing, by reason.

    """

    stream: str
    topic: str
    received: int
    kept: int
    paired: int | None
    dropped: Mapping[str, int]


class Step(NamedTuple):
    """The result of a part of the recording, from its beginning.

    Attributes:
        seconds: Length of the part; frames where no time is known.
        apart_deg: Rotation between it and the whole.
        apart_m: Distance between it and the whole, at the body's centroid.
        sigma_deg: Standard deviation of the rotation that it reports.
        sigma_m: The same of the position.

    """

    seconds: float
    apart_deg: float
    apart_m: float
    sigma_deg: float
    sigma_m: float


class Photo(NamedTuple):
    """An image of a camera.

    Attributes:
        frame: Number of the instant in the camera's view.
        image: (height, width, 3) blue, green, red.

    """

    frame: int
    image: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Case:
    """One run, for a report.

    Attributes:
        name: Of the recording.
        world_frame: Parent frame.
        mocap_frame: Child frame.
        stamp_ns: When the run ended, since 1970.
        cameras: One per view.
        observations: What the solve was given, at the clock offsets that it found; None where
            nothing came together.
        calibration: What was found, refused or not; None where a run ended before.
        refusal: Why nobody should use it; None = accepted.
        moved_m: Distance that the body covered, metres; NaN where unknown.
        streams: What came in.
        notes: Sentences for people beyond the warnings of the calibration.
        photos: Images by camera, where there are any.
        steps: How the result settles with the length of the recording.

    """

    name: str
    world_frame: str
    mocap_frame: str
    stamp_ns: int
    cameras: tuple[Camera, ...] = ()
    observations: Observations | None = None
    calibration: Calibration | None = None
    refusal: CalibrationError | None = None
    moved_m: float = float('nan')
    streams: tuple[StreamCount, ...] = ()
    notes: tuple[str, ...] = ()
    photos: Mapping[str, tuple[Photo, ...]] = field(default_factory=dict)
    steps: tuple[Step, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences for people, each once."""
        found = self.calibration.warnings if self.calibration else ()
        return tuple(dict.fromkeys((*self.notes, *found)))
