# SPDX-License-Identifier: Apache-2.0
"""The live node with several persons in view, over DDS, against the offline run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ros_live import live
from ros_scene import Scene

from rpgd_ros.core import RigidTransform
from rpgd_ros.core.geometry import rotation_angle, rotation_from_quat_xyzw
from rpgd_ros.io.rig import read_rig, write_rig
from rpgd_ros.messages import CAMERA_INFO
from rpgd_ros.session import MOCAP, Session, solve
from rpgd_ros.simulation import build_scene, preset, simulate
from rpgd_ros.simulation.export import messages_of, rig_of


@pytest.mark.parametrize('subjects', [1, 2])
def test_three_persons_in_view_give_the_bits_of_the_offline_run(
    tmp_path: Path, subjects: int
) -> None:
    """Detections and skeletons shuffled in every message; nothing lost, the right transform."""
    recording = simulate(
        build_scene(preset('studio'), 3, seconds=6.0, persons=3, subjects=subjects)
    )
    rig = rig_of(recording)
    write_rig(tmp_path / 'rig.yaml', rig)
    sent = [m for m in messages_of(recording) if m.msgtype != CAMERA_INFO]
    scene = Scene(
        rig=tmp_path / 'rig.yaml',
        topics={m.topic: m.msgtype for m in sent},
        messages=[(m.topic, m.receive_ns, m.payload) for m in sent],
        recording=recording,
    )
    with live(scene.rig) as node:
        counts = node.play(scene)
        is_accepted, answer = node.calibrate()
    assert sum(counts.values()) == len(sent)
    assert is_accepted, answer
    rotation = rotation_from_quat_xyzw(np.array(answer['quat_xyzw']))
    found = RigidTransform(rotation, np.array(answer['xyz']))
    truth = scene.world_T_mocap
    assert np.degrees(rotation_angle(found.rotation.T @ truth.rotation)) < 0.1
    x = recording.mocap.x_mocap[::100].reshape(-1, 3)
    assert np.linalg.norm(found @ x - truth @ x, axis=1).max() < 0.005
    session = Session(read_rig(scene.rig))
    names = {camera.keypoints_topic: camera.name for camera in rig.cameras}
    for message in sent:
        stream = names.get(message.topic, MOCAP)
        session.add(stream, message.msgtype, [message.payload], [message.receive_ns])
    offline = solve(session.snapshot()).world_T_mocap
    assert offline.translation.tolist() == answer['xyz']
    assert offline.quat_xyzw.tolist() == answer['quat_xyzw']
