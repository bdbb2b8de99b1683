# SPDX-License-Identifier: Apache-2.0
"""Whether the skeletons are those of a person in metres, and how far the person walked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from rpgd_ros.core.errors import CalibrationError, Reason
from rpgd_ros.core.geometry import Array, BoolArray
from rpgd_ros.core.thin import at_seen_frames

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.linearise import Sight

# A person: 0.5 m crouching child to 2.5 m arms up. Nothing that is worn or held makes it 5 m.
LARGEST_BODY_M = 5.0
SMALLEST_BODY_M = 0.05
UNITS_PER_M = {'millimetres': 1000.0, 'centimetres': 100.0, 'inches': 39.37}
TYPICAL_BODY_M = 1.5  # diagonal of the joints' bounding box: 1.2 sitting to 2 walking
BODY_FRAMES, BODY_FRAMES_PER_CAMERA = 200, 20  # looked at for size and motion: 10 a second of walk
STRAY = 20.0  # times the median distance from the middle: a marker gone wild, not a walk
LINE_RATIO = 1e-3  # second over first extent of the points: a line, up to rounding and noise


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A look at some of the skeletons.

    Attributes:
        joints: By camera, (n, J, 3) metres; NaN where no correspondence is.

    """

    joints: tuple[Array, ...]

    @classmethod
    def of(cls, sights: Sequence[Sight]) -> Self:
        """Take frames of all cameras, spread over those in which somebody is in view."""
        return cls(tuple(_sampled_joints(s, len(sights)) for s in sights))

    @property
    def centre(self) -> Array:
        """(3,) of the observed joints, metres."""
        x = np.concatenate([x.reshape(-1, 3) for x in self.joints])
        centre: Array = np.median(x[_finite(x)], axis=0)
        return centre

    @property
    def motion_m(self) -> float:
        """Distance that the body covered: diagonal of the box that holds its centre, metres."""
        centres = []
        for x in self.joints:
            there = _finite(x)
            rows = there.sum(1) >= max(1, 0.5 * there.sum(1).max(initial=0))
            if rows.any():
                centres.append(np.nanmean(np.where(there[..., None], x, np.nan)[rows], 1))
        if not centres:
            return 0.0
        low, high = np.quantile(np.concatenate(centres), [0.02, 0.98], axis=0)
        return float(np.linalg.norm(high - low))

    def check(self) -> None:
        """Refuse skeletons that are not of a person in metres, or lie on a line.

        Raises:
            CalibrationError: NO_DATA, TOO_FEW_POINTS, WRONG_UNIT, DEGENERATE_GEOMETRY.

        """
        x = np.concatenate(self.joints)
        there = _finite(x)
        if not there.any():
            msg = 'no correspondence: no joint was seen by MoCap and camera at the same time'
            raise CalibrationError(Reason.NO_DATA, msg)
        if there.sum() < 6:
            msg = f'{there.sum()} correspondences, need at least 6'
            raise CalibrationError(Reason.TOO_FEW_POINTS, msg)
        _check_size(x)
        points = x[there] - np.median(x[there], axis=0)
        reach = np.linalg.norm(points, axis=1)
        points = points[reach <= STRAY * np.median(reach)]
        extent = np.sqrt(np.maximum(np.linalg.eigvalsh(points.T @ points)[::-1], 0.0))
        if extent[1] < LINE_RATIO * extent[0] or extent[0] == 0.0:
            shape = 'point' if extent[0] < 1e-9 else 'line'
            msg = (
                f'all joints lie on one {shape} for the whole recording: the pose is not '
                'determined. Check the joint map and that the skeleton moves'
            )
            raise CalibrationError(Reason.DEGENERATE_GEOMETRY, msg)


def _sampled_joints(sight: Sight, n_cameras: int) -> Array:
    """(m, J, 3) joints of this camera's part of some frames, NaN where no correspondence is."""
    wanted = max(BODY_FRAMES // n_cameras, BODY_FRAMES_PER_CAMERA)
    view = at_seen_frames(sight, wanted).view
    return np.where(view.seen()[..., None], view.x_mocap, np.nan)


def _finite(x: Array) -> BoolArray:
    """Whether points (..., 3) are there."""
    there: BoolArray = np.isfinite(x.sum(-1))
    return there


def _check_size(x: Array) -> None:
    there = _finite(x)
    whole = there.sum(1) >= 0.5 * there.sum(1).max()
    low = np.where(there[..., None], x, np.inf)[whole].min(1)
    high = np.where(there[..., None], x, -np.inf)[whole].max(1)
    size = float(np.median(np.linalg.norm(high - low, axis=-1)))
    if SMALLEST_BODY_M <= size <= LARGEST_BODY_M or x.shape[1] < 3 or size == 0.0:
        return
    unit = min(UNITS_PER_M, key=lambda u: abs(np.log(size / (TYPICAL_BODY_M * UNITS_PER_M[u]))))
    guess = (
        f'looks like {unit}: set `mocap.units`' if size > LARGEST_BODY_M else 'check `mocap.units`'
    )
    msg = f'the skeleton spans {size:.4g} m, a person 0.5 to 2.5 m; {guess}'
    raise CalibrationError(Reason.WRONG_UNIT, msg)
