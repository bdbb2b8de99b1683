# SPDX-License-Identifier: Apache-2.0
"""A scene: who walks where, before which cameras, with which faults; and its simulation."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, IntArray, RigidTransform, rotation_from_quat_xyzw
from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.simulation.body import Body, Pose
from rpgd_ros.simulation.company import Company, record_company
from rpgd_ros.simulation.detector import Shot, detect
from rpgd_ros.simulation.faults import BiasFrame, Faults
from rpgd_ros.simulation.gait import rot_z
from rpgd_ros.simulation.joints import landmarks_of
from rpgd_ros.simulation.motion import MARGIN_S, MotionName
from rpgd_ros.simulation.presets import Preset
from rpgd_ros.simulation.recording import CameraStream, MocapStream, SimulatedRecording, Truth
from rpgd_ros.simulation.rigs import build_rig
from rpgd_ros.skeletons import joint_names, mirror

EPOCH_NS = 1_735_689_600_000_000_000  # 2025-01-01: stamps of a recording look like real ones
MOCAP_ORIGIN_M = 2.0  # the MoCap origin lies anywhere within this of the world's, per axis
MAX_LAG_S = 0.75 * MARGIN_S  # the body's course reaches only so far beyond the recording
MAX_PERSONS = 20
COMPANY = 100  # first stage of the random numbers of other people
N_CONTROL = 8  # points of the body whose place in both frames the truth file tells


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Everything that is settled before time runs.

    Attributes:
        preset: Settings.
        seed: Of everything random.
        seconds: Length of the recording.
        cameras: The rig, as it hangs.
        body: The person who carries the markers.
        bystander: Somebody else, for detectors that follow the wrong one.
        world_T_mocap: The truth that a calibration has to find.
        faults: What goes wrong.
        others: Who else is in view.
        n_subjects: Persons with MoCap: the first, and of the others the first ones.

    """

    preset: Preset
    seed: int
    seconds: float
    cameras: tuple[Camera, ...]
    body: Body
    bystander: Body
    world_T_mocap: RigidTransform
    faults: Faults
    others: tuple[Body, ...] = ()
    n_subjects: int = 1

    @property
    def lags_s(self) -> tuple[float, ...]:
        """One lag per camera, seconds."""
        lag = self.faults.lag_s
        return lag if isinstance(lag, tuple) else (lag,) * len(self.cameras)


def build_scene(
    preset: Preset,
    seed: int,
    *,
    seconds: float = 60.0,
    motion: MotionName = 'walk',
    centre: tuple[float, float] = (0.0, 0.0),
    faults: Faults | None = None,
    persons: int = 1,
    subjects: int = 1,
) -> Scene:
    """Draw a scene.

    The same seed gives the same rig, walk, transform and noise whatever the faults are, and
    whoever else is there.

    Args:
        preset: Settings.
        seed: Of everything random.
        seconds: Length of the recording, at most a day.
        motion: What the person does.
        centre: Where on the floor, metres.
        faults: What goes wrong; None = nothing beyond the preset.
        persons: How many are in view.
        subjects: How many of them have MoCap.

    Raises:
        InputError: A length that is not positive, an unknown motion, numbers of persons that
            cannot be.

    """
    _check_persons(persons, subjects)
    if not 0.0 < seconds <= 86400.0:
        msg = f'the length must be above 0 s and at most a day, got {seconds}'
        raise InputError(Reason.BAD_INPUT, msg)
    rng_rig, rng_body, rng_other, rng_pose = (_rng(preset, seed, stage) for stage in range(4))
    return Scene(
        preset=preset,
        seed=seed,
        seconds=seconds,
        cameras=build_rig(preset.rig, rng_rig),
        body=Body.draw(rng_body, motion, seconds=seconds, area_m=preset.area_m, centre=centre),
        bystander=Body.draw(rng_other, seconds=seconds, area_m=preset.area_m, centre=centre),
        world_T_mocap=RigidTransform(
            rotation_from_quat_xyzw(rng_pose.standard_normal(4)),
            rng_pose.uniform(-MOCAP_ORIGIN_M, MOCAP_ORIGIN_M, 3),
        ),
        faults=faults or Faults(),
        others=tuple(
            Body.draw(
                _rng(preset, seed, COMPANY + number), seconds=seconds, area_m=preset.area_m,
                centre=centre,
            )
            for number in range(1, persons)
        ),
        n_subjects=subjects,
    )  # fmt: skip


def simulate(
    scene: Scene, *, progress: Callable[[str, float], None] | None = None
) -> SimulatedRecording:
    """Let time run, and record what the MoCap system and the detectors report.

    Args:
        scene: What to record.
        progress: Called with a stage and the fraction of it that is done.

    Raises:
        InputError: Lags that do not fit the cameras or the course.

    """
    _check_lags(scene)
    rng_mocap, rng_clock, rng_detector = (_rng(scene.preset, scene.seed, s) for s in range(4, 7))
    clocks = _camera_clocks(scene, rng_clock)
    landmarks = landmarks_of(scene.preset.keypoint_joints)
    detections, sigma_px = detect(
        _film(scene, [capture for _, capture in clocks], landmarks, progress),
        scene.preset.detector,
        scene.faults.corruption,
        mirror=np.array(mirror(joint_names(scene.preset.keypoint_joints))),
        hz=scene.preset.camera_hz,
        rng=rng_detector,
    )
    delay_ns = round(scene.preset.keypoint_delay_s * NS_PER_S)
    mocap, control_world, control_mocap = _record_mocap(scene, rng_mocap)
    return SimulatedRecording(
        preset=scene.preset,
        seed=scene.seed,
        cameras=scene.cameras,
        mocap=mocap,
        streams=tuple(
            CameraStream(stamp_ns, stamp_ns + delay_ns, d.uv, d.confidence)
            for (stamp_ns, _), d in zip(clocks, detections, strict=True)
        ),
        truth=Truth(
            world_T_mocap=scene.world_T_mocap,
            inliers=tuple(d.is_inlier for d in detections),
            sigma_px=sigma_px,
            student_nu=scene.preset.detector.student_nu,
            sigma_m=scene.preset.joint_noise_m,
            lags_s=scene.lags_s,
            faults=scene.faults,
            control_world=control_world,
            control_mocap=control_mocap,
        ),
        company=_company(scene, [capture for _, capture in clocks]),
    )


def _company(scene: Scene, captures: Sequence[Array]) -> Company | None:
    preset = scene.preset
    if not scene.others:
        return None
    frames = max(1, round(scene.seconds * preset.mocap_hz))
    return record_company(
        preset,
        scene.cameras,
        scene.others,
        n_subjects=scene.n_subjects,
        captures=captures,
        mocap_t=np.arange(frames) / preset.mocap_hz,
        world_T_mocap=scene.world_T_mocap,
        rng=_rng(preset, scene.seed, COMPANY),
    )


def _rng(preset: Preset, seed: int, stage: int) -> np.random.Generator:
    """Return a stream of its own for each stage, so that none shifts when another draws more."""
    return np.random.default_rng([seed, zlib.crc32(preset.name.encode()), stage])


def _check_persons(persons: int, subjects: int) -> None:
    if not 1 <= subjects <= persons <= MAX_PERSONS:
        msg = (
            f'need 1 to {MAX_PERSONS} persons and as many or fewer with MoCap, got {persons} '
            f'and {subjects}'
        )
        raise InputError(Reason.BAD_INPUT, msg)


def _check_lags(scene: Scene) -> None:
    lags = scene.lags_s
    if len(lags) != len(scene.cameras):
        msg = f'{len(lags)} lags for {len(scene.cameras)} cameras: give one, or one per camera'
        raise InputError(Reason.BAD_INPUT, msg)
    if not all(abs(lag) <= MAX_LAG_S for lag in lags):  # False for NaN
        msg = f'lags must be within {MAX_LAG_S} s, got {lags}'
        raise InputError(Reason.BAD_INPUT, msg)


def _camera_clocks(scene: Scene, rng: np.random.Generator) -> list[tuple[IntArray, Array]]:
    """Return per camera its stamps (F,), ns, and the instants (F,) that it sees, seconds."""
    preset = scene.preset
    frames = max(1, round(scene.seconds * preset.camera_hz))
    clocks = []
    for lag in scene.lags_s:
        stamp = np.arange(frames) / preset.camera_hz
        jitter = np.zeros(frames)
        if not preset.is_synchronous:
            stamp += rng.uniform(0.0, 1.0 / preset.camera_hz)
            jitter = _jitter(rng, preset.camera_jitter_s, frames, preset.camera_hz)
        clocks.append((_to_ns(stamp + jitter), stamp - lag))
    return clocks


def _jitter(rng: np.random.Generator, sigma_s: float, n: int, hz: float) -> Array:
    """Return errors of stamps (n,), seconds; bounded, so that stamps never pass each other."""
    return np.clip(rng.normal(0.0, sigma_s, n), -0.4 / hz, 0.4 / hz)


def _to_ns(seconds: Array) -> IntArray:
    return EPOCH_NS + np.round(seconds * NS_PER_S).astype(np.int64)


def _film(
    scene: Scene,
    captures: Sequence[Array],
    landmarks: Sequence[str],
    progress: Callable[[str, float], None] | None,
) -> list[Shot]:
    """Project the bodies into each camera at the instants (F,) that it sees, seconds."""
    needs_other = scene.faults.corruption.needs_other
    shots = []
    seen: tuple[Array, Array | None] | None = None
    for number, (camera, capture) in enumerate(zip(scene.cameras, captures, strict=True)):
        # Cameras with a common trigger see the same instants: move the bodies once for all.
        if seen is None or not np.array_equal(capture, captures[number - 1]):
            seen = (
                scene.body.at(capture).place(landmarks),
                scene.bystander.at(capture).place(landmarks) if needs_other else None,
            )
        x_body, x_other = seen
        uv_other = None if x_other is None else camera.project(x_other)
        shots.append(Shot.of(camera, camera.project(x_body), uv_other))
        if progress:
            progress('filming', (number + 1) / len(scene.cameras))
    return shots


def _record_mocap(scene: Scene, rng: np.random.Generator) -> tuple[MocapStream, Array, Array]:
    """Return the MoCap's stream, and control points (N, 3) in the world and in its frame."""
    preset = scene.preset
    frames = max(1, round(scene.seconds * preset.mocap_hz))
    t = np.arange(frames) / preset.mocap_hz
    landmarks = landmarks_of(preset.mocap_joints)
    pose = scene.body.at(t)
    x_world = pose.place(landmarks)
    rotation, origin = scene.world_T_mocap.rotation, scene.world_T_mocap.translation
    # Written out, not by RigidTransform: the truth must not share its convention by accident.
    x_mocap = (x_world - origin) @ rotation
    last = x_world.shape[0] - 1
    pick = np.unique(np.linspace(0, last, N_CONTROL).astype(np.int64))
    joint = np.arange(len(pick)) * 5 % len(landmarks)
    control_world, control_mocap = x_world[pick, joint], x_mocap[pick, joint]
    offsets = rng.normal(0.0, 1.0, (len(landmarks), 3)) * scene.faults.bias_m
    frame = _bias_frame(pose, landmarks, scene.faults.bias_frame)
    x_mocap = x_mocap + (frame @ offsets[..., None])[..., 0] @ rotation
    x_mocap += rng.normal(0.0, 1.0, x_mocap.shape) * preset.joint_noise_m
    stamp_ns = _to_ns(t + _jitter(rng, preset.mocap_jitter_s, frames, preset.mocap_hz))
    delay_ns = round(preset.mocap_delay_s * NS_PER_S)
    return MocapStream(stamp_ns, stamp_ns + delay_ns, x_mocap), control_world, control_mocap


def _bias_frame(pose: Pose, landmarks: Sequence[str], frame: BiasFrame) -> Array:
    """Return rotations (T, J or 1, 3, 3) of the frames in which joints keep their offsets."""
    if frame == 'bone':
        return pose.segment_frames(landmarks)
    return rot_z(pose.heading)[:, None]
