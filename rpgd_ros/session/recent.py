# SPDX-License-Identifier: Apache-2.0
"""Hands out each pair of keypoints and skeleton once, soon after it came: for running figures."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
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
        camera: With its pose, where that is known; the only camera of a rig may be the world.
        frame_id: Frame of its messages.
        view: Its new frames with their skeletons, stamped on the MoCap's clock.
        offset_ns: How late its own stamps are.

    """

    camera: Camera
    frame_id: str
    view: View
    offset_ns: int = 0

    @property
    def is_placed(self) -> bool:
        """Whether the pose of the camera is known: no residual means anything without."""
        return self.camera.camera_T_world is not None


@dataclass(slots=True, eq=False)
class Recent:
    """A place in each stream of a session, behind which everything was handed out.

    Attributes:
        session: Where the messages are.
        offsets_s: How late videos are stamped by the calibration that holds, by camera; for the
            others holds what the rig file says.
        poses: camera_T_world of the optical frames of cameras that a calibration has placed.
        pose: world_T_mocap where it is known: tells which of several persons in an image is the
            one with MoCap. Without it the first one is taken.

    """

    session: Session
    offsets_s: Mapping[str, float] = field(default_factory=dict)
    poses: Mapping[str, RigidTransform] = field(default_factory=dict)
    pose: RigidTransform | None = None
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
        return [c for c in placed if c is not None and c.camera_T_world is not None]

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
        views = []
        for sent in _detections(source, slice(int(first), int(end))):
            track = source.track(sent, offset_s)
            keypoints = in_columns(track, skeletons.values.shape[1], camera.size)
            views.append(pair(skeletons, keypoints, settings=sync, time_offset_s=offset_s)[0])
        view = views[0]
        if not view.n_frames:
            return None
        if len(views) > 1 and self.pose is not None and camera.camera_T_world is not None:
            view = _nearest(views, camera, self.pose)
        return Pairs(camera, source.frame_id or name, view, offset_ns)


def _placed(source: CameraInput, found: RigidTransform | None, *, is_only: bool) -> Camera | None:
    """Return a camera, with its pose if that is known; None without intrinsics."""
    camera = source.camera
    if camera is None or source.has_pose:
        return camera
    turn = camera.camera_T_world or RigidTransform.identity()
    optical = RigidTransform.identity() if is_only else found
    return replace(camera, camera_T_world=None if optical is None else turn @ optical)


def _detections(source: CameraInput, rows: slice) -> list[Samples]:
    """Return some frames of a camera, once for each person that it sees."""
    persons = source.lend_persons()
    if persons is None:
        return [_rows(source.store.arrays(), rows)]
    stamp_ns, values, confidence = persons
    return [
        Samples(
            stamp_ns[rows], values[rows, p], None if confidence is None else confidence[rows, p]
        )
        for p in range(values.shape[1])
    ]


def _nearest(views: Sequence[View], camera: Camera, pose: RigidTransform) -> View:
    """Choose in each frame the person whose keypoints lie nearest to the reprojection.

    A frame of a person with fewer joints than half of the fullest is not chosen for that.
    """
    uv = np.stack([view.uv for view in views])
    apart = np.linalg.norm(uv - camera.project(pose @ views[0].x_mocap), axis=-1)
    n_seen = np.isfinite(apart).sum(-1)
    apart = np.where(np.isfinite(apart), apart, 0.0).sum(-1) / np.maximum(n_seen, 1)
    apart[n_seen < np.maximum(0.5 * n_seen.max(0), 1)] = np.inf
    person, frames = apart.argmin(0), np.arange(uv.shape[1])
    return View(views[0].stamp_ns, views[0].x_mocap, uv[person, frames])


def _rows(samples: Samples, rows: slice) -> Samples:
    stamp_ns, values, confidence = samples
    scores = None if confidence is None else confidence[rows]
    return Samples(stamp_ns[rows], values[rows], scores)
