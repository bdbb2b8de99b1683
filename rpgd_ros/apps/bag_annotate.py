# SPDX-License-Identifier: Apache-2.0
"""Copies a recording with what a calibration says, on the node's topics: for Foxglove and RViz.

/tf_static, <node>/transform, pose    the transform, once, latched
<node>/status, reprojection_error     how good it is, once, latched
<node>/skeleton_world                 every skeleton in the world
<node>/<camera>/reprojection          the skeleton in the image, at every keypoint message
<node>/markers                        bones in the world, cameras with their names
"""

from __future__ import annotations

import shutil
import struct
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from rpgd_ros.apps.bag_images import camera_stamps
from rpgd_ros.apps.bag_run import BagRun
from rpgd_ros.core import Camera, RigidTransform
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.io.bag import Bag, BagWriter, absolute_name, open_bag
from rpgd_ros.messages import POINT_CLOUD2, encode_point_cloud2
from rpgd_ros.messages.image import MAX_IMAGE_BYTES
from rpgd_ros.messages.markers import (
    FLOAT64,
    MARKER_ARRAY,
    POSE_WITH_COVARIANCE,
    STRING,
    TRANSFORM_STAMPED,
    Colour,
    Marker,
    encode_markers,
    encode_number,
    encode_pose,
    encode_text,
    encode_transform,
)
from rpgd_ros.messages.tf import TF_MESSAGE, Link, encode_tf
from rpgd_ros.report.room import pyramid
from rpgd_ros.skeletons import edges

NODE: Final = '/rpgd_calibrator'
TF_STATIC: Final = '/tf_static'
ONCE: Final = {
    'transform': TRANSFORM_STAMPED, 'pose': POSE_WITH_COVARIANCE, 'status': STRING,
    'reprojection_error': FLOAT64,
}  # fmt: skip
BONES_COLOUR: Final[Colour] = (0.95, 0.6, 0.1, 1.0)
CAMERA_COLOUR: Final[Colour] = (0.35, 0.6, 0.9, 1.0)
MOVED_COLOUR: Final[Colour] = (0.95, 0.2, 0.15, 1.0)
LINE_M, TEXT_M, ABOVE_M = 0.02, 0.2, 0.25
MARKERS_NS: Final = 100_000_000  # between two sets of markers: what a viewer shows smoothly
# A header begins after the encapsulation, or after the length of a sequence.
STAMP_PLACES: Final = (4, 8)

Progression = Callable[[str, float], None]


class Message(NamedTuple):
    """What is written: topic, type, payload."""

    topic: str
    msgtype: str
    payload: bytes


@dataclass(frozen=True, eq=False)
class Addition:
    """What is added to one stream.

    Attributes:
        rows: Instants by stamp.
        make: Returns the messages of an instant, given its row and stamp.

    """

    rows: dict[int, int]
    make: Callable[[int, int], Iterator[Message]]


def annotate(run: BagRun, path: Path, progress: Progression) -> list[str]:
    """Write the recording with the calibration in it.

    Args:
        run: An accepted run.
        path: One file where it ends in `.mcap`, else the folder of a rosbag2; must not exist.
        progress: Told the stage and the share done.

    Returns:
        What could not be copied, as sentences.

    Raises:
        InputError: NOT_WRITABLE.

    """
    is_file = path.suffix == '.mcap'
    if not is_file:
        return _write(run, BagWriter(path), progress)
    try:
        if path.exists() or path.is_symlink():
            msg = f'{path} exists already: remove it, or choose another place'
            raise InputError(Reason.NOT_WRITABLE, msg)
        with tempfile.TemporaryDirectory(prefix='.annotated.', dir=path.parent) as scratch:
            folder = Path(scratch) / 'bag'
            said = _write(run, BagWriter(folder, asked=path), progress)
            (file,) = folder.glob('*.mcap')
            shutil.move(file, path)
    except OSError as error:
        msg = f'{path} cannot be written: {error.strerror or error}'
        raise InputError(Reason.NOT_WRITABLE, msg) from error
    return said


def _write(run: BagRun, target: BagWriter, progress: Progression) -> list[str]:
    scene = _Scene(run)
    said: list[str] = []
    with open_bag(run.bag) as bag, target as writer:
        total = max(1, sum(info.n_messages for info in bag.topics.values()))
        copied = _declare(bag, writer, said)
        begun = False
        messages = bag.stream(copied, longest=MAX_IMAGE_BYTES)
        for n, (topic, recorded_ns, payload) in enumerate(messages):
            receive_ns = max(recorded_ns, 0)  # MCAP knows no time before 1970
            if not begun:
                for added in scene.begin():
                    writer.write(added.topic, added.msgtype, receive_ns, added.payload)
                begun = True
            writer.write(topic, copied[topic], receive_ns, payload)
            for added in scene.added(topic, payload):
                writer.write(added.topic, added.msgtype, receive_ns, added.payload)
            progress('annotating', (n + 1) / total)
    return said


def _declare(bag: Bag, writer: BagWriter, said: list[str]) -> dict[str, str]:
    """Announce all topics; return the types of those that can be copied."""
    definitions = bag.definitions()
    copied: dict[str, str] = {}
    for topic, info in bag.topics.items():
        if topic.startswith(f'{NODE}/'):
            said.append(f'{topic[:80]} of the recording is left out: it is written anew')
            continue
        try:
            is_latched = topic == TF_STATIC
            writer.declare(topic, info.msgtype, definitions.get(topic, ''), is_latched=is_latched)
        except InputError as error:
            said.append(f'not copied: {error.message}')
        else:
            copied[topic] = info.msgtype
    if TF_STATIC not in copied:
        writer.declare(TF_STATIC, TF_MESSAGE, is_latched=True)
    for name, msgtype in ONCE.items():
        writer.declare(f'{NODE}/{name}', msgtype, is_latched=True)
    return copied


class _Scene:
    """The calibration, as messages beside those of the recording."""

    def __init__(self, run: BagRun) -> None:
        if run.snapshot is None or run.calibration is None or run.observations is None:
            msg = 'there is no result to put into a recording'
            raise InputError(Reason.NO_DATA, msg)
        self._world_frame, self._mocap_frame = run.frames
        self._calibration = run.calibration
        self._pose = run.calibration.world_T_mocap
        self._skeletons: Array = run.snapshot.skeletons.values
        self._bones = edges(run.snapshot.joint_names)
        moved = {d.camera for d in run.calibration.disagreements}
        self._cameras = [
            marker
            for i, camera in enumerate(run.snapshot.cameras)
            for marker in _camera_markers(i, camera, is_moved=camera.name in moved)
        ]
        self._drawn_ns = 0
        stamps = run.snapshot.skeletons.stamp_ns.tolist()
        self._first_ns = stamps[0]
        rows = {stamp: row for row, stamp in enumerate(stamps)}
        topic = absolute_name(run.rig.mocap.topic)
        self._additions = {topic: Addition(rows, self._of_skeleton)}
        topics = {c.name: absolute_name(c.keypoints_topic) for c in run.rig.cameras}
        frames = {c.name: c.frame_id or c.name for c in run.rig.cameras}
        for v, camera in enumerate(run.snapshot.cameras):
            view = run.observations.views[v]
            uv = camera.project(self._pose @ view.x_mocap)
            sent = camera_stamps(run, run.observations, v).tolist()
            self._additions[topics[camera.name]] = Addition(
                {stamp: row for row, stamp in enumerate(sent)},
                _reprojection(camera.name, frames[camera.name], uv),
            )

    def begin(self) -> Iterator[Message]:
        """Yield what stands before everything else, at the time of the first skeleton.

        The recorder's own clock may have been anywhere.
        """
        stamp_ns = self._first_ns
        link = Link(self._world_frame, self._mocap_frame, self._pose, stamp_ns)
        yield Message(TF_STATIC, TF_MESSAGE, encode_tf([link]))
        c = self._calibration
        payloads = {
            'transform': encode_transform(
                stamp_ns, self._world_frame, self._mocap_frame, self._pose
            ),
            'pose': encode_pose(stamp_ns, self._world_frame, self._pose, c.covariance),
            'status': encode_text(
                f'Calibrated from the recording: {c.median_px:.1f} px (median), uncertain by '
                f'{c.sigma_rotation_deg:.2f} deg and {c.sigma_position_m * 1e3:.1f} mm.'
            ),
            'reprojection_error': encode_number(c.mpjpe_px),
        }
        for name, payload in payloads.items():
            yield Message(f'{NODE}/{name}', ONCE[name], payload)

    def added(self, topic: str, payload: bytes) -> Iterator[Message]:
        """Yield what follows a message of the recording, where its stamp was used."""
        addition = self._additions.get(topic)
        if addition is None:
            return
        for place in STAMP_PLACES:
            stamp_ns = _stamp(payload, place)
            row = addition.rows.get(stamp_ns)
            if row is not None:
                yield from addition.make(row, stamp_ns)
                return

    def _of_skeleton(self, row: int, stamp_ns: int) -> Iterator[Message]:
        x_world = self._pose @ self._skeletons[row]
        cloud = encode_point_cloud2(stamp_ns, self._world_frame, x_world)
        yield Message(f'{NODE}/skeleton_world', POINT_CLOUD2, cloud)
        if abs(stamp_ns - self._drawn_ns) >= MARKERS_NS:
            self._drawn_ns = stamp_ns
            ends = x_world[[j for bone in self._bones for j in bone]].reshape(-1, 3)
            bones = Marker('skeleton', 0, ends, BONES_COLOUR, LINE_M)
            array = encode_markers(stamp_ns, self._world_frame, [bones, *self._cameras])
            yield Message(f'{NODE}/markers', MARKER_ARRAY, array)


def _reprojection(name: str, frame_id: str, uv: Array) -> Callable[[int, int], Iterator[Message]]:
    topic = f'{NODE}/{name}/reprojection'

    def make(row: int, stamp_ns: int) -> Iterator[Message]:
        yield Message(topic, POINT_CLOUD2, encode_point_cloud2(stamp_ns, frame_id, uv[row]))

    return make


def _camera_markers(number: int, camera: Camera, *, is_moved: bool) -> Iterator[Marker]:
    line = pyramid(camera)
    lines = np.stack([line[:-1], line[1:]], 1).reshape(-1, 3)
    colour = MOVED_COLOUR if is_moved else CAMERA_COLOUR
    yield Marker('camera', number, lines, colour, LINE_M)
    pose = (camera.camera_T_world or RigidTransform.identity()).inverse()
    above = pose @ np.array([[0.0, -ABOVE_M, 0.0]])
    yield Marker('camera_name', number, above, colour, TEXT_M, camera.name)


def _stamp(payload: bytes, place: int) -> int:
    """Return the stamp at a place of a message, -1 where it has no bytes there."""
    if len(payload) < place + 8:
        return -1
    mark = '<' if payload[1] & 1 else '>'
    seconds, nanoseconds = struct.unpack_from(f'{mark}iI', payload, place)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
