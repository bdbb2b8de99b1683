# SPDX-License-Identifier: Apache-2.0
"""The detector's noise and faults have the statistics that were asked for."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import mpjpe_px, scene

from rpgd_ros.core.errors import InputError
from rpgd_ros.simulation import Corruption
from rpgd_ros.simulation.detector import PLAIN_KINDS
from rpgd_ros.simulation.presets import OutlierKind
from rpgd_ros.simulation.twin import Twin

FAULTS: tuple[OutlierKind, ...] = ('uniform', 'swap', 'person', 'failure', 'mixed')


def seen_of(case: Twin) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return (V, F, J) what is reported."""
    return np.stack([view.seen() for view in case.observations.views])


def errors_px(case: Twin) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return (V, F, J) distances to the projected joints; NaN where nothing is reported."""
    return np.stack(
        [
            np.linalg.norm(c.project(case.truth.world_T_mocap @ v.x_mocap) - v.uv, axis=-1)
            for c, v in zip(case.cameras, case.observations.views, strict=True)
        ]
    )


@pytest.mark.parametrize(
    ('shape', 'published_px'),
    [('mpi_inf_3dhp', 0.1607), ('human36m', 1.2299), ('aistpp', 8.2837)],
)
def test_mean_error_at_truth_is_the_published_one(shape: str, published_px: float) -> None:
    """The noise is scaled until swaps, failures and noise together have that mean."""
    case = scene(shape, 300)
    found = mpjpe_px(case.cameras, case.observations, case.truth.world_T_mocap)
    assert found == pytest.approx(published_px, rel=1e-5)


def test_aistpp_contains_its_swaps_and_failures() -> None:
    """Of the views 4 % are swapped (all joints but the nose) and 0.3 % failed."""
    case = scene('aistpp', 3000)
    wrong = seen_of(case) & ~case.truth.inlier
    assert wrong.sum() / seen_of(case).sum() == pytest.approx(0.04 * 16 / 17 + 0.003, abs=0.005)


def test_students_noise_has_heavier_tails_than_a_gaussians() -> None:
    """A share of 3e-4 of Gaussian errors exceeds 4 sigma; of Student's with nu = 3 it is 1 %."""
    tails = {}
    for shape in ('human36m', 'aistpp'):
        case = scene(shape, 300)
        good = errors_px(case)[case.truth.inlier]
        tails[shape] = (good > 4.0 * case.truth.sigma_px).mean()
    assert tails['human36m'] == pytest.approx(3.4e-4, abs=3e-4)
    assert tails['aistpp'] > 0.01


def test_three_percent_of_the_keypoints_are_missed() -> None:
    """In a room that every camera sees whole."""
    assert seen_of(scene('human36m', 1000)).mean() == pytest.approx(0.97, abs=0.004)


def test_studio_detector_misses_whole_frames() -> None:
    """One frame in a hundred reports nobody."""
    empty = [~view.seen().any(-1) for view in scene('studio', 1800).observations.views]
    assert np.mean(empty) == pytest.approx(0.01, abs=0.004)


@pytest.mark.parametrize('kind', FAULTS)
@pytest.mark.parametrize('ratio', [0.2, 0.7])
def test_asked_share_of_observations_become_outliers(kind: OutlierKind, ratio: float) -> None:
    """Stretches of a second are few in a minute, so the share of `person` scatters."""
    case = scene('human36m', 3000, seed=1, outlier_ratio=ratio, kind=kind)
    share = 1.0 - case.truth.inlier.sum() / seen_of(case).sum()
    middle_joints = 6 / 32  # swap leaves pelvis, spine and head where they are
    expected = {'swap': ratio * (1 - middle_joints), 'mixed': ratio * (1 - middle_joints / 4)}
    assert share == pytest.approx(expected.get(kind, ratio), abs=0.05)


@pytest.mark.parametrize('kind', FAULTS)
def test_faults_leave_the_rest_of_the_scene_as_it_was(kind: OutlierKind) -> None:
    """The same seed has the same rig, walk and transform, and the same noise of its inliers."""
    clean = scene('human36m', 200, seed=2)
    faulty = scene('human36m', 200, seed=2, outlier_ratio=0.4, kind=kind)
    np.testing.assert_array_equal(
        clean.truth.world_T_mocap.matrix, faulty.truth.world_T_mocap.matrix
    )
    inlier = faulty.truth.inlier
    for n, (a, b) in enumerate(
        zip(clean.observations.views, faulty.observations.views, strict=True)
    ):
        np.testing.assert_array_equal(a.x_mocap, b.x_mocap)
        np.testing.assert_array_equal(a.uv[inlier[n]], b.uv[inlier[n]])


@pytest.mark.parametrize('kind', PLAIN_KINDS)
def test_outliers_are_far_off_and_inliers_are_not(kind: OutlierKind) -> None:
    """The mask of the truth separates noise from faults."""
    case = scene('human36m', 500, outlier_ratio=0.4, kind=kind)
    error = errors_px(case)
    inlier = case.truth.inlier
    assert np.nanmax(error[inlier]) < 8.0
    assert np.median(error[seen_of(case) & ~inlier]) > 15.0


def test_swapped_view_shows_the_mirror_joint() -> None:
    """The pixel of the left wrist lies at the right one."""
    case = scene('aistpp', 200, outlier_ratio=0.5, kind='swap')
    camera, view = case.cameras[0], case.observations.views[0]
    names = list(case.observations.joint_names or ())
    left, right = names.index('left_ankle'), names.index('right_ankle')
    truth = camera.project(case.truth.world_T_mocap @ view.x_mocap)
    wrong = view.seen()[:, left] & ~case.truth.inliers[0][:, left]
    to_mirror = np.linalg.norm(view.uv[wrong, left] - truth[wrong, right], axis=-1)
    assert np.median(to_mirror) < 10.0


def test_wrong_person_lasts_for_about_a_second() -> None:
    """The detector does not flicker between two people."""
    case = scene('human36m', 1500, outlier_ratio=0.3, kind='person')
    wrong = (seen_of(case) & ~case.truth.inlier)[0].mean(-1) > 0.5
    changes = np.abs(np.diff(wrong.astype(int))).sum()
    assert 2 <= changes <= 2 * 30


def test_scores_know_little_of_the_error() -> None:
    """They correlate weakly with the error, and hardly tell outliers."""
    case = scene('human36m', 500, outlier_ratio=0.3, kind='person')
    seen, error = seen_of(case), errors_px(case)
    score = np.stack([v.confidence for v in case.observations.views if v.confidence is not None])
    assert -0.3 < np.corrcoef(score[seen], np.log1p(error[seen]))[0, 1] < -0.02
    assert (score[~seen] == 0.0).all()
    assert (score[seen] >= 0.05).all()
    assert (score <= 1.0).all()
    wrong = seen & ~case.truth.inlier
    assert abs(score[wrong].mean() - score[case.truth.inlier].mean()) < 0.06


def test_pixel_bias_stays_with_its_joint() -> None:
    """The same offset in all frames of all cameras."""
    clean, biased = scene('human36m', 50), scene('human36m', 50, bias_px=3.0)
    difference = np.stack(
        [
            b.uv - a.uv
            for a, b in zip(clean.observations.views, biased.observations.views, strict=True)
        ]
    )
    offsets = np.nanmean(difference, axis=(0, 1))
    assert np.nanmax(np.abs(difference - offsets)) < 1e-9
    assert 1.5 < offsets.std() < 4.5


@pytest.mark.parametrize(
    ('settings', 'message'),
    [
        ({'ratio': 1.5}, 'ratio must be 0 to 1, got 1.5'),
        ({'ratio': float('nan')}, 'ratio must be 0 to 1, got nan'),
        ({'kind': 'ghost'}, "unknown kind of outliers 'ghost'; known: uniform, swap"),
        ({'bias_px': -1.0}, 'bias must be 0 or more pixels, got -1.0'),
    ],
)
def test_corruption_out_of_range_is_refused(settings: dict[str, object], message: str) -> None:
    """Found, needed."""
    with pytest.raises(InputError, match=message):
        Corruption(**settings)  # type: ignore[arg-type]
