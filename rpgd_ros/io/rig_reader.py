# SPDX-License-Identifier: Apache-2.0
"""Checks of the rig file, key by key."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final, NoReturn, cast

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.core.lens import Model
from rpgd_ros.io.rig_types import (
    JOINT,
    KEYPOINT_UNITS,
    METRES_PER,
    SCHEMA,
    KeypointUnits,
    MocapSource,
    Rig,
    RigCamera,
    Units,
)
from rpgd_ros.io.strict import Node, shown
from rpgd_ros.messages import KEYPOINT_TYPES, POSE_STAMPED, SKELETON_TYPES
from rpgd_ros.skeletons import hint, joint_names, landmarks, match_joints

NAME: Final = re.compile(r'[A-Za-z][A-Za-z0-9_]*')
TOPIC: Final = re.compile(r'(~/|/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*')
FRAME: Final = re.compile(r'[^\s/]\S*')  # tf2 takes anything without a leading slash
MAX_CAMERAS: Final = 128
MAX_SIZE: Final = 100_000  # pixels; the largest sensors have 15 000
MAX_OFFSET_S: Final = 3600.0
UNIT_NORM_TOLERANCE: Final = 0.01  # a quaternion written with two decimals
MODELS: Final[dict[str, tuple[Model, tuple[int, ...]]]] = {
    'plumb_bob': ('pinhole', (0, 4, 5)),
    'rational_polynomial': ('pinhole', (8,)),
    'equidistant': ('equidistant', (0, 4)),
}
CAMERA_KEYS: Final = (
    *('keypoints_topic', 'joint_map', 'type', 'units', 'rectified', 'time_offset'),
    *('min_confidence', 'size', 'matrix', 'distortion_model', 'distortion', 'camera_info_topic'),
    *('camera_T_world', 'world_T_camera', 'frame_id'),
)

Entries = Mapping[str, Node]


def rig_from_node(root: Node) -> Rig:
    """Build a rig from the root of its file.

    Raises:
        InputError: BAD_RIG or MISSING_INTRINSICS, naming file and key.

    """
    top = root.mapping(('schema', 'world_frame', 'mocap', 'cameras'))
    if top['schema'].integer(0, 10**6) != SCHEMA:
        top['schema'].refuse(
            f'schema {top["schema"].value} is unknown, this version reads {SCHEMA}'
        )
    world_frame = _matching(top['world_frame'], FRAME, 'a frame name')
    entries = top['mocap'].mapping(
        ('joints',), ('topic', 'type', 'units', 'frame', 'joint_map', 'time_offset', 'names')
    )
    mocap = _mocap(entries)
    if mocap.frame == world_frame:
        entries['frame'].refuse(f'{shown(world_frame)} is also world_frame: they must differ')
    common = _joint_map(entries.get('joint_map'))
    nodes = top['cameras'].sequence()
    if not 0 < len(nodes) <= MAX_CAMERAS:
        top['cameras'].refuse(f'need 1 to {MAX_CAMERAS} cameras, got {len(nodes)}')
    cameras = tuple(_camera(node, mocap, common) for node in nodes)
    _check_common_map(entries.get('joint_map'), cameras)
    _check_distinct(nodes, mocap, cameras)
    rig = Rig(world_frame, mocap, cameras)
    _check_mocap_topics(entries, rig)
    return rig


def _mocap(entries: Entries) -> MocapSource:
    units = entries['units'].choice(METRES_PER) if 'units' in entries else 'm'
    return MocapSource(
        topic=_mocap_topic(entries),
        joints=_joint_names(entries['joints']),
        units=cast('Units', units),
        frame=_matching(entries['frame'], FRAME, 'a frame name') if 'frame' in entries else '',
        type=entries['type'].choice(SKELETON_TYPES) if 'type' in entries else '',
        time_offset_s=_number(entries, 'time_offset', -MAX_OFFSET_S, MAX_OFFSET_S),
        names=_pattern(entries['names']) if 'names' in entries else JOINT,
    )


def _camera(node: Node, mocap: MocapSource, common: Mapping[str, str | None]) -> RigCamera:
    entries = node.mapping(('name', 'keypoints'), CAMERA_KEYS)
    name = _matching(entries['name'], NAME, 'a letter, then letters, digits or _')
    if name == 'mocap':
        entries['name'].refuse('mocap is the name of the other stream: call the camera otherwise')
    keypoints = _joint_names(entries['keypoints'])
    # Of both maps, by the detector's own names, so that the camera's goes before the common one.
    name_of = {m: k for m, k in zip(landmarks(keypoints), keypoints, strict=True) if m}
    name_of |= {k: k for k in keypoints}
    joint_map = {name_of[k]: j for k, j in common.items() if k in name_of}
    own = _joint_map(entries.get('joint_map'))
    joint_map |= {name_of.get(k, k): j for k, j in own.items()}
    try:
        pairs = match_joints(mocap.joints, keypoints, joint_map)
    except InputError as error:
        entries.get('joint_map', entries['keypoints']).refuse(error.message)
    extrinsics = _extrinsics(node, entries)
    rectified = entries['rectified'].flag() if 'rectified' in entries else False
    camera = _intrinsics(node, entries, name, extrinsics, rectified=rectified)
    units = entries['units'].choice(KEYPOINT_UNITS) if 'units' in entries else 'pixels'
    info = '' if camera is not None else f'{name}/camera_info'
    return RigCamera(
        name=name,
        keypoints_topic=_topic(entries, 'keypoints_topic', f'{name}/keypoints'),
        keypoint_joints=keypoints,
        pairs=pairs,
        camera=camera,
        camera_info_topic=_topic(entries, 'camera_info_topic', info),
        frame_id=_matching(entries['frame_id'], FRAME, 'a frame') if 'frame_id' in entries else '',
        units=cast('KeypointUnits', units),
        rectified=rectified,
        time_offset_s=_number(entries, 'time_offset', -MAX_OFFSET_S, MAX_OFFSET_S),
        min_confidence=_number(entries, 'min_confidence', 0.0, 1e6),
        extrinsics=extrinsics,
        type=entries['type'].choice(KEYPOINT_TYPES) if 'type' in entries else '',
    )


def _intrinsics(
    node: Node, entries: Entries, name: str, extrinsics: RigidTransform | None, *, rectified: bool
) -> Camera | None:
    if 'matrix' not in entries:
        for key in ('size', 'distortion_model', 'distortion'):
            if key in entries:
                _refuse_intrinsics(node, f'{key} without matrix: give it, or camera_info_topic')
        return None
    if 'size' not in entries:
        _refuse_intrinsics(node, 'matrix without size: give [width, height] in pixels')
    size = [n.integer(1, MAX_SIZE) for n in entries['size'].sequence()]
    if len(size) != 2:
        entries['size'].refuse(f'need [width, height], got {len(size)} numbers')
    model_name = 'plumb_bob'
    if 'distortion_model' in entries:
        model_name = entries['distortion_model'].choice(MODELS)
    model, lengths = MODELS[model_name]
    distortion: list[float] = []
    if 'distortion' in entries:
        distortion = entries['distortion'].numbers(*lengths)
    elif 0 not in lengths:
        entries['distortion_model'].refuse(f'{model_name} needs distortion: {lengths[0]} numbers')
    if rectified and (any(distortion) or model == 'equidistant'):
        node.refuse(
            'rectified keypoints have no distortion: give the matrix of the rectified image alone'
        )
    matrix = np.array(entries['matrix'].numbers(9)).reshape(3, 3)
    try:
        return Camera(
            name, matrix, np.array(distortion), (size[0], size[1]), extrinsics, model=model
        )
    except ValueError as error:
        entries['matrix'].refuse(str(error))


def _refuse_intrinsics(node: Node, message: str) -> NoReturn:
    Node(node.value, node.source, Reason.MISSING_INTRINSICS, node.path).refuse(message)


def _extrinsics(node: Node, entries: Entries) -> RigidTransform | None:
    """Return camera_T_world, from whichever of the two directions is given."""
    ways = [k for k in ('camera_T_world', 'world_T_camera', 'frame_id') if k in entries]
    if len(ways) > 1:
        node.refuse(f'{" and ".join(ways)} are given: need at most one of them')
    if not ways or ways[0] == 'frame_id':
        return None
    pose = entries[ways[0]]
    parts = pose.mapping(('xyz', 'quat_xyzw'))
    quat_xyzw = parts['quat_xyzw'].numbers(4)
    norm = float(np.linalg.norm(quat_xyzw))
    if abs(norm - 1.0) > UNIT_NORM_TOLERANCE:
        parts['quat_xyzw'].refuse(
            f'need a quaternion x, y, z, w of length 1, its length is {norm:.4g}'
        )
    transform = RigidTransform.from_quat_xyzw(parts['xyz'].numbers(3), quat_xyzw)
    return transform if ways[0] == 'camera_T_world' else transform.inverse()


def _joint_names(node: Node) -> tuple[str, ...]:
    try:
        return joint_names(node.value)
    except InputError as error:
        node.refuse(error.message)


def _joint_map(node: Node | None) -> dict[str, str | None]:
    """Return MoCap joint by keypoint; null leaves a keypoint out."""
    if node is None:
        return {}
    return {key: None if n.value is None else n.text() for key, n in node.items()}


def _check_common_map(node: Node | None, cameras: tuple[RigCamera, ...]) -> None:
    """Refuse keypoints in the MoCap's joint_map that no camera has."""
    known = {name for camera in cameras for name in camera.keypoint_joints}
    known |= {m for c in cameras for m in landmarks(c.keypoint_joints) if m}
    for key in _joint_map(node):
        if node is not None and key not in known:
            node.refuse(f'no camera has a keypoint {shown(key)}, {hint(key, sorted(known))}')


def _check_distinct(nodes: list[Node], mocap: MocapSource, cameras: tuple[RigCamera, ...]) -> None:
    """Refuse a name or a topic of joints that comes twice."""
    names: set[str] = set()
    topics = {mocap.topic: 'mocap'}
    for node, camera in zip(nodes, cameras, strict=True):
        if camera.name in names:
            node.refuse(f'camera {camera.name} comes twice')
        if camera.keypoints_topic in topics:
            other = topics[camera.keypoints_topic]
            node.refuse(f'topic {shown(camera.keypoints_topic)} is also that of {other}')
        names.add(camera.name)
        topics[camera.keypoints_topic] = f'camera {camera.name}'


def _mocap_topic(entries: Entries) -> str:
    """Return the topic, which may stand for one topic per joint."""
    topic = _topic(entries, 'topic', 'mocap/skeleton', stand_in='x')
    kind = entries['type'].value if 'type' in entries else ''
    if JOINT in topic and kind not in {'', POSE_STAMPED}:
        entries['type'].refuse(f'a topic for each {JOINT} carries {POSE_STAMPED}')
    if kind == POSE_STAMPED and JOINT not in topic:
        entries.get('topic', entries['type']).refuse(
            f'{POSE_STAMPED} is one joint: give the topic with {JOINT} in the place of its name'
        )
    return topic


def _check_mocap_topics(entries: Entries, rig: Rig) -> None:
    """Refuse joints whose names cannot stand in a topic, and topics that cameras have."""
    of_cameras = {camera.keypoints_topic for camera in rig.cameras}
    for topic in rig.mocap_topics if JOINT in rig.mocap.topic else ():
        if not TOPIC.fullmatch(topic) or topic in of_cameras:
            entries['topic'].refuse(f'{shown(topic)} cannot be the topic of a joint')


def _pattern(node: Node) -> str:
    text = node.text()
    if text.count(JOINT) != 1:
        node.refuse(f'need a text with {JOINT} once in it, got {shown(text)}')
    return text


def _topic(entries: Entries, key: str, default: str, stand_in: str = JOINT) -> str:
    if key not in entries:
        return default
    text = entries[key].text()
    if not TOPIC.fullmatch(text.replace(JOINT, stand_in, 1)):
        entries[key].refuse(f'need a topic, got {shown(text)}')
    return text


def _matching(node: Node, pattern: re.Pattern[str], what: str) -> str:
    text = node.text()
    if not pattern.fullmatch(text):
        node.refuse(f'need {what}, got {shown(text)}')
    return text


def _number(entries: Entries, key: str, low: float, high: float) -> float:
    return entries[key].number(low, high) if key in entries else 0.0
