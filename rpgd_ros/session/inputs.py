# SPDX-License-Identifier: Apache-2.0
"""One stream of a session: decoding, units, the choice of joints, counts, the store."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import RigidTransform, rotation_angle
from rpgd_ros.io.rig import RigCamera
from rpgd_ros.messages import NORMALISED_TYPES, CameraInfo, decode
from rpgd_ros.pairing import BufferConfig, JointStream, Persons, Samples
from rpgd_ros.session.gather import GatheredStream
from rpgd_ros.session.snapshot import KeypointTrack

# Poses of /tf that differ by less are one: 0.02 px at a focal length of 1200 px and 5 m.
SAME_ROTATION = 1e-5  # rad
SAME_POSITION_M = 1e-4


class StreamInput:
    """What skeletons and keypoints have in common.

    Attributes:
        store: The samples, of the joints that are used.
        frame_id: Frame of the first usable message, to which the others must keep; None before.

    """

    def __init__(
        self,
        *,
        joints: Sequence[str],
        used: Sequence[int],
        n_values: Literal[2, 3],
        buffer: BufferConfig,
        scale: float = 1.0,
        min_confidence: float = 0.0,
    ) -> None:
        """Start empty.

        Args:
            joints: Joints that a message has, as it calls them.
            used: Those that are kept, in this order.
            n_values: Coordinates of each.
            buffer: Bounds of the store.
            scale: Factor on the coordinates.
            min_confidence: Joints with a lower score are counted.

        """
        self._whole = JointStream(
            buffer.max_frames, buffer.max_age_s, n_joints=len(used), n_values=n_values
        )
        self.store: JointStream | GatheredStream = self._whole
        self.frame_id: str | None = None
        self._names = tuple(joints)
        self._msgtype = ''
        self._n_values: Literal[2, 3] = n_values
        self._used = np.array(used, np.int64)
        self._scale = scale
        self._min_confidence = min_confidence
        self._n_received = 0
        self._dropped: Counter[str] = Counter()
        self._joints: Counter[str] = Counter()

    def add(
        self,
        msgtype: str,
        payloads: Sequence[bytes],
        receive_ns: Sequence[int],
        *,
        zero_is_missing: bool,
        use_receive_time: bool,
        part: str = '',  # noqa: ARG002 (of skeletons only)
    ) -> bool:
        """Take serialised messages; return whether a backward jump of the clock was believed.

        Args:
            msgtype: Their type.
            payloads: In the order of arrival.
            receive_ns: When each arrived.
            zero_is_missing: Whether a joint at exactly zero is missing.
            use_receive_time: Whether the arrival counts instead of the stamp.
            part: Joint that the topic carries, as the messages would call it; '' = all.

        """
        self._n_received += len(payloads)
        decoded = decode(
            msgtype,
            payloads,
            joints=self._names,
            n_values=self._n_values,
            receive_ns=receive_ns,
            zero_is_missing=zero_is_missing,
            frame_id=self.frame_id,
            needs_stamp=not use_receive_time,
        )
        if decoded.dropped:
            self._dropped.update(decoded.dropped)
        if decoded.missing:
            self._joints.update(decoded.missing)
        batch = decoded.batch
        if batch is None:
            return False
        self.frame_id, self._msgtype = batch.frame_id, msgtype
        stamp_ns = batch.stamp_ns
        if use_receive_time:
            stamp_ns = np.array([receive_ns[i] for i in batch.index], np.int64)
        values, confidence = batch.take(self._used)
        if self._scale != 1.0:
            values *= self._scale
        # Only counted here, taken out of the snapshot: a new limit holds for what is stored.
        if confidence is not None and self._min_confidence > 0.0:
            n_low = int(np.count_nonzero(confidence < self._min_confidence))
            if n_low:
                self._joints['low_confidence'] += n_low
        if batch.others is not None:
            self._joints['further_persons'] += int(np.isfinite(batch.others[..., 0]).any(2).sum())
        return self._whole.add(stamp_ns, values, confidence)

    def lend_persons(self) -> Persons | None:
        """Return the joints of all persons; None where there is never more than one."""
        return self._whole.lend_persons() if self.store is self._whole else None

    def resize(self, buffer: BufferConfig) -> None:
        """Change the bounds of the store."""
        self.store.resize(buffer.max_frames, buffer.max_age_s)

    def clear(self) -> None:
        """Forget the messages and their frame; the counts stay."""
        self.store.clear()
        self.frame_id = None

    def counts(self) -> dict[str, int]:
        """Return what became of the messages, and what was missing in them."""
        counts = {**self.store.counts, 'received': self._n_received}
        for reason, n in self._dropped.items():
            counts[reason] = counts.get(reason, 0) + n
        return counts | self._joints


class CameraInput(StreamInput):
    """The keypoints of one camera, as sent, and what is known of the camera.

    Attributes:
        rig: The camera in the rig file.
        camera: With intrinsics; None until they arrive. Where its pose is unknown, see `has_pose`,
            it holds how far a rectified image is turned against the optical frame, if it is.

    """

    def __init__(self, rig: RigCamera, columns: Sequence[int], buffer: BufferConfig) -> None:
        """Start empty; `columns` are the MoCap joints of the observations."""
        super().__init__(
            joints=rig.keypoint_joints,
            used=[k for _, k in rig.pairs],
            n_values=2,
            buffer=buffer,
            min_confidence=rig.min_confidence,
        )
        self.rig = rig
        self.camera: Camera | None = rig.camera
        self._pose = rig.extrinsics
        self._info: CameraInfo | None = None
        self._columns = np.array([columns.index(j) for j, _ in rig.pairs], np.int64)

    @property
    def has_pose(self) -> bool:
        """Whether the pose in the world is known."""
        return self._pose is not None

    @property
    def frame_names(self) -> tuple[str, ...]:
        """What rig file, CameraInfo and keypoints call the frame of the camera, if they do."""
        said = (self.rig.frame_id, self._info.frame_id if self._info else '', self.frame_id)
        return tuple(name for name in said if name)

    def update(self, time_offset_s: float, min_confidence: float) -> None:
        """Change what the rig file said; holds for all that is stored."""
        self.rig = replace(self.rig, time_offset_s=time_offset_s, min_confidence=min_confidence)
        self._min_confidence = min_confidence

    def set_info(self, info: CameraInfo) -> str:
        """Take intrinsics, unless the rig file gives them; others than before start it over.

        Returns:
            What changed and was dropped, '' = nothing.

        """
        before = self._info
        if self.rig.camera is not None or (before and _are_equal(before, info)):
            return ''
        camera = info.camera(self.rig.name, self._pose, is_rectified=self.rig.rectified)
        self._info, self.camera = info, camera
        if before is None:
            return ''
        return self._start_over(f'its CameraInfo changed ({_changes(before, info)})')

    def set_pose(self, camera_T_world: RigidTransform) -> str:
        """Take the pose, unless the rig file gives it; another than before starts it over.

        Returns:
            What changed and was dropped, '' = nothing.

        """
        before = self._pose
        if self.rig.extrinsics is not None or (before and _are_near(before, camera_T_world)):
            return ''
        self._pose = camera_T_world
        if self._info is not None:
            self.camera = self._info.camera(
                self.rig.name, camera_T_world, is_rectified=self.rig.rectified
            )
        elif self.camera is not None:
            self.camera = replace(self.camera, camera_T_world=camera_T_world)
        if before is None:
            return ''
        moved = before.inverse() @ camera_T_world
        angle_deg = np.degrees(rotation_angle(moved.rotation))
        way_m = float(np.linalg.norm(moved.translation))
        return self._start_over(f'its pose on TF moved by {way_m:.4f} m and {angle_deg:.3f} deg')

    def lend(self, time_offset_s: float) -> KeypointTrack:
        """Return the keypoints for a snapshot."""
        track = self.track(self.store.lend(), time_offset_s)
        return replace(track, persons=self.lend_persons())

    def track(self, samples: Samples, time_offset_s: float) -> KeypointTrack:
        """Return some of the keypoints with all that is needed to read them."""
        return KeypointTrack(
            samples=samples,
            columns=self._columns,
            units='normalized' if self._msgtype in NORMALISED_TYPES else self.rig.units,
            min_confidence=self.rig.min_confidence,
            time_offset_s=time_offset_s,
        )

    def _start_over(self, change: str) -> str:
        """Drop the keypoints that were seen before a change; say how many, '' where none were."""
        n_frames = len(self.store.stamps())
        self.clear()
        dropped = f'its {n_frames} messages of keypoints from before are dropped'
        return f'camera {self.rig.name}: {change}; {dropped}' if n_frames else ''


def _are_equal(a: CameraInfo, b: CameraInfo) -> bool:
    """Tell whether two messages describe the same image, whatever their stamps."""
    return (a.size, a.model, a.frame_id) == (b.size, b.model, b.frame_id) and all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ('matrix', 'distortion', 'rectified_matrix', 'rectification')
    )


def _changes(a: CameraInfo, b: CameraInfo) -> str:
    """Say in what two messages differ."""
    numbers = {
        'fx': (a.matrix[0, 0], b.matrix[0, 0]),
        'fy': (a.matrix[1, 1], b.matrix[1, 1]),
        'cx': (a.matrix[0, 2], b.matrix[0, 2]),
        'cy': (a.matrix[1, 2], b.matrix[1, 2]),
    }
    told = [
        f'{name} {old:.6g} to {new:.6g} px' for name, (old, new) in numbers.items() if old != new
    ]
    if a.size != b.size:
        told.append(f'size {a.size[0]} x {a.size[1]} to {b.size[0]} x {b.size[1]}')
    if a.frame_id != b.frame_id:
        told.append(f'frame {a.frame_id[:80]!r} to {b.frame_id[:80]!r}')
    return ', '.join(told) or 'distortion or rectification'


def _are_near(a: RigidTransform, b: RigidTransform) -> bool:
    """Tell whether two poses are the same but for what each message computes anew."""
    moved = a.inverse() @ b
    return (
        rotation_angle(moved.rotation) < SAME_ROTATION
        and float(np.linalg.norm(moved.translation)) < SAME_POSITION_M
    )


def describe(counts: Mapping[str, int]) -> str:
    """Say why messages that came were not kept: '40 received: 40 wrong_joints'."""
    if not counts['received']:
        return '0 received'
    others = {k: n for k, n in counts.items() if k not in {'received', 'kept'} and n}
    why = ', '.join(f'{n} {reason}' for reason, n in others.items()) or 'all kept'
    return f'{counts["received"]} received: {why}'
