# SPDX-License-Identifier: Apache-2.0
"""Every refusal of the package: a reason code for programs, a message for people."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rpgd_ros.core.result import Calibration


class Reason(StrEnum):
    """Why something was refused: stable codes, for services, logs and exit paths."""

    # The data do not determine a pose that anybody should use.
    NO_DATA = 'no_data'
    TOO_FEW_POINTS = 'too_few_points'
    TOO_FEW_FRAMES = 'too_few_frames'
    TOO_FEW_INLIERS = 'too_few_inliers'
    DEGENERATE_MOTION = 'degenerate_motion'
    DEGENERATE_GEOMETRY = 'degenerate_geometry'
    AMBIGUOUS = 'ambiguous'
    UNCERTAIN = 'uncertain'
    WRONG_UNIT = 'wrong_unit'
    MIRRORED_AXES = 'mirrored_axes'
    SWAPPED_LABELS = 'swapped_labels'
    NO_EXTRINSICS = 'no_extrinsics'
    JUMP = 'jump'
    # The run was ended from outside.
    CANCELLED = 'cancelled'
    BUSY = 'busy'
    # What came in cannot be read.
    BAD_INPUT = 'bad_input'
    BAD_RIG = 'bad_rig'
    BAD_BAG = 'bad_bag'
    BAD_MESSAGE = 'bad_message'
    BAD_PARAMETER = 'bad_parameter'
    BAD_RESULT_FILE = 'bad_result_file'
    MISSING_TOPIC = 'missing_topic'
    MISSING_INTRINSICS = 'missing_intrinsics'
    UNKNOWN_CAMERA = 'unknown_camera'
    NOT_WRITABLE = 'not_writable'


class RpgdError(Exception):
    """Root of the package's errors.

    Attributes:
        reason: Stable code.
        message: What was found, what was needed, what to do.

    """

    def __init__(self, reason: Reason, message: str) -> None:
        """Join code and message, so that a bare `str(error)` says both."""
        super().__init__(f'{reason}: {message}')
        self.reason = reason
        self.message = message


class InputError(RpgdError):
    """A file, message, parameter or array that cannot be used as it is."""


class CalibrationError(RpgdError):
    """The solve ended without a pose that anybody should use.

    Attributes:
        calibration: The refused result where there is one, for a look at its sigma only.

    """

    def __init__(
        self, reason: Reason, message: str, *, calibration: Calibration | None = None
    ) -> None:
        """Keep the refused result beside the reason."""
        super().__init__(reason, message)
        self.calibration = calibration
