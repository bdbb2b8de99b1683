# SPDX-License-Identifier: Apache-2.0
"""Scenes by name: a studio, and twins of the datasets that the method was published with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.simulation.rigs import RigPlan, ring

OutlierKind = Literal['uniform', 'swap', 'person', 'failure', 'mixed']


@dataclass(frozen=True, slots=True)
class Detector:
    """How a 2D pose detector errs by itself.

    Attributes:
        sigma_px: Noise per axis, pixels; not used where `mean_error_px` is given.
        mean_error_px: Mean error at the true pose, own swaps and failures included, to which the
            noise is scaled, pixels; 0 = `sigma_px` holds.
        student_nu: Degrees of freedom of Student's t; 0 = Gaussian.
        keypoint_dropout: Share of single keypoints that are missed.
        frame_dropout: Share of frames in which a camera reports nobody.
        swap_ratio: Share of views with left and right exchanged.
        failure_ratio: Share of views with all joints around a random place.

    """

    sigma_px: float = 0.0
    mean_error_px: float = 0.0
    student_nu: float = 0.0
    keypoint_dropout: float = 0.03
    frame_dropout: float = 0.0
    swap_ratio: float = 0.0
    failure_ratio: float = 0.0


@dataclass(frozen=True, slots=True)
class Preset:
    """Everything of a scene that is not drawn by the seed.

    Attributes:
        name: What `simulate --preset` calls it.
        rig: The cameras.
        mocap_joints: Convention of the skeleton.
        keypoint_joints: Convention of the detector.
        area_m: Side of the square that the person crosses, metres.
        mocap_hz: Rate of the MoCap system.
        camera_hz: Rate of the cameras.
        detector: How keypoints err.
        joint_noise_m: Noise of the skeleton per axis, metres.
        is_synchronous: One clock and one trigger for everything; otherwise each camera runs at a
            phase of its own and stamps jitter.
        camera_jitter_s: Standard deviation of a camera's stamps, seconds.
        mocap_jitter_s: Standard deviation of the MoCap's stamps, seconds.
        mocap_delay_s: From the capture to the arrival of a skeleton's message, seconds.
        keypoint_delay_s: From the capture to the arrival of a detection's message, seconds.

    """

    name: str
    rig: RigPlan
    mocap_joints: str
    keypoint_joints: str
    area_m: float
    mocap_hz: float
    camera_hz: float
    detector: Detector
    joint_noise_m: float = 0.0
    is_synchronous: bool = True
    camera_jitter_s: float = 0.0
    mocap_jitter_s: float = 0.0
    mocap_delay_s: float = 0.005  # MoCap servers stream 3 to 8 ms after the exposure
    keypoint_delay_s: float = 0.1  # network, decoding, inference: 0.1 to 0.5 s in real systems


STUDIO = Preset(
    name='studio',
    # Four corners of a 6 x 6 m room, above head height, with 6 mm lenses on 1/1.8 inch sensors.
    rig=RigPlan(
        mounts=tuple((x, y, 2.4) for x in (-2.9, 2.9) for y in (-2.9, 2.9)),
        size=(1920, 1080),
        focal_px=1150.0,
        distortion=(-0.20, 0.08, 0.0005, -0.0005, -0.01),
        target=(0.0, 0.0, 0.9),
    ),
    mocap_joints='plug_in_gait',
    keypoint_joints='coco17',
    area_m=4.0,  # a metre of floor is left along the walls
    mocap_hz=120.0,
    camera_hz=30.0,
    # Detectors on sharp HD images of a person at 4 m: 2 to 3 px, tails heavier than a Gaussian's.
    detector=Detector(sigma_px=2.0, student_nu=5.0, frame_dropout=0.01, swap_ratio=0.01),
    joint_noise_m=0.001,  # marker-based joint centres repeat to a millimetre
    is_synchronous=False,
    camera_jitter_s=0.001,  # stamps given on arrival of the image by a PTP-disciplined host
    mocap_jitter_s=0.0002,
)

MPI_INF_3DHP = Preset(
    name='mpi_inf_3dhp',
    # 14 square cameras at three heights: knee, chest, and looking down.
    rig=RigPlan(
        mounts=(
            *ring(5, radius=4.3, height=1.4),
            *ring(5, radius=4.3, height=0.6, start_deg=27.0),
            *ring(4, radius=3.0, height=2.9, start_deg=10.0),
        ),
        size=(2048, 2048),
        focal_px=1500.0,
    ),
    mocap_joints='mpi28',
    keypoint_joints='mpi28',
    area_m=4.0,
    mocap_hz=25.0,
    camera_hz=25.0,
    # 2D projected from 3D: only rounding is left. The publication's error at ground truth.
    detector=Detector(mean_error_px=0.1607),
)

HUMAN36M = Preset(
    name='human36m',
    # Four cameras in the corners of the laboratory at eye height.
    rig=RigPlan(
        mounts=tuple((x, y, 1.55) for x in (-3.9, 3.9) for y in (-4.6, 4.6)),
        size=(1000, 1000),
        focal_px=1146.0,
        distortion=(-0.20, 0.24, -0.001, -0.001, -0.003),
        target=(0.0, 0.0, 0.95),
        mount_scatter_m=0.2,
    ),
    mocap_joints='h36m32',
    keypoint_joints='h36m32',
    area_m=4.0,
    mocap_hz=50.0,
    camera_hz=50.0,
    detector=Detector(mean_error_px=1.2299),  # the publication's error at ground truth
)

AISTPP = Preset(
    name='aistpp',
    # Eight cameras around the dancer, and a ninth beside the frontal one.
    rig=RigPlan(
        mounts=(
            *ring(8, radius=5.2, height=1.5),
            *ring(1, radius=5.2, height=1.5, start_deg=36.0),
        ),
        size=(1920, 1080),
        focal_px=1150.0,
        distortion=(-0.12, 0.09, 0.0006, -0.0006, -0.02),
        mount_scatter_m=0.15,
    ),
    mocap_joints='coco17',
    keypoint_joints='coco17',
    area_m=4.0,
    mocap_hz=60.0,
    camera_hz=60.0,
    # The publication's error at ground truth, made of a detector's heavy tails, of 4 % views with
    # left and right exchanged and of 0.3 % views that failed: its 3D comes from the same 2D.
    detector=Detector(mean_error_px=8.2837, student_nu=3.0, swap_ratio=0.04, failure_ratio=0.003),
)

KINECT = Preset(
    name='kinect',
    # A depth sensor's skeleton and one separate colour camera in front of the person.
    rig=RigPlan(
        mounts=((0.0, -3.3, 1.4),),
        size=(1920, 1080),
        focal_px=1400.0,
        distortion=(0.08, -0.16, 0.0005, -0.0005, 0.05),
    ),
    mocap_joints='kinect20',
    keypoint_joints='kinect20',
    area_m=2.4,  # the sensor sees no farther than 4.5 m
    mocap_hz=30.0,
    camera_hz=30.0,
    detector=Detector(sigma_px=3.0),  # a detector on a sharp HD image
    joint_noise_m=0.015,  # 2.4 cm in space, as measured on Kinect skeletons
)

PRESETS: Mapping[str, Preset] = MappingProxyType(
    {p.name: p for p in (STUDIO, MPI_INF_3DHP, HUMAN36M, AISTPP, KINECT)}
)


def preset(name: str) -> Preset:
    """Return a preset by its name.

    Raises:
        InputError: Unknown name.

    """
    if name not in PRESETS:
        msg = f'unknown preset {name[:80]!r}; known: {", ".join(PRESETS)}'
        raise InputError(Reason.BAD_INPUT, msg)
    return PRESETS[name]
