# SPDX-License-Identifier: Apache-2.0
"""Keeps watch over an accepted pose: which camera no longer fits it as it did.

Of each camera the error of the pose runs along: a median over the joints of each frame, then over
the frames of a few seconds. No outlier moves it, and a detector that fails now and then does not
either. It is compared with what it was when the pose was accepted. A camera that exceeds it for a
while is named; it has to fit again for longer before that is taken back.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import Array, IntArray, RigidTransform
from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.session.levels import WINDOW_S, Level, Running, capped, per_frame, running_of
from rpgd_ros.session.recent import Pairs

RAISE_S = 2.0  # that a camera must be over its limit. With half a window: named within 5 s
CLEAR_S = 5.0  # that it must fit again
STALE_S = 20.0  # a camera that sees nobody for so long is judged afresh

HYSTERESIS = 0.6  # of the room above the level: below it a camera fits again
MOVED_SHARE = 0.6  # of the error that is one common shift where a camera was moved


@dataclass(frozen=True, slots=True)
class CameraState:
    """What is to be said of one camera.

    Attributes:
        error_px: Its running error, pixels; NaN where it has seen too little.
        level_px: That at acceptance; NaN where it is not known.
        is_raised: Whether it no longer fits.
        complaint: Sentence; '' where it fits.

    """

    error_px: float
    level_px: float
    is_raised: bool
    complaint: str


@dataclass(slots=True, eq=False)
class _Track:
    """The last seconds of one camera."""

    camera: Camera
    stamp_ns: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    error_px: Array = field(default_factory=lambda: np.empty(0))
    shift_px: Array = field(default_factory=lambda: np.empty((0, 2)))
    over_since_ns: int | None = None
    under_since_ns: int | None = None
    is_raised: bool = False

    def running(self) -> Running | None:
        """Return the medians of the window, None where there is too little in it."""
        return running_of(self.error_px, self.shift_px)

    def add(self, stamp_ns: IntArray, error_px: Array, shift_px: Array) -> None:
        """Append frames and let go of what the window has left."""
        if len(self.stamp_ns) and stamp_ns[0] - self.stamp_ns[-1] > STALE_S * NS_PER_S:
            self.forget()
        stamp_ns = np.concatenate([self.stamp_ns, stamp_ns])
        kept = stamp_ns > stamp_ns[-1] - round(WINDOW_S * NS_PER_S)
        self.stamp_ns = stamp_ns[kept]
        self.error_px = np.concatenate([self.error_px, error_px])[kept]
        self.shift_px = np.concatenate([self.shift_px, shift_px])[kept]

    def forget(self) -> None:
        """Empty the window; what was raised stays raised until it fits again."""
        self.stamp_ns, self.error_px = self.stamp_ns[:0], self.error_px[:0]
        self.shift_px = self.shift_px[:0]
        self.over_since_ns = self.under_since_ns = None

    def judge(self, level: Level) -> None:
        """Raise or clear, with patience in both directions."""
        running = self.running()
        if running is None:
            return
        now_ns = int(self.stamp_ns[-1])
        strain = level.strain(running)
        self.over_since_ns = _since(self.over_since_ns, now_ns, holds=strain > 1.0)
        self.under_since_ns = _since(self.under_since_ns, now_ns, holds=strain < HYSTERESIS)
        if _lasted_s(self.over_since_ns, now_ns) >= RAISE_S:
            self.is_raised = True
        elif _lasted_s(self.under_since_ns, now_ns) >= CLEAR_S:
            self.is_raised = False


class Watch:
    """Compares each camera's running error with its accepted level."""

    def __init__(self) -> None:
        """Watch nothing yet."""
        self._pose: RigidTransform | None = None
        self._levels: dict[str, Level] = {}
        self._anchors: dict[str, Level] = {}
        self._tracks: dict[str, _Track] = {}

    def accept(
        self, pose: RigidTransform, levels: Mapping[str, Level], *, is_automatic: bool
    ) -> None:
        """Watch a pose.

        Args:
            pose: world_T_mocap.
            levels: How the cameras fit it; cameras without a level are not judged.
            is_automatic: Whether nobody has looked at it. Then a level may creep up a little
                only, so that a drift is not followed step by step until nobody sees it, and a
                camera without a level keeps the one it had, so that what was named is neither
                forgotten nor named for ever.

        """
        if not is_automatic or self._pose is None:
            self._anchors, self._levels = dict(levels), {}
            self._tracks.clear()
        for name, level in levels.items():
            anchor = self._anchors.setdefault(name, level)
            if anchor.is_kept and level.follows(anchor):
                self._anchors[name] = level  # which tells more than a file does
            self._levels[name] = capped(level, self._anchors[name])
        self._pose = pose

    def add(self, pairs: Sequence[Pairs]) -> None:
        """Take what came since the last time, and judge."""
        if self._pose is None:
            return
        for new in pairs:
            if not new.is_placed:
                continue
            frames = per_frame(new.camera, new.view, self._pose)
            if not len(frames[0]):
                continue
            name = new.camera.name
            track = self._tracks.setdefault(name, _Track(new.camera))
            track.camera = new.camera
            track.add(*frames)
            if name in self._levels:
                track.judge(self._levels[name])

    def restart(self) -> None:
        """Empty the windows, as after a jump of the clock; what was raised stays raised."""
        for track in self._tracks.values():
            track.forget()

    @property
    def raised(self) -> tuple[str, ...]:
        """Cameras that no longer fit."""
        return tuple(name for name, track in self._tracks.items() if track.is_raised)

    def states(self) -> dict[str, CameraState]:
        """Return what is to be said of each camera that has seen the person."""
        return {name: self._state(name, track) for name, track in self._tracks.items()}

    def complaint(self) -> str:
        """Return one sentence on all cameras that no longer fit; '' where all do."""
        raised = self.raised
        if len(raised) > 1 and len(raised) > len(self._levels) / 2:
            return f'{common_complaint(raised)} Call ~/calibrate'
        return '; '.join(self._state(name, self._tracks[name]).complaint for name in raised)

    def _state(self, name: str, track: _Track) -> CameraState:
        level, running = self._levels.get(name), track.running()
        error_px = math.nan if running is None else running.error_px
        if level is None:
            return CameraState(error_px, math.nan, is_raised=False, complaint='')
        complaint = complaint_of(track.camera, level, running) if track.is_raised else ''
        return CameraState(error_px, level.error_px, track.is_raised, complaint)


def _since(before: int | None, now_ns: int, *, holds: bool) -> int | None:
    if not holds:
        return None
    return now_ns if before is None or before > now_ns else before


def _lasted_s(since_ns: int | None, now_ns: int) -> float:
    return -1.0 if since_ns is None else (now_ns - since_ns) / NS_PER_S


def common_complaint(cameras: Sequence[str]) -> str:
    """Say what most cameras have in common that no longer fit."""
    return (
        f'cameras {", ".join(cameras)} no longer fit the transform: was the MoCap calibrated '
        'again or its clock changed, or does somebody else carry the markers?'
    )


def complaint_of(camera: Camera, level: Level, running: Running | None) -> str:
    """Say how a camera no longer fits.

    Args:
        camera: The camera.
        level: How it did when the pose was accepted.
        running: How it does; None = it sees nobody.

    """
    name = camera.name
    if running is None:
        return f'camera {name} no longer fits the transform, and sees nobody now'
    found = (
        f'camera {name} is off by {running.error_px:.1f} px, accepted were {level.error_px:.1f} px'
    )
    shift_px = float(np.linalg.norm(running.shift_px - level.shift_px))
    if shift_px > MOVED_SHARE * running.error_px:
        turned = math.degrees(math.atan(shift_px / camera.focal_px))
        return (
            f'{found}: was it bumped? Its image is shifted by {shift_px:.1f} px ({turned:.2f} deg)'
        )
    return f'{found}: was it bumped, or does it follow somebody else?'
