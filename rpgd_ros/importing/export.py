# SPDX-License-Identifier: Apache-2.0
"""Writes a plan as a bag and a rig file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, IntArray
from rpgd_ros.importing.plan import CameraPlan, Plan
from rpgd_ros.importing.skeleton import origin
from rpgd_ros.io.bag import BagWriter, absolute_name
from rpgd_ros.io.bag_writer import Storage
from rpgd_ros.io.rig import MocapSource, Rig, RigCamera, parse_rig, rig_text, write_rig
from rpgd_ros.messages import POINT_CLOUD2, encode_point_cloud2

MOCAP_TOPIC: Final = 'mocap/skeleton'
MOCAP_FRAME: Final = 'mocap'
BAG, RIG = 'bag', 'rig.yaml'
# The files carry no date, and a stamp of 0 would be a missing one: second 0 is 2000-01-01.
START_NS: Final = 946_684_800 * 10**9
PROGRESS_EVERY: Final = 500  # messages: a tenth of a second


def check_plan(plan: Plan) -> None:
    """Refuse what would give a rig file that does not read back.

    Raises:
        InputError: BAD_RIG.

    """
    parse_rig(rig_text(rig_of(plan)), RIG)
    if plan.world_frame == MOCAP_FRAME:
        msg = f'{RIG}: world_frame: {MOCAP_FRAME!r} is the frame of the skeletons: name another'
        raise InputError(Reason.BAD_RIG, msg)


def stamps(time_s: Array, origin_s: float = 0.0) -> IntArray:
    """Return stamps (T,), ns, of times (T,), seconds, of which `origin_s` becomes 2000-01-01."""
    return START_NS + np.round((time_s - origin_s) * 1e9).astype(np.int64)


def write_plan(
    plan: Plan,
    folder: Path,
    *,
    storage: Storage = 'mcap',
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write `bag` and `rig.yaml` into an existing, empty folder.

    Args:
        plan: What to write.
        folder: Where.
        storage: Format of the bag.
        progress: Called with the fraction that is written.

    Raises:
        InputError: NOT_WRITABLE.

    """
    total = len(plan.skeleton.time_s) + sum(len(c.time_s) for c in plan.cameras)
    with BagWriter(folder / BAG, storage=storage) as bag:
        for i, (topic, stamp_ns, payload) in enumerate(_messages(plan)):
            bag.write(absolute_name(topic), POINT_CLOUD2, stamp_ns, payload)
            if progress and i % PROGRESS_EVERY == 0:
                progress(i / total)
    write_rig(folder / RIG, rig_of(plan))


def _messages(plan: Plan) -> Iterator[tuple[str, int, bytes]]:
    """Yield topic, stamp and message in the order of time."""
    streams = [plan.skeleton.time_s, *(c.time_s for c in plan.cameras)]
    # Seconds of Unix, added to that day, are more than a stamp can hold.
    origin_s = origin(min(float(time_s[0]) for time_s in streams))
    stamp_ns = [stamps(time_s, origin_s) for time_s in streams]
    stream_of = np.repeat(np.arange(len(stamp_ns)), [len(s) for s in stamp_ns])
    row_of = np.concatenate([np.arange(len(s)) for s in stamp_ns])
    order = np.lexsort((stream_of, np.concatenate(stamp_ns)))
    for stream, row in zip(stream_of[order].tolist(), row_of[order].tolist(), strict=True):
        stamp = int(stamp_ns[stream][row])
        if stream == 0:
            payload = encode_point_cloud2(stamp, MOCAP_FRAME, plan.skeleton.x_mocap[row])
            yield MOCAP_TOPIC, stamp, payload
        else:
            yield _keypoints(plan.cameras[stream - 1], row, stamp)


def _keypoints(plan: CameraPlan, row: int, stamp: int) -> tuple[str, int, bytes]:
    name, found = plan.camera.name, plan.detections
    payload = encode_point_cloud2(stamp, optical_frame(name), found.uv[row], found.scores[row])
    return f'{name}/keypoints', stamp, payload


def optical_frame(camera: str) -> str:
    """Return the name of a camera's frame (REP 103)."""
    return f'{camera}_optical_frame'


def rig_of(plan: Plan) -> Rig:
    """Return the rig file's content."""
    return Rig(
        world_frame=plan.world_frame,
        mocap=MocapSource(topic=MOCAP_TOPIC, joints=plan.skeleton.joints),
        cameras=tuple(
            RigCamera(
                name=c.camera.name,
                keypoints_topic=f'{c.camera.name}/keypoints',
                keypoint_joints=c.joints,
                pairs=c.pairs,
                camera=c.camera,
                units=c.units,
                extrinsics=c.camera.camera_T_world,
            )
            for c in plan.cameras
        ),
    )
