# SPDX-License-Identifier: Apache-2.0
"""Messages as the drivers fill them, serialised by the rosbags library from their definitions."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rpgd_ros.messages.definitions import DEFINITIONS

NO_TURN = (0.0, 0.0, 0.0, 1.0)
ZEROS = (0.0, 0.0, 0.0, 0.0)
STAMP_NS = 1_700_000_000_123_456_789

Floats = Any


@lru_cache(maxsize=1)
def store() -> Any:
    """Return the types of Jazzy with those of the drivers."""
    types = get_typestore(Stores.ROS2_JAZZY)
    found: dict[str, Any] = {}
    for name, text in DEFINITIONS.items():
        found |= get_types_from_msg(text, name)
    types.register(found)
    return types


def make(name: str, *values: object) -> Any:
    """Make a message, its fields in the order of the definition."""
    return store().types[name](*values)


def serialise(message: Any, *, little_endian: bool = True) -> bytes:
    """Return the CDR bytes of a message."""
    return bytes(store().serialize_cdr(message, message.__msgtype__, little_endian=little_endian))


def stamp(stamp_ns: int) -> Any:
    """Make a builtin_interfaces/Time."""
    return make('builtin_interfaces/msg/Time', *divmod(int(stamp_ns), 10**9))


def header(stamp_ns: int = STAMP_NS, frame_id: str = 'map') -> Any:
    """Make a std_msgs/Header."""
    return make('std_msgs/msg/Header', stamp(stamp_ns), frame_id)


def point(xyz: Floats) -> Any:
    """Make a geometry_msgs/Point."""
    return make('geometry_msgs/msg/Point', *(float(x) for x in xyz))


def vector(xyz: Floats = (0.0, 0.0, 0.0)) -> Any:
    """Make a geometry_msgs/Vector3."""
    return make('geometry_msgs/msg/Vector3', *(float(x) for x in xyz))


def pose(xyz: Floats, quat_xyzw: Floats = NO_TURN) -> Any:
    """Make a geometry_msgs/Pose."""
    turn = make('geometry_msgs/msg/Quaternion', *(float(q) for q in quat_xyzw))
    return make('geometry_msgs/msg/Pose', point(xyz), turn)


def marker(name: str, xyz: Floats, *, index: int = 0, id_type: int = 0) -> Any:
    """Make a mocap4r2 Marker."""
    return make('mocap4r2_msgs/msg/Marker', id_type, index, name, point(xyz))


def markers(items: list[Any], **keywords: Any) -> Any:
    """Make mocap4r2 Markers."""
    return make('mocap4r2_msgs/msg/Markers', header(**keywords), 7, items)


def rigid_bodies(
    bodies: dict[str, tuple[Floats, Floats]], labelled: list[Any] | None = None, **keywords: Any
) -> Any:
    """Make mocap4r2 RigidBodies of positions and quaternions; each repeats all markers."""
    items = [
        make('mocap4r2_msgs/msg/RigidBody', name, labelled or [], pose(xyz, quat))
        for name, (xyz, quat) in bodies.items()
    ]
    return make('mocap4r2_msgs/msg/RigidBodies', header(**keywords), 7, items)


def named_poses(bodies: dict[str, tuple[Floats, Floats]], **keywords: Any) -> Any:
    """Make a NamedPoseArray."""
    package = 'motion_capture_tracking_interfaces/msg'
    items = [make(f'{package}/NamedPose', name, pose(*body)) for name, body in bodies.items()]
    return make(f'{package}/NamedPoseArray', header(**keywords), items)


def link_states(
    links: dict[str, tuple[Floats, Floats]],
    *,
    package: str = 'xsens_mvn_msgs',
    outer: Any = None,
    stamp_ns: int = STAMP_NS,
) -> Any:
    """Make a LinkStateArray; the outer header has no frame."""
    nothing = make('geometry_msgs/msg/Twist', vector(), vector())
    still = make('geometry_msgs/msg/Accel', vector(), vector())
    items = [
        make(f'{package}/msg/LinkState', header(stamp_ns, name), pose(*link), nothing, still)
        for name, link in links.items()
    ]
    head = outer if outer is not None else header(stamp_ns, '')
    return make(f'{package}/msg/LinkStateArray', head, items)


def rviz_marker(number: int, xyz: Floats, *, action: int = 0, **keywords: Any) -> Any:
    """Make a visualization_msgs/Marker as Azure Kinect's driver does."""
    head = header(**{'frame_id': 'depth_camera_link', **keywords})
    colour = make('std_msgs/msg/ColorRGBA', 1.0, 0.0, 0.0, 1.0)
    texture = make('sensor_msgs/msg/CompressedImage', head, '', np.zeros(0, np.uint8))
    mesh = make('visualization_msgs/msg/MeshFile', '', np.zeros(0, np.uint8))
    no = False
    lifetime = make('builtin_interfaces/msg/Duration', 0, 250_000_000)
    return make(
        'visualization_msgs/msg/Marker', head, '', number, 2, action, pose(xyz),
        vector((0.05, 0.05, 0.05)), colour, lifetime, no, [], [], '', texture, [], '', '',
        mesh, no,
    )  # fmt: skip


def marker_array(items: list[Any]) -> Any:
    """Make a visualization_msgs/MarkerArray."""
    return make('visualization_msgs/msg/MarkerArray', items)


def zed_object(
    uv: Floats = None,
    xyz: Floats = None,
    *,
    body_format: int = 0,
    has_skeleton: bool = True,
    package: str = 'zed_msgs',
    label: str = 'Body_0',
) -> Any:
    """Make a ZED Object whose 70 slots hold what is given, and zeros."""

    def corners(n: int, size: int, dtype: type, name: str) -> list[Any]:
        zeros: Any = np.zeros(size, dtype)
        return [make(f'{package}/msg/{name}', zeros) for _ in range(n)]

    def slots(values: Floats, size: int, name: str) -> list[Any]:
        table = np.zeros((70, size), np.float32)
        if values is not None:
            table[: len(values)] = values
        return [make(f'{package}/msg/{name}', row) for row in table]

    def box(name: str, *content: Any) -> Any:
        return make(f'{package}/msg/{name}', corners(*content))

    zeros, is_tracked = np.zeros(3, np.float32), True
    return make(
        f'{package}/msg/Object', label, 0, '', 88.0, zeros, np.zeros(6, np.float32), zeros,
        is_tracked, 1, 0,
        box('BoundingBox2Di', 4, 2, np.uint32, 'Keypoint2Di'),
        box('BoundingBox3D', 8, 3, np.float32, 'Keypoint3D'),
        zeros, has_skeleton, body_format,
        box('BoundingBox2Df', 4, 2, np.float32, 'Keypoint2Df'),
        box('BoundingBox3D', 8, 3, np.float32, 'Keypoint3D'),
        zeros,
        make(f'{package}/msg/Skeleton2D', slots(uv, 2, 'Keypoint2Df')),
        make(f'{package}/msg/Skeleton3D', slots(xyz, 3, 'Keypoint3D')),
    )  # fmt: skip


def objects(items: list[Any], *, package: str = 'zed_msgs', **keywords: Any) -> Any:
    """Make a ZED ObjectsStamped."""
    return make(f'{package}/msg/ObjectsStamped', header(**keywords), items)


def skeleton_2d(rows: Floats, **keywords: Any) -> Any:
    """Make an hri_msgs Skeleton2D of (18, 3) x, y, c."""
    points = [
        make('hri_msgs/msg/NormalizedPointOfInterest2D', *(float(x) for x in row)) for row in rows
    ]
    return make('hri_msgs/msg/Skeleton2D', header(**keywords), points)


def detection(
    keypoints: dict[int, tuple[float, float, float]],
    *,
    package: str = 'yolo_msgs',
    name: str = 'person',
    n_border: int = 0,
    n_in_3d: int = 0,
) -> Any:
    """Make a yolo Detection of u, v, score by the keypoints' ids."""

    def msg(kind: str, *values: object) -> Any:
        return make(f'{package}/msg/{kind}', *values)

    box = msg(
        'BoundingBox2D', msg('Pose2D', msg('Point2D', 1.0, 2.0), 0.0), msg('Vector2', 3.0, 4.0)
    )
    box_3d = msg('BoundingBox3D', pose((0.0, 0.0, 0.0)), vector(), '')
    mask = msg('Mask', 480, 640, [msg('Point2D', float(i), 0.0) for i in range(n_border)])
    points = [
        msg('KeyPoint2D', i, msg('Point2D', float(u), float(v)), float(score))
        for i, (u, v, score) in keypoints.items()
    ]
    points_3d = [msg('KeyPoint3D', i, point((1.0, 2.0, 3.0)), 0.5) for i in range(n_in_3d)]
    return msg(
        'Detection', 0, name, 0.9, '1', box, box_3d, mask, msg('KeyPoint2DArray', points),
        msg('KeyPoint3DArray', points_3d, ''),
    )  # fmt: skip


def detections(items: list[Any], *, package: str = 'yolo_msgs', **keywords: Any) -> Any:
    """Make a yolo DetectionArray."""
    return make(f'{package}/msg/DetectionArray', header(**keywords), items)


def openpose_list(persons: list[Floats], **keywords: Any) -> Any:
    """Make an OpenPose list of (J, 3) x, y, score."""
    package = 'openpose_ros2_msgs/msg'
    items = [
        make(
            f'{package}/PoseKeyPoints',
            [make(f'{package}/PoseKeyPoint', *(float(x) for x in row)) for row in rows],
        )
        for rows in persons
    ]
    return make(f'{package}/PoseKeyPointsList', header(**keywords), items)


def without_header(payload: bytes) -> bytes:
    """Return an OpenPose list as it was before it had a header."""
    (size,) = np.frombuffer(payload, '<u4', 1, 12)
    end = 16 + int(size)
    return payload[:4] + payload[end + (4 - end) % 4 :]


def pose_stamped(xyz: Floats, quat_xyzw: Floats = NO_TURN, **keywords: Any) -> Any:
    """Make a geometry_msgs/PoseStamped."""
    return make('geometry_msgs/msg/PoseStamped', header(**keywords), pose(xyz, quat_xyzw))


def transform(
    parent: str, child: str, xyz: Floats, quat_xyzw: Floats = NO_TURN, stamp_ns: int = STAMP_NS
) -> Any:
    """Make a geometry_msgs/TransformStamped."""
    turn = make('geometry_msgs/msg/Quaternion', *(float(q) for q in quat_xyzw))
    return make(
        'geometry_msgs/msg/TransformStamped', header(stamp_ns, parent), child,
        make('geometry_msgs/msg/Transform', vector(xyz), turn),
    )  # fmt: skip


def tf_message(items: list[Any]) -> Any:
    """Make a tf2_msgs/TFMessage."""
    return make('tf2_msgs/msg/TFMessage', items)
