# SPDX-License-Identifier: Apache-2.0
"""Small and senseless recordings end in a result or in a refusal, never in between."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from core_cases import camera_with, small_rig
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rpgd_ros.core import (
    Calibration,
    CalibrationConfig,
    Camera,
    Observations,
    RigidTransform,
    RpgdError,
    calibrate,
)
from rpgd_ros.core.config import AcceptConfig, RefineConfig
from rpgd_ros.core.geometry import Array, so3_exp

# Gates that let nearly anything through, so that every figure of a hopeless pose is computed.
OPEN = AcceptConfig(
    min_inlier_ratio=0.0, min_pairs=3, min_frames=1, min_motion_m=0.0, max_sigma_deg=180.0,
    max_sigma_m=100.0,
)  # fmt: skip
CONFIGS = {
    'default': CalibrationConfig(),
    'paper': CalibrationConfig.paper(),
    'thorough': CalibrationConfig.thorough(),
    'newton on squares': CalibrationConfig(refine=RefineConfig(loss='squared')),
    'robust adam': CalibrationConfig(refine=RefineConfig(method='adam', iterations=20)),
    'start alone': CalibrationConfig(refine=RefineConfig(method='none')),
}
WILD = [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e30, 9e5, 1e-300]


def draw_shape(rng: np.random.Generator, size: tuple[int, int]) -> Array:
    """Return points (T, J, 3) in space, on a plane, on a line, or all in one place."""
    x: Array = rng.uniform(-1.0, 1.0, (*size, 3)) * rng.choice([1e-3, 0.5, 1.0, 2.0])
    flat = rng.integers(4)
    x[..., 3 - flat :] = 0.0
    return x


def draw_keypoints(
    rng: np.random.Generator, cameras: list[Camera], x: Array, truth: RigidTransform
) -> Array:
    """Return pixels (V, T, J, 2): exact, noisy, half of them anywhere, or all; some missing."""
    uv = np.stack([camera.project(truth @ x) for camera in cameras])
    uv += rng.normal(0.0, rng.choice([0.0, 1e-3, 2.0]), uv.shape)
    gross = rng.random(uv.shape[:3]) < rng.choice([0.0, 0.5, 1.0])
    uv[gross] = rng.uniform(0.0, 1000.0, (int(gross.sum()), 2))
    uv[rng.random(uv.shape[:3]) < rng.choice([0.0, 0.3, 0.9])] = np.nan
    return uv


def solve(seed: int, config: CalibrationConfig) -> Calibration:
    """Draw a recording from a seed, and calibrate."""
    rng = np.random.default_rng(seed)
    n_cameras = int(rng.integers(1, 4))
    lenses = ['five', 'eight', 'fisheye'][:n_cameras]
    cameras = small_rig(lenses) if n_cameras > 1 else [camera_with(str(rng.choice(lenses)))]
    x = draw_shape(rng, (int(rng.choice([1, 2, 3, 10, 40])), int(rng.choice([1, 2, 3, 5, 17]))))
    forward = 0.0 if n_cameras > 1 else 4.0
    truth = RigidTransform(so3_exp(rng.normal(0, 1, 3)), np.array([0.1, -0.2, forward]))
    uv = draw_keypoints(rng, cameras, x, truth)
    if rng.random() < 0.3:
        for part in (x, uv):
            hit = rng.random(part.shape) < 0.05
            part[hit] = rng.choice(WILD, int(hit.sum()))
    fps = 30.0 if rng.random() < 0.5 else None
    config = replace(config, ransac=replace(config.ransac, iterations=200))
    if rng.random() < 0.6:
        config = replace(config, accept=OPEN)
    return calibrate(cameras, Observations.from_arrays(x, uv, fps=fps), config=config)


@pytest.mark.parametrize('name', CONFIGS)
@settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, 2**32 - 1))
def test_nothing_else_comes_out_than_finite_numbers_or_a_reason(name: str, seed: int) -> None:
    """No numpy error, no OpenCV error, no warning, no NaN."""
    with np.errstate(divide='raise', over='raise', invalid='raise'), warnings.catch_warnings():
        warnings.simplefilter('error')
        try:
            found = solve(seed, CONFIGS[name])
        except RpgdError as refused:
            assert refused.message  # noqa: PT017 - either outcome is right
            return
    for figure in (found.world_T_mocap.matrix, found.covariance, found.covariance_over_time):
        assert np.isfinite(figure).all()
    assert np.isfinite([found.mpjpe_px, found.median_px, found.p95_px]).all()
