# SPDX-License-Identifier: Apache-2.0
"""How near to the dataset's own pose an estimate can come, and whether that says anything."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rpgd_ros.apps.bench_problems import Bound, cramer_rao
from rpgd_ros.apps.bench_select import evenly
from rpgd_ros.core.geometry import BoolArray
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.noise import NoiseModel
from rpgd_ros.core.noise_fit import noise_at
from rpgd_ros.datasets import DatasetSequence
from rpgd_ros.simulation import Faults, Truth, Twin

POINTS = 200_000  # of which the information is taken: more only scale it
GAUSSIAN_NU = 100.0  # a fitted tail above this is none
NEAR_SIGMAS = 4.0  # residuals beyond are gross
# Standard errors beyond which residuals of successive frames are no longer independent by chance:
# one sequence in 3.5 million.
LASTING = 5.0


class Yardstick(NamedTuple):
    """What a sequence's residuals at the dataset's own pose say.

    Attributes:
        bound: Cramer-Rao bound for independent errors of the spread that the residuals show.
        noise: That spread.
        lasting_px: Error per axis that a keypoint shares with the same one of the next frame,
            pixels; 0 where none shows.

    """

    bound: Bound
    noise: NoiseModel
    lasting_px: float


def yardstick(sequence: DatasetSequence) -> Yardstick | None:
    """Measure a sequence at the pose that its dataset gives; None where no pose is determined."""
    cameras, observations, truth = (
        sequence.cameras,
        sequence.observations,
        sequence.world_T_mocap,
    )
    sights = [Sight(c, v) for c, v in zip(cameras, observations.views, strict=True)]
    if not any(view.seen().any() for view in observations.views):
        return None
    noise = noise_at(sights, truth)
    few = evenly(observations, POINTS)
    chosen = [Sight(c, v) for c, v in zip(cameras, few.views, strict=True)]
    near = tuple(_is_near(sight, sequence, noise) for sight in chosen)
    n_all, n_few = (
        sum(int(view.seen().sum()) for view in views) for views in (observations.views, few.views)
    )
    problem = Twin(
        cameras,
        few,
        Truth(
            world_T_mocap=truth,
            inliers=near,
            sigma_px=noise.sigma_px,
            student_nu=noise.nu if noise.nu < GAUSSIAN_NU else 0.0,
            sigma_m=0.0,
            lags_s=(0.0,) * len(cameras),
            faults=Faults(),
            control_world=np.empty((0, 3)),
            control_mocap=np.empty((0, 3)),
        ),
    )
    try:
        bound = cramer_rao(problem)
    except np.linalg.LinAlgError:
        return None
    scale = float(np.sqrt(n_few / max(n_all, 1)))
    return Yardstick(
        Bound(bound.rotation_deg * scale, bound.points_m * scale),
        noise,
        _lasting_px(sights, sequence, noise),
    )


def _is_near(sight: Sight, sequence: DatasetSequence, noise: NoiseModel) -> BoolArray:
    """(F, J) whether keypoints are more likely noise than gross."""
    view = sight.view
    apart = sight.camera.project(sequence.world_T_mocap @ view.x_mocap) - view.uv
    near = 1.0 + (apart**2).sum(-1) / (noise.nu * noise.sigma_px**2)
    with np.errstate(invalid='ignore'):
        density = noise.peak * near ** (-0.5 * (noise.nu + 2.0))
        found: BoolArray = density > noise.background  # False for NaN
    return found


def _lasting_px(sights: list[Sight], sequence: DatasetSequence, noise: NoiseModel) -> float:
    """Return the root of the covariance of residuals with those of the next frame.

    Noise of the detector is new in every frame. What comes again is an error of another kind:
    joints that are defined otherwise, a clock, a lens.
    """
    products, squares, count = 0.0, 0.0, 0
    for sight in sights:
        for frames in sight.slices():
            x, uv = sight.view.x_mocap[frames], sight.view.uv[frames]
            apart = sight.camera.project(sequence.world_T_mocap @ x) - uv
            with np.errstate(invalid='ignore'):
                is_near = np.linalg.norm(apart, axis=-1) < NEAR_SIGMAS * noise.sigma_px
            both = is_near[1:] & is_near[:-1]
            product = (apart[1:] * apart[:-1])[both]
            products += float(product.sum())
            squares += float((product**2).sum())
            count += product.size
    if not count or products <= LASTING * np.sqrt(squares):
        return 0.0
    return float(np.sqrt(products / count))
