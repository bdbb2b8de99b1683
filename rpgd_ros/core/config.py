# SPDX-License-Identifier: Apache-2.0
"""Settings of the solve, one frozen dataclass per stage.

Each field carries its unit, range and meaning: ROS parameters, config/calibrator.yaml and the
table of the README are derived from here.
"""

from __future__ import annotations

import math
from dataclasses import Field, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar, cast

from rpgd_ros.core.errors import InputError, Reason

if TYPE_CHECKING:
    from collections.abc import Iterator

T = TypeVar('T')


@dataclass(frozen=True, slots=True)
class Setting:
    """What is to be known of one field beside its default.

    Attributes:
        help: One sentence, why one would change it.
        unit: Unit, or '' for none.
        low: Smallest allowed number.
        high: Largest allowed number.
        choices: Allowed strings; empty = any.
        is_live: Whether it may change while the node runs.

    """

    help: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    is_live: bool = False

    def complaint(self, value: object) -> str | None:
        """Say what is wrong with a value, or None."""
        if isinstance(value, int | float) and not isinstance(value, bool):
            if not (math.isfinite(value) and self.low <= value <= self.high):
                return f'{value!r} is outside {self.low:g} to {self.high:g} {self.unit}'.rstrip()
        elif self.choices and value not in self.choices:
            return f'{value!r} is none of {", ".join(self.choices)}'
        return None


def setting(default: T, help: str, **keywords: Any) -> T:  # noqa: A002
    """Declare a dataclass field with its `Setting`."""
    described: T = field(default=default, metadata={'setting': Setting(help, **keywords)})
    return described


def settings_of(stage: object) -> Iterator[tuple[Field[Any], Setting]]:
    """Yield the fields of a stage (class or instance), each with its `Setting`."""
    for f in fields(cast('Any', stage)):
        yield f, f.metadata['setting']


class Stage:
    """Base of the stages: values are checked where they are made."""

    def __post_init__(self) -> None:
        """Refuse values outside their range, naming the field."""
        for f, s in settings_of(self):
            complaint = s.complaint(getattr(self, f.name))
            if complaint:
                msg = f'{f.name}: {complaint}'
                raise InputError(Reason.BAD_PARAMETER, msg)


@dataclass(frozen=True)
class RansacConfig(Stage):
    """Robust start."""

    threshold_px: float = setting(
        0.0, 'Inlier threshold tau (eq. 3); 0 = estimated from the data',
        unit='px', low=0.0, high=500.0, is_live=True,
    )  # fmt: skip
    iterations: int = setting(
        2000, 'Most triplets drawn (K of Algorithm 1)', low=1, high=1_000_000, is_live=True
    )
    frame_stride: int = setting(
        0,
        'Where inliers are counted, use every n-th frame; 0 = as many as that needs',
        low=0,
        high=100_000,
        is_live=True,
    )
    seed: int = setting(0, 'Seed of the random draws', low=0, high=2**31 - 1)
    sampling: Literal['same_frame', 'any_frame'] = setting(
        'any_frame',
        'Triplets of one instant, as published and wherever inliers are counted, or of any',
        choices=('same_frame', 'any_frame'),
    )  # fmt: skip
    score: Literal['inliers', 'likelihood'] = setting(
        'likelihood', 'Count inliers, as published, or weigh every residual',
        choices=('inliers', 'likelihood'),
    )  # fmt: skip


@dataclass(frozen=True)
class RefineConfig(Stage):
    """Refinement of the reprojection error."""

    method: Literal['newton', 'adam', 'none'] = setting(
        'newton', 'newton: to the optimum; adam: the published descent; none: RANSAC alone',
        choices=('newton', 'adam', 'none'),
    )  # fmt: skip
    loss: Literal['robust', 'squared'] = setting(
        'robust', 'robust: outliers lose their pull; squared: eq. 4 as published',
        choices=('robust', 'squared'),
    )  # fmt: skip
    iterations: int = setting(50, 'Most steps', low=1, high=100_000, is_live=True)
    lr_rotation: float = setting(
        0.01, 'Learning rate of the angles (adam)', unit='rad', low=1e-8, high=1.0, is_live=True
    )
    lr_translation: float = setting(
        0.02,
        'Learning rate of the translation (adam)',
        unit='m',
        low=1e-8,
        high=10.0,
        is_live=True,
    )
    frame_stride: int = setting(
        0,
        'Use every n-th frame; 0 = what the budget holds',
        low=0,
        high=100_000,
        is_live=True,
    )
    joint_noise: bool = setting(
        default=False, help='Estimate the noise of the 3D joints, too (Kinect, IMU suits)'
    )
    joint_offsets: bool = setting(
        default=False,
        help="Estimate where the detector sees each joint: its hip is not the MoCap's hip",
    )
    focal: Literal['check', 'estimate'] = setting(
        'check', 'Say which focal length does not fit the film, or solve with one that does',
        choices=('check', 'estimate'),
    )  # fmt: skip
    size: Literal['check', 'estimate'] = setting(
        'check', 'Say that the skeleton has the wrong size, or solve with one that fits',
        choices=('check', 'estimate'),
    )  # fmt: skip
    max_correspondences: int = setting(
        4_000_000,
        'Budget of the last passes; evenly spread frames beyond it',
        low=1000,
        high=10**9,
    )


@dataclass(frozen=True)
class TimeConfig(Stage):
    """Offset between the clocks of video and MoCap."""

    estimate_offset: Literal['off', 'common', 'per_camera'] = setting(
        'off', 'Estimate how late the video is stamped: one offset, or one per camera',
        choices=('off', 'common', 'per_camera'),
    )  # fmt: skip
    estimate_rate: bool = setting(
        default=False, help='Estimate, too, how fast that offset grows (59.94 against 60 fps)'
    )
    search_s: float = setting(
        3.0, 'Largest offset looked for where video and MoCap were never synchronised', unit='s',
        low=0.0, high=60.0,
    )  # fmt: skip
    max_sigma_s: float = setting(
        0.01, 'An offset known worse than this is not applied', unit='s', low=1e-6, high=1.0
    )


@dataclass(frozen=True)
class RigConfig(Stage):
    """What becomes of a camera that contradicts the others."""

    on_bumped_camera: Literal['name', 'exclude', 're-estimate'] = setting(
        'name', 'Name a camera that was moved; also solve without it; also find where it is now',
        choices=('name', 'exclude', 're-estimate'),
    )  # fmt: skip


@dataclass(frozen=True)
class AcceptConfig(Stage):
    """Gates between a pose and an accepted calibration."""

    min_inlier_ratio: float = setting(
        0.1, 'Least share of correspondences that agree with the pose',
        low=0.0, high=1.0, is_live=True,
    )  # fmt: skip
    min_pairs: int = setting(60, 'Least number of inliers', low=3, high=10**9, is_live=True)
    min_frames: int = setting(
        10, 'Least number of frames with inliers', low=1, high=10**9, is_live=True
    )
    # Who stands sways by 0.1 m in all; a few steps in 5 s can be as little as 0.25 m.
    min_motion_m: float = setting(
        0.2, 'Least distance that the body must have covered', unit='m',
        low=0.0, high=100.0, is_live=True,
    )  # fmt: skip
    max_sigma_deg: float = setting(
        1.0, 'Largest accepted uncertainty of the rotation', unit='deg',
        low=0.0, high=180.0, is_live=True,
    )  # fmt: skip
    max_sigma_m: float = setting(
        0.05, "Largest accepted uncertainty of the body's position", unit='m',
        low=0.0, high=100.0, is_live=True,
    )  # fmt: skip
    # A studio floor or a MoCap origin that was set anew is decimetres or degrees away; two runs on
    # one walk differ by a tenth of this.
    max_jump_deg: float = setting(
        2.0, 'Automatic calibrations turn the published transform by no more; ~/calibrate may',
        unit='deg', low=0.0, high=180.0, is_live=True,
    )  # fmt: skip
    max_jump_m: float = setting(
        0.1, "Automatic calibrations move the body's position by no more; ~/calibrate may",
        unit='m', low=0.0, high=100.0, is_live=True,
    )  # fmt: skip


# What the publication does not give (K, tau, steps, rates), with the reason for each of ours.
PAPER_ITERATIONS = 200  # one clean triplet in 20 is drawn at least once in all but 1 of 28000 runs
PAPER_THRESHOLD_PX = 12.0  # 1.5 x the published MPJPE of its noisiest dataset (AIST++)
PAPER_STEPS = 300  # cosine annealing ends within 0.1 % of the optimum of eq. 4 on every twin
PAPER_RANSAC_FRAMES = 100  # of either stage: evenly spread in time
PAPER_REFINE_FRAMES = 300


@dataclass(frozen=True)
class CalibrationConfig:
    """Everything `calibrate` can be told.

    Attributes:
        ransac: Robust start.
        refine: Refinement.
        time: Offset between the clocks.
        rig: Cameras that contradict the others.
        accept: Gates.
        max_seconds: Time limit of one run; 0 = none.

    """

    ransac: RansacConfig = field(default_factory=RansacConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
    time: TimeConfig = field(default_factory=TimeConfig)
    rig: RigConfig = field(default_factory=RigConfig)
    accept: AcceptConfig = field(default_factory=AcceptConfig)
    max_seconds: float = 0.0

    @classmethod
    def paper(cls, *, threshold_px: float = PAPER_THRESHOLD_PX) -> Self:
        """Return the published method, step for step."""
        return cls(
            ransac=RansacConfig(
                threshold_px=threshold_px,
                iterations=PAPER_ITERATIONS,
                sampling='same_frame',
                score='inliers',
            ),
            refine=RefineConfig(method='adam', loss='squared', iterations=PAPER_STEPS),
        )

    @classmethod
    def thorough(cls) -> Self:
        """Return the settings of the node and of `calibrate_bag`."""
        return cls(
            refine=RefineConfig(joint_noise=True, joint_offsets=True),
            time=TimeConfig(estimate_offset='per_camera', estimate_rate=True),
            rig=RigConfig(on_bumped_camera='exclude'),
        )

    def with_stage(self, name: str, **changes: Any) -> Self:
        """Return a copy with fields of one stage changed."""
        return replace(self, **{name: replace(getattr(self, name), **changes)})
