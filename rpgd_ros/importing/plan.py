# SPDX-License-Identifier: Apache-2.0
"""What becomes of the files of a shoot: streams on one clock, and what is odd about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.importing.keypoints import Detections
from rpgd_ros.importing.skeleton import MAX_FPS, MIN_FPS, SAME_RATE, Skeleton
from rpgd_ros.importing.tempo import better_rate
from rpgd_ros.importing.text import LONGEST_S, refuse
from rpgd_ros.io.rig_types import KeypointUnits
from rpgd_ros.skeletons import CONVENTIONS, joint_names, match_joints


def _words(text: str) -> tuple[str, ...]:
    return tuple(text.split())


# Orders that detectors write beside the published conventions of `skeletons`; named as Pose2Sim
# names them, so that its TRC files match by name.
ORDERS: Final[Mapping[str, tuple[str, ...]]] = {
    'body25b': _words(
        'Nose LEye REye LEar REar LShoulder RShoulder LElbow RElbow LWrist RWrist LHip RHip LKnee '
        'RKnee LAnkle RAnkle Neck Head LBigToe LSmallToe LHeel RBigToe RSmallToe RHeel'
    ),
    'coco18': _words(
        'Nose Neck RShoulder RElbow RWrist LShoulder LElbow LWrist RHip RKnee RAnkle LHip LKnee '
        'LAnkle REye LEye REar LEar'
    ),
}
COMMON_FPS: Final = (24, 25, 29.97, 30, 50, 59.94, 60, 100, 119.88, 120, 240)
NTSC: Final = 0.002  # 30 Hz may mean 29.97
SAME_LENGTH: Final = 0.005  # by chance, one pair of recordings in thirty agrees as well
OTHER_RATE: Final = 0.02
NORMALIZED: Final = 1.5  # keypoints of a person beyond the edge of the image
OUTSIDE: Final = 0.1  # share of keypoints outside the image, where sizes do not belong together


@dataclass(frozen=True, slots=True, eq=False)
class CameraPlan:
    """One camera with its detections on the clock of the skeleton file.

    Attributes:
        camera: Calibrated.
        detections: As read.
        joints: (K,) keypoint names.
        pairs: (MoCap joint, keypoint) indices.
        fps: Frames per second.
        units: Of the keypoints.
        time_s: (F,) seconds.
        warnings: What looks wrong.

    """

    camera: Camera
    detections: Detections
    joints: tuple[str, ...]
    pairs: tuple[tuple[int, int], ...]
    fps: float
    units: KeypointUnits
    time_s: Array
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A recording that can be written.

    Attributes:
        skeleton: Of the MoCap.
        cameras: At least one.
        world_frame: Name of the frame of the calibration.
        timecode: How timecodes were taken; '' = none was used.
        warnings: What looks wrong beside what skeleton and cameras say.

    """

    skeleton: Skeleton
    cameras: tuple[CameraPlan, ...]
    world_frame: str
    timecode: str = ''
    warnings: tuple[str, ...] = ()


def keypoint_joints(text: str) -> tuple[str, ...]:
    """Return the keypoints that an option names: a convention, or names between commas.

    Raises:
        InputError: BAD_RIG.

    """
    if text in ORDERS:
        return ORDERS[text]
    return joint_names([n.strip() for n in text.split(',')] if ',' in text else text)


def plan_camera(
    skeleton: Skeleton,
    camera: Camera,
    detections: Detections,
    *,
    joints: tuple[str, ...] | None,
    fps: float,
    start_s: float | None = None,
    first_frame: int | None = None,
    joint_map: Mapping[str, str | None] | None = None,
    units: KeypointUnits = 'pixels',
) -> CameraPlan:
    """Put the detections of a camera beside the skeleton.

    Args:
        skeleton: Of the MoCap.
        camera: That filmed it.
        detections: Of its video.
        joints: Keypoint names; None = those that the files state.
        fps: Frames per second of the video.
        start_s: Time of the skeleton file at which the camera took its first frame; None = 0,
            not said.
        first_frame: Number of its first frame; None = 1 where that is the first there is, else 0.
        joint_map: As `skeletons.match_joints`.
        units: Of the keypoints.

    Raises:
        InputError: BAD_INPUT, BAD_RIG or WRONG_UNIT; files that do not belong together.

    """
    path = detections.path
    _check_length(camera.name, detections, fps)
    names = _names(detections, joints)
    try:
        pairs = match_joints(skeleton.joints, names, joint_map)
    except InputError as error:
        source = skeleton.source
        msg = f'{source.at(source.joints_line)}, {path}: {error.message}'
        raise InputError(error.reason, f'{msg} (--joint-map KEYPOINT=JOINT)') from None
    first, doubts = _first_frame(camera.name, detections, first_frame)
    time_s = (start_s or 0.0) + (detections.frames - first) / fps
    begin, end = float(skeleton.time_s[0]), float(skeleton.time_s[-1])
    if time_s[-1] < begin or time_s[0] > end:
        msg = (
            f'camera {camera.name} runs from {time_s[0]:.3f} to {time_s[-1]:.3f} s, the skeleton '
            f'from {begin:.3f} to {end:.3f} s: they never meet. Give --camera-start '
            f'{camera.name}=SECONDS, the time of the skeleton file at its first frame, or check '
            'its timecode'
        )
        refuse(path, None, msg)
    if start_s is None:
        _check_rate(skeleton, camera.name, detections, fps)
    warnings = doubts + _check_pixels(camera, detections, units)
    slow = _tempo(skeleton, camera.name, detections, pairs, fps, float(time_s[0]))
    if slow and start_s is None:
        refuse(path, None, slow)
    warnings += (slow,) if slow else ()
    return CameraPlan(camera, detections, names, pairs, fps, units, time_s, warnings)


def _first_frame(
    name: str, detections: Detections, asked: int | None
) -> tuple[int, tuple[str, ...]]:
    """Return the number that the first frame of a video has, and what is doubtful about it."""
    lowest = detections.first
    if asked is not None:
        if lowest < asked:
            msg = f'has a frame {lowest}, but --first-frame says {asked} for camera {name}'
            refuse(detections.path, None, msg)
        return asked, ()
    first = 1 if lowest == 1 else 0
    if lowest == 0 or (lowest == 1 and detections.is_whole):
        return first, ()
    warning = (
        f'camera {name}: the lowest frame number is {lowest}, so that frames may be numbered from '
        f'0 or 1: taken from {first}, else all come a frame off: give --first-frame {name}=0 or '
        f'{name}=1'
    )
    return first, (warning,)


def _check_length(name: str, detections: Detections, fps: float) -> None:
    """Refuse rates that no camera has, and frame numbers that are dates or damaged."""
    if not MIN_FPS <= fps <= MAX_FPS:
        msg = f'camera {name}: {fps:g} is no frame rate, need {MIN_FPS:g} to {MAX_FPS:g} Hz'
        raise InputError(Reason.BAD_INPUT, msg)
    first, last = detections.first, int(detections.frames[-1])
    if (last - first) / fps > LONGEST_S:
        msg = (
            f'frames {first} to {last} last {(last - first) / fps:g} s at {fps:g} Hz, more than a '
            f'day ({LONGEST_S:g} s): correct the numbers, or split the recording'
        )
        refuse(detections.path, None, msg)


def _names(detections: Detections, joints: tuple[str, ...] | None) -> tuple[str, ...]:
    names = joints or detections.joints
    if names is None:
        known = {**CONVENTIONS, **ORDERS}
        fitting = [name for name, order in known.items() if len(order) == detections.n_joints]
        hint = f'{" or ".join(fitting)} would fit' if fitting else 'no convention has as many'
        msg = f'{detections.n_joints} keypoints without names: give --keypoint-joints ({hint})'
        refuse(detections.path, None, msg)
    if len(names) != detections.n_joints:
        msg = f'{detections.n_joints} keypoints, but {len(names)} names: check --keypoint-joints'
        refuse(detections.path, None, msg)
    return names


def _check_rate(skeleton: Skeleton, name: str, detections: Detections, fps: float) -> None:
    """Refuse a frame rate where another, common one would make both recordings equally long."""
    length_s = float(skeleton.time_s[-1] - skeleton.time_s[0])
    steps = float(detections.frames[-1] - detections.first)
    if abs(steps / fps / length_s - 1.0) <= OTHER_RATE:
        return
    for rate in reversed(COMMON_FPS):
        if abs(steps / rate / length_s - 1.0) <= SAME_LENGTH and abs(rate / fps - 1) > OTHER_RATE:
            msg = (
                f'{steps + 1:.0f} frames at {fps:g} Hz last {steps / fps:.2f} s, the skeleton '
                f'{length_s:.2f} s; at {rate:g} Hz both would last the same: give --camera-fps '
                f'{name}={rate:g} ({_or_mocap(skeleton, fps, rate)}), or say that it is chance '
                f'with --camera-start {name}=0'
            )
            refuse(detections.path, None, msg)


def _or_mocap(skeleton: Skeleton, fps: float, rate: float) -> str:
    """Return the other ways to make a video at one rate fit a skeleton that asks for another."""
    source = skeleton.source
    is_asked = abs(skeleton.fps / (source.frame_fps or source.fps) - 1.0) > SAME_RATE
    place = '--mocap-fps' if is_asked else source.at(source.fps_line)
    near = [f'{r:g}, ' for r in COMMON_FPS if 0.0 < abs(r / rate - 1.0) < NTSC]
    other = f'--mocap-fps {skeleton.fps * fps / rate:.4g}, if the rate of {place} is wrong'
    return f'or {"".join(near)}or {other}' if near else f'or {other}'


def _tempo(
    skeleton: Skeleton,
    name: str,
    detections: Detections,
    pairs: tuple[tuple[int, int], ...],
    fps: float,
    begin_s: float,
) -> str:
    """Say at which frame rate the video shows the motion of the skeleton, if not at its own."""
    joints, keypoints = ([pair[i] for pair in pairs] for i in (0, 1))
    rate = better_rate(
        (skeleton.time_s, skeleton.x_mocap[:, joints]),
        (detections.frames, detections.uv[:, keypoints]),
        fps,
        [r for r in COMMON_FPS if abs(r / fps - 1.0) > OTHER_RATE],
        begin_s - float(detections.frames[0]) / fps - float(skeleton.time_s[0]),
    )
    if rate is None:
        return ''
    return (
        f'at {fps:g} Hz the motion of camera {name} is not that of the skeleton, at {rate:g} Hz '
        f'it is: give --camera-fps {name}={rate:g} ({_or_mocap(skeleton, fps, rate)}), or say '
        f'that {fps:g} is right with --camera-start {name}=SECONDS'
    )


def _check_pixels(camera: Camera, detections: Detections, units: KeypointUnits) -> tuple[str, ...]:
    uv = detections.uv[np.isfinite(detections.uv).all(-1)]
    if not len(uv):
        refuse(detections.path, None, 'all keypoints are missing: check --min-score')
    if units == 'pixels' and np.abs(uv).max() <= NORMALIZED:
        msg = 'the keypoints lie within 0 to 1: give --keypoint-units normalized'
        refuse(detections.path, None, msg, Reason.WRONG_UNIT)
    if units == 'normalized':
        if np.median(np.abs(uv)) > NORMALIZED:
            msg = f'keypoints up to {uv.max():.0f} are no shares of the image: they are pixels'
            refuse(detections.path, None, msg, Reason.WRONG_UNIT)
        uv = uv * camera.size
    outside = ((uv < -0.5) | (uv > np.array(camera.size) - 0.5)).any(1).mean()
    if outside <= OUTSIDE:
        return ()
    width, height = camera.size
    warning = (
        f'camera {camera.name}: {outside:.0%} of the keypoints lie outside its {width} x {height} '
        f'image, up to ({uv[:, 0].max():.0f}, {uv[:, 1].max():.0f}): were calibration and '
        'detection made at the same video size?'
    )
    return (warning,)
