# SPDX-License-Identifier: Apache-2.0
"""What RViz and Foxglove show: skeleton in the world, its reprojections, the room in markers.

Nothing is computed for a topic that nobody listens to, but the way walked, which cannot be made up
for later.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import Point
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.result import Calibration
from rpgd_ros.io.rig import Rig
from rpgd_ros.messages import encode_point_cloud2
from rpgd_ros.ros.drawing import (
    BLUE,
    FADED_GREEN,
    FLOOR_CELL_M,
    GREY,
    RED,
    Floor,
    Rgba,
    Way,
    bones_there,
    centre_of,
    colour_of,
    frustum,
    middle_of,
)
from rpgd_ros.ros.transforms import Published
from rpgd_ros.session.monitor import Monitor
from rpgd_ros.session.recent import Pairs
from rpgd_ros.skeletons import edges

DEPTH = 5
MARKERS_EVERY = 5  # calls of `publish`: the room at 2 Hz, skeletons at 10 Hz
USUAL_THRESHOLD_PX = 15.0  # of a pose from a file, which does not say: 5 cm at 4 m
LINE_M, JOINT_M, TEXT_M = 0.02, 0.06, 0.2  # thicknesses, and the height of letters


class Overlays:
    """Publishers of `~/skeleton_world`, `~/<camera>/reprojection` and `~/markers`.

    Attributes:
        advice: Sentence that is written over the room.

    """

    def __init__(self, node: Node, rig: Rig, monitor: Monitor) -> None:
        """Create the publishers.

        Args:
            node: The node.
            rig: Cameras and frames.
            monitor: Where skeletons, cameras and what is wrong with them come from.

        """
        qos = QoSProfile(depth=DEPTH)
        self.advice = ''
        self._monitor = monitor
        self._world_frame = rig.world_frame
        self._skeleton = node.create_publisher(PointCloud2, '~/skeleton_world', qos)
        self._markers = node.create_publisher(MarkerArray, '~/markers', qos)
        self._reprojections: dict[str, Publisher] = {
            camera.name: node.create_publisher(PointCloud2, f'~/{camera.name}/reprojection', qos)
            for camera in rig.cameras
        }
        self._edges = edges(monitor.recent.joint_names())
        self._way = Way()
        self._newest_ns = 0
        self._n_published = 0

    @property
    def is_wanted(self) -> bool:
        """Whether somebody listens to any of them."""
        publishers = (self._skeleton, self._markers, *self._reprojections.values())
        return any(publisher.get_subscription_count() for publisher in publishers)

    def clear(self) -> None:
        """Forget the way walked."""
        self._way.clear()

    def publish(
        self, pairs: Sequence[Pairs], published: Published | None, accepted: Calibration | None
    ) -> None:
        """Draw what came since the last time.

        Args:
            pairs: New pairs.
            published: The published pose, None without one.
            accepted: Its calibration, where it is of this process.

        """
        pose = None if published is None else published.world_T_mocap
        threshold_px = USUAL_THRESHOLD_PX if accepted is None else accepted.threshold_px
        self._way.add(pairs, pose, threshold_px)
        if not self.is_wanted:
            return
        if pose is not None:
            self._publish_skeleton(pose)
            self._publish_reprojections(pairs, pose)
        if self._n_published % MARKERS_EVERY == 0 and self._markers.get_subscription_count():
            self._markers.publish(MarkerArray(markers=self.markers(pose)))
        self._n_published += 1

    def markers(self, pose: RigidTransform | None) -> list[Marker]:
        """Return the room; without a pose, what stands in the world all the same."""
        recent, watch = self._monitor.recent, self._monitor.watch
        cameras = recent.cameras()
        bodies = np.zeros((0, 1, 3))
        if pose is not None and self._way.places:
            bodies = pose @ np.stack([place.x_mocap for place in self._way.places])
        floor = Floor.under(cameras, bodies)
        ways = [middle for body in bodies if (middle := middle_of(body)) is not None]
        corners = np.array([centre_of(camera) for camera in cameras] + ways).reshape(-1, 3)
        found: list[Marker] = []
        if len(corners):
            found.append(self._lines('floor', floor.grid(corners), [GREY], 0.3 * LINE_M))
            over = corners.mean(0) + 2.5 * floor.axes[2]
            found.append(self._text('advice', 0, over, self.advice))
        for number, camera in enumerate(cameras):
            colour = RED if camera.name in watch.raised else BLUE
            found.append(self._lines('camera', frustum(camera), [colour], LINE_M, number))
            share = self._monitor.coverage.image(camera.name).share
            name = f'{camera.name}\n{share:.0%} seen'
            at = centre_of(camera) + 0.25 * floor.axes[2]
            found.append(self._text('camera_name', number, at, name))
        if ways:
            found += self._walked(floor, np.array(ways))
        if pose is not None and self._way.newest is not None:
            place = self._way.newest
            found += self._body(pose @ place.x_mocap, place.agreement)
        return found

    def _publish_skeleton(self, pose: RigidTransform) -> None:
        newest = self._monitor.recent.skeleton()
        if newest is None or not self._skeleton.get_subscription_count():
            return
        stamp_ns, x_mocap = newest
        if stamp_ns != self._newest_ns:
            self._newest_ns = stamp_ns
            cloud = encode_point_cloud2(stamp_ns, self._world_frame, pose @ x_mocap)
            self._skeleton.publish(cloud)

    def _publish_reprojections(self, pairs: Sequence[Pairs], pose: RigidTransform) -> None:
        for new in pairs:
            publisher = self._reprojections[new.camera.name]
            stamp_ns = new.view.stamp_ns
            is_wanted = new.is_placed and publisher.get_subscription_count()
            if stamp_ns is not None and is_wanted:
                uv = new.camera.project(pose @ new.view.x_mocap[-1])
                stamp = int(stamp_ns[-1]) + new.offset_ns
                publisher.publish(encode_point_cloud2(stamp, new.frame_id, uv))

    def _walked(self, floor: Floor, ways: Array) -> list[Marker]:
        agreements = [place.agreement for place in self._way.places]
        colours = [colour_of(_mean(agreement)) for agreement in agreements]
        path = self._marker('path', Marker.LINE_STRIP, 0)
        path.scale.x = 2.0 * LINE_M
        _fill(path, ways, colours)
        covered = self._marker('covered', Marker.CUBE_LIST, 0)
        covered.scale.x = covered.scale.y = covered.scale.z = 0.9 * FLOOR_CELL_M
        thin = int(np.argmax(np.abs(floor.axes[2])))
        setattr(covered.scale, 'xyz'[thin], 0.01)
        _fill(covered, floor.covered(ways), [FADED_GREEN])
        return [path, covered]

    def _body(self, x_world: Array, agreement: Array) -> list[Marker]:
        there = np.flatnonzero(np.isfinite(x_world).all(-1))
        colours = [colour_of(float(share)) for share in agreement]
        joints = self._marker('joints', Marker.SPHERE_LIST, 0)
        joints.scale.x = joints.scale.y = joints.scale.z = JOINT_M
        _fill(joints, x_world[there], [colours[j] for j in there])
        ends = [j for bone in bones_there(x_world, self._edges) for j in bone]
        bones = self._lines('skeleton', x_world[ends], [colours[j] for j in ends], 1.5 * LINE_M)
        return [joints, bones]

    def _lines(
        self, name: str, points: Array, colours: Sequence[Rgba], width_m: float, number: int = 0
    ) -> Marker:
        marker = self._marker(name, Marker.LINE_LIST, number)
        marker.scale.x = width_m
        _fill(marker, points, colours)
        return marker

    def _text(self, name: str, number: int, at: Array, text: str) -> Marker:
        marker = self._marker(name, Marker.TEXT_VIEW_FACING, number)
        p = marker.pose.position
        p.x, p.y, p.z = (float(v) for v in at)
        marker.scale.z = TEXT_M
        marker.color = _colour((1.0, 1.0, 1.0, 1.0))
        marker.text = text
        return marker

    def _marker(self, name: str, kind: int, number: int) -> Marker:
        # Without a stamp a viewer takes the newest transform: the frame is the fixed one.
        marker = Marker(ns=name, id=number, type=kind, action=Marker.ADD)
        marker.header.frame_id = self._world_frame
        marker.pose.orientation.w = 1.0
        return marker


def _fill(marker: Marker, points: Array, colours: Sequence[Rgba]) -> None:
    """Give a marker its points, and one colour for all or one for each."""
    marker.points = [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in points]
    if len(colours) == 1:
        marker.color = _colour(colours[0])
    else:
        marker.color = _colour(GREY)
        marker.colors = [_colour(colour) for colour in colours]


def _colour(rgba: Rgba) -> ColorRGBA:
    r, g, b, a = rgba
    return ColorRGBA(r=float(r), g=float(g), b=float(b), a=float(a))


def _mean(agreement: Array) -> float:
    there = agreement[np.isfinite(agreement)]
    return float(there.mean()) if len(there) else math.nan
