# SPDX-License-Identifier: Apache-2.0
"""The session: collects the messages of a rig and pairs them when asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import CalibrationError, InputError, Reason
from rpgd_ros.core.geometry import IntArray, RigidTransform
from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.io.rig import Rig
from rpgd_ros.messages import decode_camera_info
from rpgd_ros.pairing import PairCounts, SyncConfig, match
from rpgd_ros.session.config import SessionConfig
from rpgd_ros.session.inputs import CameraInput, StreamInput, describe
from rpgd_ros.session.placing import optical_frames, usable_cameras
from rpgd_ros.session.skeletons import MocapInput
from rpgd_ros.session.snapshot import Snapshot

MOCAP = 'mocap'  # name of the MoCap's stream; those of the cameras have the cameras' names


class Session:
    """Collects the messages of a rig. Belongs to one thread."""

    def __init__(self, rig: Rig, config: SessionConfig | None = None) -> None:
        """Start empty.

        Args:
            rig: Cameras, joints and units.
            config: Settings; None = the defaults.

        """
        self._rig = rig
        self._config = config or SessionConfig()
        # The columns of the observations: MoCap joints that some camera sees.
        self._columns = rig.used_joints
        buffer = self._config.buffer
        self._mocap = MocapInput(rig.mocap, self._columns, buffer)
        self._cameras = {c.name: CameraInput(c, self._columns, buffer) for c in rig.cameras}
        self._inputs: dict[str, StreamInput] = {MOCAP: self._mocap, **self._cameras}
        self._n_epochs = 0

    @property
    def streams(self) -> tuple[str, ...]:
        """`mocap` and the cameras' names."""
        return tuple(self._inputs)

    @property
    def mocap_frame(self) -> str:
        """Frame of the skeletons: the rig file's, or that of the messages; '' = not known yet."""
        return self._rig.mocap.frame or (self._mocap.frame_id or '').strip()

    @property
    def n_epochs(self) -> int:
        """How often a clock jumped back and everything was dropped."""
        return self._n_epochs

    def topics(self) -> Mapping[str, str]:
        """Return the stream of each topic of joints; `mocap/<joint>` where it carries only one."""
        cameras = {c.keypoints_topic: c.name for c in self._rig.cameras}
        mocap = {
            topic: f'{MOCAP}/{joint}' if joint else MOCAP
            for topic, joint in self._rig.mocap_topics.items()
        }
        return mocap | cameras

    def sources(self) -> Mapping[str, str]:
        """Return where each of the `streams` comes from: a topic, or a pattern of topics."""
        cameras = {c.name: c.keypoints_topic for c in self._rig.cameras}
        return {MOCAP: self._rig.mocap.topic, **cameras}

    def camera_info_topics(self) -> Mapping[str, str]:
        """Return the camera of each topic of intrinsics that the rig file does not give."""
        return {c.camera_info_topic: c.name for c in self._rig.cameras if c.camera is None}

    def add(
        self,
        stream: str,
        msgtype: str,
        payloads: Sequence[bytes],
        receive_ns: Sequence[int],
    ) -> None:
        """Take serialised messages of one stream; what cannot be used is counted.

        Args:
            stream: One of `streams`, or of those that `topics` gives.
            msgtype: Their ROS type.
            payloads: In the order of arrival.
            receive_ns: When each arrived.

        Raises:
            InputError: UNKNOWN_CAMERA. There is no such stream.

        """
        source = self._input(stream)
        went_back = source.add(
            msgtype,
            payloads,
            receive_ns,
            zero_is_missing=self._config.zero_is_missing,
            use_receive_time=self._config.sync.use_receive_time,
            part=stream.partition('/')[2],
        )
        if went_back:
            self._n_epochs += 1
            for other in self._inputs.values():
                if other is not source:
                    other.store.start_epoch()

    def set_intrinsics(self, camera: str, payload: bytes) -> str:
        """Take a serialised CameraInfo; intrinsics of the rig file go before it.

        A camera whose intrinsics change starts over: its old keypoints belong to another image.

        Returns:
            What changed and was dropped, '' = nothing.

        Raises:
            InputError: No CameraInfo, an uncalibrated camera, or no such camera.

        """
        return self._camera(camera).set_info(decode_camera_info(payload))

    def set_extrinsics(self, camera: str, camera_T_world: RigidTransform) -> str:
        """Take a camera's pose, as from TF; that of the rig file goes before it.

        A camera whose pose changes starts over.

        Returns:
            What changed and was dropped, '' = nothing.

        Raises:
            InputError: No such camera.

        """
        return self._camera(camera).set_pose(camera_T_world)

    def update_config(self, config: SessionConfig) -> None:
        """Change the settings, from the next message and the next snapshot on."""
        self._config = config
        for stream in self._inputs.values():
            stream.resize(config.buffer)

    def update_camera(self, name: str, *, time_offset_s: float, min_confidence: float) -> None:
        """Change what may change of a camera while it is used; holds for all that is stored.

        Raises:
            InputError: No such camera.

        """
        self._camera(name).update(time_offset_s, min_confidence)

    def reset(self) -> None:
        """Drop all messages; intrinsics, extrinsics and counts stay."""
        for stream in self._inputs.values():
            stream.clear()

    def counts(self, stream: str) -> Mapping[str, int]:
        """Return what became of a stream's messages.

        Messages: `received`, `kept`, and those dropped by reason (`malformed`, `wrong_joints`,
        `zero_stamp`, `duplicate`, `jump_held`, ...). Joints: `nan`, `zero`, `low_confidence`.

        Raises:
            InputError: There is no such stream.

        """
        return self._input(stream).counts()

    def pair_counts(self) -> Mapping[str, PairCounts]:
        """Return the frames of each camera with and without a skeleton, as of now."""
        counts = {}
        for name, camera in self._cameras.items():
            found = match(
                self._mocap.store.stamps(),
                camera.store.stamps(),
                settings=self._config.sync,
                time_offset_s=self._offset_s(camera),
            )
            n_frames = len(camera.store.stamps())
            counts[name] = PairCounts(len(found.row), n_frames - len(found.row))
        return counts

    def motion_m(self) -> float:
        """Return how far the body moved: diagonal of the box that holds its centre, metres."""
        return self._mocap.motion_m()

    def parts(self) -> tuple[Rig, SyncConfig, MocapInput, Mapping[str, CameraInput]]:
        """Return rig, pairing and the streams themselves, for a look at their newest messages."""
        return self._rig, self._config.sync, self._mocap, self._cameras

    def optical_frames(self) -> dict[str, str]:
        """Return what TF shall call the frame of each camera, see `placing.optical_frames`."""
        return optical_frames(self._cameras, (self._rig.world_frame, self.mocap_frame))

    def snapshot(self) -> Snapshot:
        """Take what has been collected, for one solve. Quick: nothing is copied.

        Raises:
            CalibrationError: NO_DATA, MISSING_INTRINSICS or NO_EXTRINSICS, naming streams or
                cameras; BAD_RIG where the MoCap's frame is the world's.

        """
        self._check_frames()
        self._check_data(tuple(self._cameras))
        cameras, turns = usable_cameras(self._cameras, self.camera_info_topics())
        used = [camera.name for camera in cameras]
        self._check_data(used)
        counts = {name: count for name, count in self.pair_counts().items() if name in used}
        if not any(count.paired for count in counts.values()):
            raise CalibrationError(Reason.NO_DATA, self._never_meet(cameras))
        sources = [self._cameras[name] for name in used]
        return Snapshot(
            cameras=cameras,
            keypoints=tuple(source.lend(self._offset_s(source)) for source in sources),
            skeletons=self._mocap.store.lend(),
            joint_names=tuple(self._rig.mocap.joints[j] for j in self._columns),
            sync=self._config.sync,
            config=self._config.calibration,
            pair_counts=counts,
            left_out=tuple(name for name in self._cameras if name not in used),
            turns=turns,
            persons=self._mocap.lend_persons(),
        )

    def _input(self, stream: str) -> StreamInput:
        name = MOCAP if stream.startswith(f'{MOCAP}/') else stream
        if name not in self._inputs:
            msg = f'no stream {stream[:80]!r}; there are {", ".join(self._inputs)}'
            raise InputError(Reason.UNKNOWN_CAMERA, msg)
        return self._inputs[name]

    def _camera(self, name: str) -> CameraInput:
        if name not in self._cameras:
            msg = f'no camera {name[:80]!r}; there are {", ".join(self._cameras)}'
            raise InputError(Reason.UNKNOWN_CAMERA, msg)
        return self._cameras[name]

    def _offset_s(self, camera: CameraInput) -> float:
        """How late a video is stamped against the skeletons, seconds."""
        return camera.rig.time_offset_s - self._rig.mocap.time_offset_s

    def _check_frames(self) -> None:
        if self.mocap_frame and self.mocap_frame == self._rig.world_frame:
            msg = (
                f'skeletons come in frame {self.mocap_frame[:80]!r}, which is also world_frame: '
                'set world_frame, or mocap.frame, to another name'
            )
            raise CalibrationError(Reason.BAD_RIG, msg)

    def _check_data(self, cameras: Sequence[str]) -> None:
        """Refuse where the skeleton, or the keypoints of all these cameras, are silent."""
        silent = [n for n in (MOCAP, *cameras) if not len(self._inputs[n].store.stamps())]
        if MOCAP not in silent and len(silent) < len(cameras):
            return
        told = [
            f'{name} ({self.sources()[name]}; {describe(self._inputs[name].counts())})'
            for name in silent
        ]
        others = [name for name in self._cameras if name not in cameras]
        without = f'; without intrinsics: {", ".join(others)}' if others else ''
        msg = f'no usable messages of {", ".join(told)}{without}'
        raise CalibrationError(Reason.NO_DATA, msg)

    def _never_meet(self, cameras: Sequence[Camera]) -> str:
        mocap_ns = self._mocap.store.stamps()
        apart = []
        for camera in cameras:
            source = self._cameras[camera.name]
            camera_ns = source.store.stamps() - round(self._offset_s(source) * NS_PER_S)
            if len(camera_ns):
                apart.append(f'{camera.name} {_apart_s(mocap_ns, camera_ns):.3f} s')
        return (
            f'no keypoints have a skeleton within reach of their stamps; smallest time from a '
            f'keypoint message to a skeleton: {", ".join(apart)}. Synchronise the clocks, set '
            'time_offset, or use sync.use_receive_time'
        )


def _apart_s(mocap_ns: IntArray, camera_ns: IntArray) -> float:
    """Return the smallest time between stamps of two streams, seconds."""
    after = np.searchsorted(mocap_ns, camera_ns)
    last = len(mocap_ns) - 1
    near = [np.abs(mocap_ns[np.clip(after - i, 0, last)] - camera_ns) for i in (0, 1)]
    return float(np.min(near)) / NS_PER_S
