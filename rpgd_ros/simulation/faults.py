# SPDX-License-Identifier: Apache-2.0
"""What goes wrong in a recording beyond what its preset always has."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.simulation.detector import Corruption

BiasFrame = Literal['heading', 'bone']
BIAS_FRAMES: tuple[BiasFrame, ...] = get_args(BiasFrame)


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong in a recording beyond the preset.

    Attributes:
        corruption: Of the detections.
        bias_m: Standard deviation per axis of the offset between what the MoCap system and the
            detector call a joint, metres; each joint keeps its offset.
        bias_frame: In which frame it keeps it: the body's heading, or the bone.
        lag_s: How late the video is stamped, seconds; one for all cameras, or one each. MoCap
            time = video stamp - lag.

    Raises:
        InputError: A negative bias, an unknown frame.

    """

    corruption: Corruption = field(default_factory=Corruption)
    bias_m: float = 0.0
    bias_frame: BiasFrame = 'heading'
    lag_s: float | tuple[float, ...] = 0.0

    def __post_init__(self) -> None:
        """Check at the border; lags are checked against the cameras."""
        if not 0.0 <= self.bias_m < np.inf:
            msg = f'the bias must be 0 or more metres, got {self.bias_m}'
            raise InputError(Reason.BAD_INPUT, msg)
        if self.bias_frame not in BIAS_FRAMES:
            msg = f'unknown frame of the bias {self.bias_frame!r}; known: {", ".join(BIAS_FRAMES)}'
            raise InputError(Reason.BAD_INPUT, msg)
