# SPDX-License-Identifier: Apache-2.0
"""Focal lengths that do not fit the film are said, and the sigma takes them in."""

from __future__ import annotations

from dataclasses import replace

import pytest
import scenes

from rpgd_ros.core import Calibration, calibrate


def solved(
    shape: str, factor: float, *, seed: int, bias_m: float = 0.0
) -> tuple[Calibration, float]:
    """Calibrate with all focal lengths wrong by a factor; return the error at the body, too."""
    case = scenes.scene(shape, frames=300, seed=seed, bias_m=bias_m)
    cameras = []
    for camera in case.cameras:
        matrix = camera.matrix.copy()
        matrix[0, 0] *= factor
        matrix[1, 1] *= factor
        cameras.append(replace(camera, matrix=matrix))
    found = calibrate(cameras, case.observations)
    truth = case.truth.world_T_mocap
    return found, scenes.errors(found.world_T_mocap, truth, case.observations)[1]


@pytest.mark.fault(33)
@pytest.mark.parametrize('shape', ['human36m', 'aistpp', 'mpi_inf_3dhp'])
@pytest.mark.parametrize(('factor', 'way'), [(0.99, 'short'), (1.01, 'long')])
def test_focal_lengths_wrong_by_one_percent_are_said_and_covered(
    shape: str, factor: float, way: str
) -> None:
    """Millimetres that the residuals hardly show are inside three sigma."""
    for seed in range(2):
        found, error_m = solved(shape, factor, seed=seed)
        assert any(f'too {way}' in sentence for sentence in found.warnings)
        assert error_m < 3.0 * found.sigma_position_m


@pytest.mark.parametrize('bias_m', [0.0, 0.02])
def test_right_focal_lengths_are_not_accused(bias_m: float) -> None:
    """Neither noise nor biased joints look like a wrong lens."""
    for seed in range(4):
        found, _ = solved('human36m', 1.0, seed=seed, bias_m=bias_m)
        assert not any('focal' in sentence for sentence in found.warnings)


def test_one_camera_alone_cannot_tell_its_focal_length_from_its_distance() -> None:
    """It accuses nobody: that intrinsics must be right is for the user to know."""
    found, _ = solved('kinect', 0.99, seed=0)
    assert not any('focal' in sentence for sentence in found.warnings)
