# SPDX-License-Identifier: Apache-2.0
"""Hands out each pair of keypoints and skeleton once, soon after it came: for running figures."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.observations import NS_PER_S, View
from rpgd_ros.pairing import Samples, pair
from rpgd_ros.session.collect import Session
from rpgd_ros.session.inputs import CameraInput
from rpgd_ros.session.snapshot import in_columns

BEFORE_ALL = -(2**62)  # a stamp before every other


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """What one camera saw since the last time.

    Attributes:
        camera: With its pose; the only camera of a rig may be the world itself.
        frame_id: Frame of its messages.
        view: Its new frames with their skeletons, stamped on the MoCap's clock.
        offset_ns: How late its own stamps are.

    """

    camera: Camera
    frame_id: str
    view: View
    offset_ns: int = 0


@dataclass(slots=True, eq=False)
class Recent:
    """A place in each stream of a session, behind which everything was handed out.

    Attributes:
        session: Where the messages are.
        offsets_s: How late videos are stamped by the calibration that holds, by camera; for the
            others holds what the rig file says.
        poses: camera_T_world of the cameras that a calibration has placed.

    """

    session: Session
    offsets_s: Mapping[str, float] = field(default_factory=dict)
    poses: Mapping[str, RigidTransform] = field(default_factory=dict)
    _after_ns: dict[str, int] = field(default_factory=dict)
    _n_epochs: int = 0

    def take(self, cameras: Collection[str] | None = None) -> list[Pairs]:
        """Return the pairs that have become whole; copies, in no one's way.

        Args:
            cameras: Whose; None = of all.

        """
        if self._n_epochs != self.session.n_epochs:
            self._n_epochs = self.session.n_epochs
            self._after_ns.clear()
        _, _, mocap, sources = self.session.parts()
        if not len(mocap.store.stamps()):
            return []
        found = (
            self._take(name, source, len(sources))
            for name, source in sources.items()
            if cameras is None or name in cameras
        )
        return [pairs for pairs in found if pairs is not None]

    def skeleton(self) -> tuple[int, Array] | None:
        """Return stamp and joints (J, 3) of the newest skeleton, metres; None before the first."""
        mocap = self.session.parts()[2]
        stamp_ns, values, _ = mocap.store.arrays()
        return (int(stamp_ns[-1]), values[-1].copy()) if len(stamp_ns) else None

    def cameras(self) -> list[Camera]:
        """Return the cameras whose pose is known."""
        sources = self.session.parts()[3]
        placed = (
            _placed(source, self.poses.get(name), is_only=len(sources) == 1)
            for name, source in sources.items()
        )
        return [camera for camera in placed if camera is not None]

    def joint_names(self) -> tuple[str, ...]:
        """Return the names of the joints of all that is handed out: those that a camera sees."""
        rig = self.session.parts()[0]
        return tuple(rig.mocap.joints[j] for j in rig.used_joints)

    def _take(self, name: str, source: CameraInput, n_cameras: int) -> Pairs | None:
        rig, sync, mocap, _ = self.session.parts()
        camera = _placed(source, self.poses.get(name), is_only=n_cameras == 1)
        stamps = source.store.stamps()
        if camera is None or not len(stamps):
            return None
        default_s = source.rig.time_offset_s - rig.mocap.time_offset_s
        offset_s = self.offsets_s.get(name, default_s)
        offset_ns = round(offset_s * NS_PER_S)
        mocap_ns = mocap.store.stamps()
        if stamps[-1] < self._after_ns.get(name, BEFORE_ALL):
            del self._after_ns[name]  # a recording that began again after a reset
        # Frames after the newest skeleton wait for the next one.
        first, end = np.searchsorted(
            stamps, [self._after_ns.get(name, BEFORE_ALL), mocap_ns[-1] + offset_ns], side='right'
        )
        if first >= end:
            return None
        self._after_ns[name] = int(stamps[end - 1])
        since = max(int(np.searchsorted(mocap_ns, stamps[first] - offset_ns)) - 1, 0)
        skeletons = _rows(mocap.store.arrays(), slice(since, None))
        track = source.track(_rows(source.store.arrays(), slice(first, end)), offset_s)
        keypoints = in_columns(track, skeletons.values.shape[1], camera.size)
        view, _ = pair(skeletons, keypoints, settings=sync, time_offset_s=offset_s)
        if not view.n_frames:
            return None
        return Pairs(camera, source.frame_id or name, view, offset_ns)


def _placed(source: CameraInput, found: RigidTransform | None, *, is_only: bool) -> Camera | None:
    """Return a camera with its pose, None where something of it is not known yet."""
    camera = source.camera
    if camera is None:
        return None
    pose = camera.camera_T_world or found or (RigidTransform.identity() if is_only else None)
    return None if pose is None else replace(camera, camera_T_world=pose)


def _rows(samples: Samples, rows: slice) -> Samples:
    stamp_ns, values, confidence = samples
    scores = None if confidence is None else confidence[rows]
    return Samples(stamp_ns[rows], values[rows], scores)
