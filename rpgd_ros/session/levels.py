# SPDX-License-Identifier: Apache-2.0
"""How a camera fits a pose, as robust running figures, and how it did when that was accepted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import Array, IntArray, RigidTransform
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.observations import NS_PER_S, View
from rpgd_ros.io.result_file import StoredLevel, StoredResult

WINDOW_S = 4.0  # of the running medians: several steps, so that a pose of the body averages out
MIN_FRAMES = 8  # of a window that says anything: detectors run at 2 Hz and faster
MIN_JOINTS = 3  # of a frame that says anything

# Room above the accepted level. Over clean simulated walks the figures fill half of it with an
# unbiased detector, and just about all of it where joints lie 2 to 3 cm from the MoCap's; what is
# found all the same is tabled in docs/watch.md.
LEAST_EXCESS_PX = 1.0  # smaller than what anybody would calibrate again for
EXCESS_SHARE = 0.5  # of the level
SPREADS = 6.0  # of the windows of the accepted recording, robust standard deviations
SHIFT_SHARE = 0.5  # of the level that the whole body may be shifted in the image
ERROR_BIASES = 4.0  # of what lasting offsets of single joints do to the figures of all
SHIFT_BIASES = 6.0
KEPT_BIAS = 0.25  # of an error, where twelve joints have nothing but lasting offsets
CREEP = 1.25  # of the level that automatic calibrations may add without anybody looking


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """How a camera fits a pose.

    Attributes:
        error_px: Median over time of the running error, pixels.
        spread_px: Robust standard deviation of that from window to window.
        shift_px: (2,) running shift of the whole body in the image, pixels.
        shift_spread_px: Robust standard deviation of that.
        bias_px: How far lasting offsets of single joints shift the whole body by chance, pixels.
            They turn with the body, and the shift with them.
        is_kept: Whether it is of a result file, see `kept`.

    """

    error_px: float
    spread_px: float = 0.0
    shift_px: Array = field(default_factory=lambda: np.zeros(2))
    shift_spread_px: float = 0.0
    bias_px: float = 0.0
    is_kept: bool = False

    @classmethod
    def kept(cls, error_px: float) -> Level:
        """Return the level of a result file, which tells the error alone.

        For all that is known it is all of offsets of joints that last.
        """
        return cls(error_px, bias_px=KEPT_BIAS * error_px, is_kept=True)

    @classmethod
    def of_stored(cls, stored: StoredLevel) -> Level:
        """Return the level that a result file tells in full."""
        return cls(
            stored.error_px,
            stored.spread_px,
            np.array(stored.shift_px),
            stored.shift_spread_px,
            stored.bias_px,
        )

    @property
    def stored(self) -> StoredLevel:
        """What a result file says of it."""
        du, dv = (float(value) for value in self.shift_px)
        return StoredLevel(
            self.error_px, self.spread_px, (du, dv), self.shift_spread_px, self.bias_px
        )

    def follows(self, anchor: Level) -> bool:
        """Whether it is no worse than a level that somebody has accepted."""
        return self.error_px <= CREEP * anchor.error_px

    @property
    def limit_px(self) -> float:
        """Error that is too much, pixels."""
        room = max(
            LEAST_EXCESS_PX,
            EXCESS_SHARE * self.error_px,
            SPREADS * self.spread_px,
            ERROR_BIASES * self.bias_px,
        )
        return self.error_px + room

    @property
    def shift_limit_px(self) -> float:
        """Change of the shift that is too much, pixels."""
        return max(
            LEAST_EXCESS_PX,
            SHIFT_SHARE * self.error_px,
            SPREADS * self.shift_spread_px,
            SHIFT_BIASES * self.bias_px,
        )

    def strain(self, running: Running) -> float:
        """Return by how much of the room above the level it is exceeded: 1 at the limit."""
        error = (running.error_px - self.error_px) / (self.limit_px - self.error_px)
        shift = float(np.linalg.norm(running.shift_px - self.shift_px)) / self.shift_limit_px
        return max(error, shift)


@dataclass(frozen=True, slots=True, eq=False)
class Running:
    """How a camera fits a pose over some seconds.

    Attributes:
        error_px: Median residual, pixels.
        shift_px: (2,) median residual vector, pixels.

    """

    error_px: float
    shift_px: Array


def per_frame(
    camera: Camera, view: View, world_T_mocap: RigidTransform
) -> tuple[IntArray, Array, Array]:
    """Return stamps (n,), median residual (n,) and residual vector (n, 2) of each telling frame.

    Keypoint minus reprojection, pixels.
    """
    apart = _apart(camera, view, world_T_mocap)
    error = _medians(np.linalg.norm(apart, axis=-1))
    shift = _shifts(apart)
    tells = np.isfinite(error)
    return view.known_stamp_ns[tells], error[tells], shift[tells]


def levels(sights: Sequence[Sight], world_T_mocap: RigidTransform) -> dict[str, Level]:
    """Return how cameras fit a pose over a recording, for each that has seen enough."""
    found = {}
    for sight in sights:
        seen = windows(sight, world_T_mocap)
        if seen:
            found[sight.camera.name] = _level([w.running for w in seen], [w.bias_px for w in seen])
    return found


class Window(NamedTuple):
    """A few seconds of one camera.

    Attributes:
        begin_ns: When they began.
        running: How the camera fitted.
        bias_px: See `Level`.

    """

    begin_ns: int
    running: Running
    bias_px: float


def windows(sight: Sight, world_T_mocap: RigidTransform) -> list[Window]:
    """Return how a camera fits a pose, window by window, where it has seen enough."""
    stamp_ns = sight.view.known_stamp_ns
    length_ns = round(WINDOW_S * NS_PER_S)
    number = (stamp_ns - stamp_ns[:1]) // length_ns
    found = []
    for n in np.unique(number):
        part = sight.at_frames(np.flatnonzero(number == n))
        _, error_px, shift_px = per_frame(part.camera, part.view, world_T_mocap)
        running = running_of(error_px, shift_px)
        if running is not None:
            bias_px = _bias_px(_apart(part.camera, part.view, world_T_mocap))
            begin_ns = int(stamp_ns[0]) + int(n) * length_ns
            found.append(Window(begin_ns, running, bias_px))
    return found


def agreed(levels: Mapping[str, Level], moved: Sequence[str]) -> dict[str, Level]:
    """Give cameras that contradict the pose the level of the others: they do not fit it.

    Args:
        levels: By camera.
        moved: Cameras that contradict the pose.

    """
    fitting = [level.error_px for name, level in levels.items() if name not in moved]
    if not fitting:
        return dict(levels)
    usual = Level(float(np.median(fitting)))
    return {
        name: capped(level, usual) if name in moved else level for name, level in levels.items()
    }


def stored_levels(stored: StoredResult) -> dict[str, Level]:
    """Return how cameras fitted the pose of a result file; older ones tell the error alone."""
    kept = {
        name: Level.kept(error_px)
        for name, error_px in stored.camera_mpjpe_px.items()
        if error_px > 0.0  # false for NaN: it saw nothing
    }
    return kept | {name: Level.of_stored(level) for name, level in stored.found.levels.items()}


def running_of(error_px: Array, shift_px: Array) -> Running | None:
    """Return the medians of a window of frames (n,), (n, 2); None where there are too few."""
    if len(error_px) < MIN_FRAMES:
        return None
    return Running(float(np.median(error_px)), np.median(shift_px, axis=0))


def _level(windows: Sequence[Running], biases: Sequence[float]) -> Level:
    error = np.array([w.error_px for w in windows])
    shift = np.array([w.shift_px for w in windows])
    middle = np.median(shift, axis=0)
    return Level(
        float(np.median(error)),
        _spread(error - np.median(error)),
        middle,
        _spread(np.linalg.norm(shift - middle, axis=1)),
        float(np.median(biases)),
    )


def _apart(camera: Camera, view: View, world_T_mocap: RigidTransform) -> Array:
    """Return keypoint minus reprojection (F, J, 2), pixels; NaN = missing."""
    x = np.where(view.seen()[..., None], view.x_mocap, np.nan)
    with np.errstate(invalid='ignore', over='ignore'):
        return view.uv - camera.project(world_T_mocap @ x)


def _shifts(apart: Array) -> Array:
    """Return the median over the joints (n, J, 2) of each row: (n, 2)."""
    return np.stack([_medians(apart[..., 0]), _medians(apart[..., 1])], -1)


def _bias_px(apart: Array) -> float:
    """Return by how much the offsets of J joints that last for a window shift their median."""
    there = np.isfinite(apart[..., 0])
    apart = apart[:, there.sum(0) >= MIN_FRAMES]
    if apart.shape[1] < MIN_JOINTS:
        return 0.0
    lasting = _shifts(apart.transpose(1, 0, 2))
    spread = _spread(lasting - np.median(lasting, axis=0))
    # Of a median over n, which is a quarter less exact than a mean.
    return 1.25 * spread / math.sqrt(len(lasting))


def _spread(apart: Array) -> float:
    """Robust standard deviation of differences to a median."""
    return 1.4826 * float(np.median(np.abs(apart)))


def capped(level: Level, anchor: Level) -> Level:
    """Keep a level within what somebody has accepted, and the shift that belonged to it.

    A drift that automatic calibrations follow step by step would else be seen by nobody.
    """
    if level.follows(anchor):
        return Level(
            level.error_px, max(level.spread_px, anchor.spread_px), anchor.shift_px,
            max(level.shift_spread_px, anchor.shift_spread_px), max(level.bias_px, anchor.bias_px),
        )  # fmt: skip
    return replace(anchor, error_px=CREEP * anchor.error_px)


def _medians(values: Array) -> Array:
    """Median of each row (n, J) over what is there; NaN where that is too little."""
    ordered = np.sort(values, axis=1)  # NaN comes last
    count = np.isfinite(ordered).sum(1)
    rows = np.arange(len(ordered))
    low, high = np.maximum(count - 1, 0) // 2, count // 2
    middle = 0.5 * (ordered[rows, low] + ordered[rows, np.minimum(high, values.shape[1] - 1)])
    return np.where(count >= MIN_JOINTS, middle, np.nan)
