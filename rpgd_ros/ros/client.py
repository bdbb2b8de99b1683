# SPDX-License-Identifier: Apache-2.0
"""What a program sees of a running calibrator: its counts, its answer, its transform."""

from __future__ import annotations

import json
from typing import Any

from geometry_msgs.msg import TransformStamped

from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.io.rig import Rig
from rpgd_ros.ros.player import Peer

NODE = 'rpgd_calibrator'  # relative: the peer shares its namespace


class CalibratorClient:
    """Listens to a calibrator and calls it."""

    def __init__(self, peer: Peer, rig: Rig, *, node: str = NODE) -> None:
        """Begin to listen.

        Args:
            peer: Takes the messages.
            rig: The calibrator's rig.
            node: Name of the calibrator, relative to the peer's namespace.

        """
        self._peer = peer
        self._node = node
        self._entries = {rig.mocap.topic: 'mocap'}
        self._entries |= {c.keypoints_topic: f'camera {c.name}' for c in rig.cameras}
        peer.listen_diagnostics()
        peer.listen(f'{node}/transform', TransformStamped)

    def received(self) -> dict[str, int]:
        """Return the messages that the calibrator has counted by topic; 0 before it says so."""
        return {
            topic: int(self._peer.diagnostics(entry).get('received', '0'))
            for topic, entry in self._entries.items()
        }

    def calibrate(self, *, seconds: float) -> tuple[bool, dict[str, Any]] | None:
        """Call ~/calibrate.

        Returns:
            Whether it succeeded, and its answer; None where none came in time.

        """
        answer = self._peer.call(f'{self._node}/calibrate', seconds=seconds)
        return None if answer is None else (bool(answer.success), json.loads(answer.message))

    def save(self, *, seconds: float) -> bool:
        """Ask to write the result again, with a report where plots are installed."""
        response = self._peer.call(f'{self._node}/save', seconds=seconds)
        return response is not None and bool(response.success)

    def transform(self, *, seconds: float) -> RigidTransform | None:
        """Return world_T_mocap as published, or None where nothing was in time."""
        topic = f'{self._node}/transform'
        if not self._peer.wait_until(lambda: self._peer.newest(topic), seconds=seconds):
            return None
        message = self._peer.newest(topic).transform
        t, q = message.translation, message.rotation
        return RigidTransform.from_quat_xyzw([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])
