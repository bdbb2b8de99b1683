# SPDX-License-Identifier: Apache-2.0
"""What a simulated scene leaves behind: streams of the sensors, and the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.candidates import Crowd, CrowdView
from rpgd_ros.core.geometry import Array, BoolArray, IntArray, RigidTransform
from rpgd_ros.core.observations import MocapTrack, Observations, View
from rpgd_ros.simulation.company import Company
from rpgd_ros.simulation.faults import Faults
from rpgd_ros.simulation.presets import Preset
from rpgd_ros.skeletons import joint_names, match_joints


@dataclass(frozen=True, slots=True, eq=False)
class MocapStream:
    """What the MoCap system sends.

    Attributes:
        stamp_ns: (M,) acquisition stamps.
        receive_ns: (M,) arrival.
        x_mocap: (M, J, 3) metres, MoCap frame.

    """

    stamp_ns: IntArray
    receive_ns: IntArray
    x_mocap: Array


@dataclass(frozen=True, slots=True, eq=False)
class CameraStream:
    """What the detector of one camera sends.

    Attributes:
        stamp_ns: (F,) acquisition stamps of the images.
        receive_ns: (F,) arrival.
        uv: (F, J, 2) pixels; NaN = not reported. A frame without any keypoint was not sent.
        confidence: (F, J) scores, 0 where not reported.

    """

    stamp_ns: IntArray
    receive_ns: IntArray
    uv: Array
    confidence: Array

    @property
    def is_sent(self) -> BoolArray:
        """(F,) whether the detector reported anything."""
        return np.asarray(np.isfinite(self.uv[..., 0]).any(-1))


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What no solver may see.

    Attributes:
        world_T_mocap: The transform to be found.
        inliers: Per camera (F, J), reported keypoints that carry nothing but noise; columns as
            those of the keypoints.
        sigma_px: Scale of the keypoint noise per axis, pixels.
        student_nu: Degrees of freedom of that noise; 0 = Gaussian.
        sigma_m: Noise of the skeleton per axis, metres.
        lags_s: Per camera, how late the video is stamped, seconds.
        faults: What went wrong on purpose.
        control_world: (N, 3) places of some joints, metres, world frame, straight from the body.
        control_mocap: (N, 3) the same places, metres, MoCap frame.

    """

    world_T_mocap: RigidTransform
    inliers: tuple[BoolArray, ...]
    sigma_px: float
    student_nu: float
    sigma_m: float
    lags_s: tuple[float, ...]
    faults: Faults
    control_world: Array
    control_mocap: Array

    @property
    def inlier(self) -> BoolArray:
        """(V, F, J) the masks of all cameras, where all have equally many frames."""
        return np.stack(self.inliers)


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRecording:
    """Streams of all sensors, with the truth beside them.

    Attributes:
        preset: Settings of the scene.
        seed: It was drawn with.
        cameras: The rig, calibrated without error.
        mocap: The skeletons.
        streams: The detections, in the order of the cameras.
        truth: What is to be found.
        company: What is reported of other people, or None where there are none.

    """

    preset: Preset
    seed: int
    cameras: tuple[Camera, ...]
    mocap: MocapStream
    streams: tuple[CameraStream, ...]
    truth: Truth
    company: Company | None = None

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """(MoCap joint, keypoint) that are one point of the body, in the order of the MoCap."""
        preset = self.preset
        mocap_joints, keypoints = (
            joint_names(convention) for convention in (preset.mocap_joints, preset.keypoint_joints)
        )
        return tuple(sorted(match_joints(mocap_joints, keypoints)))

    def observations(self) -> Observations:
        """Pair skeletons and keypoints.

        Columns are the `pairs`. Skeletons are interpolated to the stamps of each camera, where
        these differ from the MoCap's.
        """
        names = joint_names(self.preset.mocap_joints)
        x_mocap = _columns(self.mocap.x_mocap, [j for j, _ in self.pairs])
        pick = [k for _, k in self.pairs]
        track = MocapTrack(self.mocap.stamp_ns, x_mocap)
        views = tuple(
            View(
                s.stamp_ns,
                _skeleton_at(track, s.stamp_ns),
                _columns(s.uv, pick),
                _columns(s.confidence, pick),
            )
            for s in self.streams
        )
        return Observations(views, track, tuple(names[j] for j, _ in self.pairs))

    def crowd(self) -> Crowd:
        """Pair all skeletons with the detections of all persons, these in the order sent."""
        names = joint_names(self.preset.mocap_joints)
        joints, pick = [j for j, _ in self.pairs], [k for _, k in self.pairs]
        bodies = [self.mocap.x_mocap, *np.moveaxis(_company_of(self).x_mocap, 1, 0)]
        tracks = tuple(MocapTrack(self.mocap.stamp_ns, _columns(x, joints)) for x in bodies)
        views = []
        for v, s in enumerate(self.streams):
            uv, scores = self.persons(v)
            x = np.stack([_skeleton_at(track, s.stamp_ns) for track in tracks], 1)
            views.append(CrowdView(s.stamp_ns, x, uv[:, :, pick], scores[:, :, pick]))
        return Crowd(tuple(views), tracks, tuple(names[j] for j in joints))

    @property
    def n_persons(self) -> int:
        """Persons in view."""
        return 1 if self.company is None else self.company.order[0].shape[1]

    @property
    def n_subjects(self) -> int:
        """Persons with MoCap."""
        return 1 if self.company is None else self.company.skeleton_order.shape[1]

    def is_sent(self, camera: int) -> BoolArray:
        """(F,) whether the detector reported anybody."""
        if self.company is None:
            return self.streams[camera].is_sent
        return np.asarray(np.isfinite(self.persons(camera)[0][..., 0]).any((1, 2)))

    def skeletons(self, row: int) -> Array:
        """Return what one message of the MoCap holds: (J, 3), or (S, J, 3), metres."""
        subject: Array = self.mocap.x_mocap[row]
        if self.company is None or self.n_subjects == 1:
            return subject
        everybody: Array = np.concatenate([subject[None], self.company.x_mocap[row]])
        return np.asarray(everybody.take(self.company.skeleton_order[row], axis=0))

    def detections(self, camera: int, row: int) -> tuple[Array, Array]:
        """Return keypoints and scores of one message: (J, 2) and (J,), or (P, J, 2) and (P, J).

        Of several persons only those that the detector found.
        """
        stream, company = self.streams[camera], self.company
        if company is None:
            return stream.uv[row], stream.confidence[row]
        uv = np.concatenate([stream.uv[row, None], company.uv[camera][row]])
        scores = np.concatenate([stream.confidence[row, None], company.confidence[camera][row]])
        order = company.order[camera][row]
        found = order[np.isfinite(uv[order, :, 0]).any(1)]
        return uv[found], scores[found]

    def persons(self, camera: int) -> tuple[Array, Array]:
        """Return keypoints (F, P, J, 2) and scores (F, P, J) of all, in the order sent."""
        stream, company = self.streams[camera], _company_of(self)
        uv = np.concatenate([stream.uv[:, None], company.uv[camera]], 1)
        scores = np.concatenate([stream.confidence[:, None], company.confidence[camera]], 1)
        order = company.order[camera]
        return (
            np.take_along_axis(uv, order[..., None, None], 1),
            np.take_along_axis(scores, order[..., None], 1),
        )


def _company_of(recording: SimulatedRecording) -> Company:
    if recording.company is None:
        msg = 'nobody but the subject is in the scene'
        raise ValueError(msg)
    return recording.company


def _columns(values: Array, pick: list[int]) -> Array:
    """Return columns of axis 1; the array itself where all are wanted in their order."""
    return values if pick == list(range(values.shape[1])) else values[:, pick]


def _skeleton_at(track: MocapTrack, stamp_ns: IntArray) -> Array:
    """Return skeletons (F, J, 3) at stamps (F,); NaN outside the track."""
    if np.array_equal(stamp_ns, track.stamp_ns):
        return track.x_mocap
    after = np.clip(np.searchsorted(track.stamp_ns, stamp_ns), 1, len(track.stamp_ns) - 1)
    before = after - 1
    gap = (track.stamp_ns[after] - track.stamp_ns[before]).astype(np.float64)
    share = (stamp_ns - track.stamp_ns[before]) / gap
    share[(share < 0.0) | (share > 1.0)] = np.nan
    share = share[:, None, None]
    x: Array = (1.0 - share) * track.x_mocap[before] + share * track.x_mocap[after]
    return x
