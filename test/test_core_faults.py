# SPDX-License-Identifier: Apache-2.0
"""What goes wrong in a recording ends in the right transform or in a refusal with its reason."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scenes import errors, only, scene

from rpgd_ros.core import (
    Calibration,
    CalibrationConfig,
    CalibrationError,
    Observations,
    Reason,
    calibrate,
)
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.observations import LARGEST_COORDINATE
from rpgd_ros.simulation import Twin

TOO_FEW = {Reason.TOO_FEW_POINTS, Reason.NO_DATA}
NOT_AGREED = {Reason.TOO_FEW_INLIERS, Reason.UNCERTAIN, Reason.AMBIGUOUS, Reason.TOO_FEW_FRAMES}


def arrays(case: Twin) -> tuple[Array, Array]:
    """Return x_mocap (T, J, 3) and uv (V, T, J, 2) of a synchronous scene, to be changed."""
    uv = np.stack([v.uv for v in case.observations.views])
    return case.observations.views[0].x_mocap.copy(), uv


def solve(case: Twin, x: Array, uv: Array, config: CalibrationConfig | None = None) -> Calibration:
    """Calibrate with changed arrays."""
    return calibrate(case.cameras, Observations.from_arrays(x, uv, fps=50.0), config=config)


def refusal(run: Callable[[], Calibration]) -> CalibrationError:
    """Return why a run was refused."""
    with pytest.raises(CalibrationError) as refused:
        run()
    assert refused.value.message
    return refused.value


def error_deg(found: Calibration, case: Twin) -> float:
    """Return the rotation error, degrees."""
    return errors(found.world_T_mocap, case.truth.world_T_mocap, case.observations)[0]


def all_finite(found: Calibration) -> bool:
    """Whether every number that leaves the solver is one."""
    figures = [found.world_T_mocap.matrix, found.covariance, found.covariance_over_time]
    rest = [found.mpjpe_px, found.median_px, found.p95_px, found.threshold_px, *found.worst_sigma]
    return all(np.isfinite(a).all() for a in [*figures, found.centroid_mocap, np.array(rest)])


DAMAGE = st.one_of(
    st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e300, 5e-324]),
    st.floats(allow_nan=True, allow_infinity=True),
)
PLACE = st.tuples(st.booleans(), st.integers(0, 10**6), DAMAGE)
BASE = scene('human36m', 20, 9)
# The short scene stays below the gate of motion in some of its draws; the pose is what counts.
BASE_CONFIG = CalibrationConfig().with_stage('accept', min_motion_m=0.0)


def check_damage(hits: list[tuple[bool, int, float]], config: CalibrationConfig) -> None:
    """Put numbers anywhere; compare with the same recording without those points."""
    x, uv = arrays(BASE)
    for in_skeleton, number, value in hits:
        part = x if in_skeleton else uv
        part.flat[number % part.size] = value
    clean_x, clean_uv = x.copy(), uv.copy()
    for part in (clean_x, clean_uv):
        part[~(np.abs(part) < LARGEST_COORDINATE).all(-1)] = np.nan
    with np.errstate(divide='raise', over='raise', invalid='raise'), warnings.catch_warnings():
        warnings.simplefilter('error')
        found = solve(BASE, x, uv, config)
        expected = solve(BASE, clean_x, clean_uv, config)
    assert all_finite(found)
    np.testing.assert_allclose(
        found.world_T_mocap.matrix, expected.world_T_mocap.matrix, rtol=0.0, atol=1e-9
    )
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-9)


@pytest.mark.fault(11)
@settings(max_examples=15, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(PLACE, min_size=1, max_size=30))
def test_any_number_anywhere_counts_as_missing_or_as_data(
    hits: list[tuple[bool, int, float]],
) -> None:
    """The result is finite, that of the rest of the data, and no numpy warning is heard."""
    check_damage(hits, BASE_CONFIG)


@pytest.mark.fault(11)
@pytest.mark.parametrize('kind', ['uniform', 'swap', 'failure'])
@pytest.mark.parametrize('ratio', [0.0, 0.5, 1.0])
def test_damage_and_outliers_together_raise_no_other_error(kind: str, ratio: float) -> None:
    """Every refusal is one of ours, in the search for its cause as well."""
    case = scene('human36m', 100, 1, outlier_ratio=ratio, kind=kind)
    rng = np.random.default_rng(0)
    x, uv = arrays(case)
    for a in (x, uv):
        hit = rng.random(a.shape) < 0.02
        a[hit] = rng.choice([np.nan, np.inf, -np.inf, 1e300, -1e300, 1e30], int(hit.sum()))
    with np.errstate(divide='raise', over='raise', invalid='raise'), warnings.catch_warnings():
        warnings.simplefilter('error')
        if ratio == 1.0:
            refusal(lambda: solve(case, x, uv))
        else:
            assert error_deg(solve(case, x, uv), case) < 0.3


@pytest.mark.fault(29)
@pytest.mark.parametrize('kind', ['uniform', 'swap', 'person', 'failure', 'mixed'])
@pytest.mark.parametrize('shape', ['human36m', 'kinect'])
def test_up_to_sixty_percent_outliers_do_not_matter(shape: str, kind: str) -> None:
    """Right to 0.3 deg, with four cameras and with one."""
    for ratio in (0.3, 0.6):
        case = scene(shape, 150, 3, outlier_ratio=ratio, kind=kind)
        found = calibrate(case.cameras, case.observations)
        assert error_deg(found, case) < 0.3


@pytest.mark.fault(29)
@pytest.mark.parametrize('kind', ['uniform', 'person', 'failure', 'mixed'])
@pytest.mark.parametrize('shape', ['human36m', 'kinect'])
def test_nothing_but_outliers_is_refused(shape: str, kind: str) -> None:
    """A pose that a tenth of garbage happens to agree with is no calibration."""
    case = scene(shape, 100, 4, outlier_ratio=1.0, kind=kind)
    assert refusal(lambda: calibrate(case.cameras, case.observations)).reason in NOT_AGREED


@pytest.mark.fault(29)
@pytest.mark.parametrize('kind', ['uniform', 'failure', 'mixed', 'person'])
def test_eighty_percent_outliers_are_survived_or_refused(kind: str) -> None:
    """Never accepted with an error beyond three sigma."""
    case = scene('human36m', 150, 5, outlier_ratio=0.8, kind=kind)
    try:
        found = calibrate(case.cameras, case.observations)
    except CalibrationError as refused:
        assert refused.reason in NOT_AGREED  # noqa: PT017 - either outcome is right
    else:
        assert error_deg(found, case) < max(0.3, 3.0 * found.worst_sigma[0])


@pytest.mark.fault(29)
@pytest.mark.parametrize('n', range(6))
@pytest.mark.parametrize('config', [CalibrationConfig(), CalibrationConfig.paper()])
def test_fewer_than_six_points_are_too_few(n: int, config: CalibrationConfig) -> None:
    """Whatever camera and frame they are in."""
    case = scene('human36m', 30, 1)
    x, uv = arrays(case)
    seen = np.argwhere(np.isfinite(uv[..., 0]))
    keep = np.random.default_rng(n).permutation(len(seen))[:n]
    few = np.full_like(uv, np.nan)
    for v, t, j in seen[keep]:
        few[v, t, j] = uv[v, t, j]
    assert refusal(lambda: solve(case, x, few, config)).reason in TOO_FEW


@pytest.mark.fault(29)
def test_two_points_in_each_camera_are_too_few() -> None:
    """No camera has a triplet, although there are eight points in all."""
    case = scene('human36m', 30, 1)
    x, uv = arrays(case)
    few = np.full_like(uv, np.nan)
    for v in range(4):
        few[v, 3 + v, [3, 17]] = [[400.0, 500.0], [450.0, 520.0]]
    found = refusal(lambda: solve(case, x, few))
    assert found.reason is Reason.TOO_FEW_POINTS
    assert 'no camera has 3 correspondences: 8 in all' in found.message


def test_one_frame_is_no_motion() -> None:
    """However many cameras saw it."""
    case = scene('human36m', 30, 1)
    x, uv = arrays(case)
    assert refusal(lambda: solve(case, x[:1], uv[:, :1])).reason is Reason.DEGENERATE_MOTION


def test_a_recording_of_few_frames_is_too_short() -> None:
    """Enough motion, enough points, but five instants only."""
    case = scene('human36m', 400, 1)
    x, uv = arrays(case)
    assert refusal(lambda: solve(case, x[::80], uv[:, ::80])).reason is Reason.TOO_FEW_FRAMES


@pytest.mark.fault(28)
@pytest.mark.parametrize('axis', [0, 1, 2])
@pytest.mark.parametrize('shape', ['human36m', 'kinect', 'mpi_inf_3dhp'])
def test_mirrored_axes_are_named(shape: str, axis: int) -> None:
    """A left-handed MoCap frame, whichever axis is turned round."""
    case = scene(shape, 150, 2)
    x, uv = arrays(case)
    x[..., axis] *= -1.0
    assert refusal(lambda: solve(case, x, uv)).reason is Reason.MIRRORED_AXES


@pytest.mark.fault(28)
def test_mirrored_walk_that_fits_two_of_four_cameras_is_refused() -> None:
    """The two others were taken for somebody else, and a pose 114 deg off was accepted."""
    case = scene('human36m', 120, 127)
    x, uv = arrays(case)
    x[..., 0] *= -1.0
    assert refusal(lambda: solve(case, x, uv)).reason is Reason.MIRRORED_AXES


@pytest.mark.fault(28)
@pytest.mark.parametrize('shape', ['human36m', 'kinect'])
@pytest.mark.parametrize('ratio', [0.2, 0.5])
def test_labels_swapped_in_half_of_the_frames_do_not_matter(shape: str, ratio: float) -> None:
    """Within 0.1 deg where four cameras look, 0.2 deg where one does."""
    case = scene(shape, 200, 6, outlier_ratio=ratio, kind='swap')
    found = calibrate(case.cameras, case.observations)
    assert error_deg(found, case) < (0.1 if shape == 'human36m' else 0.2)


@pytest.mark.fault(28)
@pytest.mark.parametrize('shape', ['human36m', 'kinect', 'mpi_inf_3dhp'])
def test_labels_that_are_always_swapped_are_named(shape: str) -> None:
    """Left is right in all frames: the joint map is wrong, and the message says so."""
    case = scene(shape, 150, 2, outlier_ratio=1.0, kind='swap')
    found = refusal(lambda: calibrate(case.cameras, case.observations))
    assert found.reason is Reason.SWAPPED_LABELS
    assert 'left and right are swapped. Check the joint map' in found.message


@pytest.mark.parametrize('shape', ['studio', 'aistpp'])
@pytest.mark.parametrize('seed', [2, 3, 5])
def test_a_skeleton_without_a_midline_that_is_always_swapped_is_named(
    shape: str, seed: int
) -> None:
    """Where every joint has a twin, the breadth of the body could be taken for noise."""
    case = scene(shape, 150, seed, outlier_ratio=1.0, kind='swap')
    reason = refusal(lambda: calibrate(case.cameras, case.observations)).reason
    assert reason is Reason.SWAPPED_LABELS


@pytest.mark.fault(17)
@pytest.mark.parametrize(
    ('change', 'words'),
    [(1000.0, 'millimetres'), (100.0, 'centimetres'), (39.37, 'inches')],
)
def test_another_unit_is_refused_by_its_name(change: float, words: str) -> None:
    """The whole solve says so, before anything is tried."""
    case = scene('aistpp', 60, 2)
    x, uv = arrays(case)
    found = refusal(lambda: solve(case, change * x, uv))
    assert found.reason is Reason.WRONG_UNIT
    assert words in found.message


def test_a_camera_that_saw_nobody_does_not_disturb() -> None:
    """Its view is empty; the others decide as if it were not there."""
    case = scene('human36m', 150, 3)
    x, uv = arrays(case)
    uv[3] = np.nan
    rest = only(case, 0, 1, 2)
    found, expected = solve(case, x, uv), calibrate(rest.cameras, rest.observations)
    angle_deg, shift_m = errors(found.world_T_mocap, expected.world_T_mocap, case.observations)
    assert angle_deg < 1e-3
    assert shift_m < 1e-5
