# SPDX-License-Identifier: Apache-2.0
"""What topics say of a session's cameras: intrinsics on CameraInfo, poses on TF."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from rpgd_ros.core.errors import InputError
from rpgd_ros.io.rig import Rig
from rpgd_ros.messages import FrameTree, decode_tf
from rpgd_ros.messages.cdr import FRAME_OFFSET
from rpgd_ros.session.collect import Session

TF_STATIC, TF = '/tf_static', '/tf'


class CameraFacts:
    """Hands what is new to the session; live topics and bags go the same way.

    Each method that takes messages returns sentences for the log: what changed, what was dropped
    for it, what cannot be used. A sentence is told once.
    """

    def __init__(self, session: Session, rig: Rig) -> None:
        """Know nothing beyond the rig.

        Args:
            session: What it is told to.
            rig: The session's rig.

        """
        self._session = session
        self._world_frame = rig.world_frame
        self._topics = dict(session.camera_info_topics())
        self._frames = {c.name: c.frame_id for c in rig.cameras if c.frame_id and not c.extrinsics}
        self._tree = FrameTree()
        self._payloads: dict[str, bytes] = {}  # the newest CameraInfo by camera, less its stamp
        self._bad_infos: dict[str, str] = {}
        self._with_info: set[str] = set()
        self._with_pose: dict[str, bool] = {}  # by camera: whether all of its chain is static
        self._has_bad_tf = False

    @property
    def info_topics(self) -> Mapping[str, str]:
        """The camera of each CameraInfo topic that is needed."""
        return self._topics

    @property
    def from_tf(self) -> Collection[str]:
        """The cameras whose pose is to come from TF."""
        return self._frames.keys()

    @property
    def needs_moving_tf(self) -> bool:
        """Whether /tf_static alone does not place all of these cameras."""
        return any(not self._with_pose.get(name, False) for name in self._frames)

    @property
    def have_all_intrinsics(self) -> bool:
        """Whether a usable CameraInfo of each camera that needs one has come."""
        return self._with_info >= set(self._topics.values())

    @property
    def are_all_placed(self) -> bool:
        """Whether TF has connected each camera that needs it with the world."""
        return self._with_pose.keys() >= self._frames.keys()

    def take_info(self, camera: str, payload: bytes) -> list[str]:
        """Take a serialised CameraInfo of a camera."""
        content = payload[FRAME_OFFSET:]  # cameras repeat it with every image, stamped anew
        if self._payloads.get(camera) == content:
            return []
        self._payloads[camera] = content
        try:
            change = self._session.set_intrinsics(camera, payload)
        except InputError as error:
            self._bad_infos[camera] = f'camera {camera}: {error.message}'
            return [self._bad_infos[camera]]
        self._bad_infos.pop(camera, None)
        self._with_info.add(camera)
        return [change] if change else []

    def take_tf(self, payloads: Sequence[bytes], *, is_static: bool) -> list[str]:
        """Take serialised TFMessages of /tf_static or /tf."""
        told = []
        for payload in payloads:
            try:
                self._tree.add(decode_tf(payload), is_static=is_static)
            except InputError as error:
                if not self._has_bad_tf:
                    told.append(error.message)
                self._has_bad_tf = True
        for camera, frame in self._frames.items() if payloads else ():
            path = self._tree.path(self._world_frame, frame)
            if path is not None:
                change = self._session.set_extrinsics(camera, path.pose.inverse())
                self._with_pose[camera] = path.is_static
                told += [change] if change else []
        return told

    def problems(self) -> dict[str, str]:
        """Say of each camera that is not complete what is missing."""
        found = dict(self._bad_infos)
        for topic, camera in self._topics.items():
            if camera not in self._with_info:
                found.setdefault(camera, f'no CameraInfo of {camera} has come on {topic}')
        for camera, frame in self._frames.items():
            if camera not in self._with_pose:
                found.setdefault(camera, self._unplaced(frame))
        return found

    def other_parent(self, frame: str) -> str:
        """Return the parent that TF gives a frame where it is not the world, else ''."""
        parent = self._tree.parent(frame)
        return '' if parent == self._world_frame else parent

    def _unplaced(self, frame: str) -> str:
        parent = self._tree.parent(frame)
        last = f'its parent there is {parent[:80]!r}' if parent else 'TF has not named it yet'
        return (
            f'frame {frame[:80]!r} is not connected with {self._world_frame[:80]!r} on '
            f'{TF_STATIC} or {TF}: {last}'
        )
