# SPDX-License-Identifier: Apache-2.0
"""How residuals are spread, and the losses that follow from it.

A residual is either the detector's noise, a bivariate Student-t of scale sigma and tail nu (a
Gaussian for large nu), or gross: a much broader one. All of it is fitted to the residuals at a
pose, so no threshold needs to be known beforehand. Near the pose the gross part is flat, so the
loss is the negative log likelihood of noise plus a constant: outliers lose their pull smoothly
where they become the better explanation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from rpgd_ros.core.errors import CalibrationError, Reason
from rpgd_ros.core.geometry import Array, Column, RigidTransform
from rpgd_ros.core.linearise import Residuals, Sight, linearise

if TYPE_CHECKING:
    from collections.abc import Sequence

TAILS = (3.0, 6.0, 15.0, 1000.0)  # nu: detectors lie between 3 (heavy) and Gaussian
STARTS = (0.1, 0.3, 0.5)  # quantiles at which sigma is begun: a fit may have several optima
FIT_STEPS = 30
BINS_PER_DECADE = 25  # of the residual: 10 % wide, far below what a sigma can be known to
DECADES = (-4.0, 4.0)  # 0.1 um on the sensor to far outside the image, pixels
BROADER = 4.0  # a gross part nearer to the noise than this is noise
MAX_INLIER_SHARE = 0.999  # keeps a floor under the loss: the one gross error to come is bounded
# Largest sigma by focal length: 10 cm at 3.3 m. Detectors on recorded footage show 0.003 to 0.008.
LARGEST_NOISE = 0.03
SHARP = 0.25  # of the largest sigma: 0.0075 of the focal length, 3 cm at 4 m
# Noise of the 3D joints over that of the keypoints, in pixels at the median depth, that is tried;
# and by how much (log likelihood) it must explain the data better than none.
JOINT_NOISE_RATIOS = np.geomspace(0.25, 8.0, 11)
JOINT_NOISE_GAIN = 10.0
INLIER_SIGMAS = 3.0  # threshold when none is given: 99 % of Gaussian noise, 87 % of nu = 3


class Loss(Protocol):
    """A loss rho(s) of the squared residual s, px^2, with 2 rho' >= 0 and rho'' <= 0."""

    def evaluate(self, res: Residuals) -> tuple[float, Column, Column | None]:
        """Return the summed cost, the weights 2 rho', and -4 rho'' (None = zero), each (n,)."""
        ...

    def joint_noise(self, focal_px: float) -> float:
        """Noise of the 3D joints as `Slopes.whitened` takes it; 0 where there is none."""
        ...


@dataclass(frozen=True, slots=True)
class SquaredLoss:
    """Half the squared residual over the correspondences with depth > 0 (eq. 4, undivided)."""

    def evaluate(self, res: Residuals) -> tuple[float, Column, Column | None]:
        """See `Loss`."""
        cost = 0.5 * float(res.squared.sum(dtype=np.float64))  # zero where not in view
        return cost, res.in_view.astype(np.float32), None

    def joint_noise(self, focal_px: float) -> float:
        """See `Loss`."""
        del focal_px
        return 0.0


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Fitted spread of the residuals; as a loss, its negative log likelihood.

    Attributes:
        sigma_px: Scale of the detector's noise per axis, pixels.
        nu: Its tail (degrees of freedom).
        share: Share of the correspondences that carry only this noise.
        background: Density of gross residuals near zero, 1 / px^2.
        joint_sigma_m: Noise of the 3D joints per axis, metres, where it was estimated.
        is_sharp: Whether sigma is far below the largest that is believed. A spread near it
            explains any data a little: it is no explanation.

    """

    sigma_px: float
    nu: float
    share: float
    background: float
    joint_sigma_m: float = 0.0
    is_sharp: bool = True

    def joint_noise(self, focal_px: float) -> float:
        """See `Loss`."""
        return self.joint_sigma_m * focal_px / self.sigma_px

    @property
    def peak(self) -> float:
        """Density of the noise at zero, 1 / px^2."""
        return self.share / (2.0 * np.pi * self.sigma_px**2)

    @property
    def threshold_px(self) -> float:
        """Residual below which a correspondence counts as an inlier, pixels."""
        return INLIER_SIGMAS * self.sigma_px

    def evaluate(self, res: Residuals) -> tuple[float, Column, Column | None]:
        """See `Loss`."""
        k = 0.5 * (self.nu + 2.0)
        scale = self.nu * self.sigma_px**2
        near = res.squared
        near *= 1.0 / scale
        decay = np.log1p(near)
        near += 1.0
        density = np.exp(decay * -k)
        total = density + self.background / self.peak
        belongs = np.divide(density, total, out=density)
        if not res.in_view.all():
            belongs *= res.in_view
        weight = belongs * (2.0 * k / scale)
        weight /= near
        bending = (1.0 + k - k * belongs) * weight
        bending *= 2.0 / scale
        bending /= near
        return self._cost(total, res), weight, bending

    def cost_per_point(self, residual_px: Array) -> float:
        """Mean negative log likelihood of residuals, pixels."""
        near = 1.0 + residual_px**2 / (self.nu * self.sigma_px**2)
        density = self.peak * near ** (-0.5 * (self.nu + 2.0)) + self.background
        return -float(np.log(density).mean())

    def _cost(self, total: Column, res: Residuals) -> float:
        """Negative log likelihood above that of a residual of zero; gross where not in view."""
        floor = self.background / self.peak
        n_seen, n_in = int(np.count_nonzero(res.seen)), int(np.count_nonzero(res.in_view))
        logs = np.log(total)
        if n_in < len(logs):
            logs[~res.in_view] = 0.0
        inside = float(logs.sum(dtype=np.float64))
        return n_seen * float(np.log1p(floor)) - inside - (n_seen - n_in) * float(np.log(floor))


def fit_noise(residual_px: Array, *, largest_px: float, quick: bool = False) -> NoiseModel:
    """Fit the spread of residuals by maximum likelihood (EM on a histogram of their logarithm).

    Args:
        residual_px: (n,) residuals of correspondences in view, pixels, n > 0.
        largest_px: Largest sigma to believe, pixels: beyond it a residual is no noise.
        quick: One tail and one starting point, for ranking.

    Returns:
        The most likely model over a few tails and starting points.

    """
    r2, counts = _histogram(residual_px)
    cumulated = np.cumsum(counts) / counts.sum()
    starts = [r2[np.searchsorted(cumulated, q)] for q in (STARTS[:1] if quick else STARTS)]
    grid = np.meshgrid(TAILS[:1] if quick else TAILS, starts)
    nu, sigma2 = (column.ravel()[:, None] for column in grid)
    sigma2 = np.minimum(sigma2, largest_px**2)
    share = np.full_like(nu, 0.7)
    broad2 = np.full_like(nu, max(r2[np.searchsorted(cumulated, 0.95)], BROADER**2 * sigma2.max()))
    for _ in range(FIT_STEPS):
        noise = share * _student(r2, sigma2, nu)
        gross = (1.0 - share) * _student(r2, broad2, 1.0)
        to_noise = counts * noise / (noise + gross)
        to_gross = counts - to_noise
        share = np.clip(to_noise.sum(1, keepdims=True) / counts.sum(), 0.001, MAX_INLIER_SHARE)
        sigma2 = np.minimum(_scale(r2, to_noise, sigma2, nu), largest_px**2)
        broad2 = np.maximum(_scale(r2, to_gross, broad2, 1.0), BROADER**2 * sigma2)
    density = share * _student(r2, sigma2, nu) + (1.0 - share) * _student(r2, broad2, 1.0)
    best = int(np.argmax((counts * np.log(density)).sum(1)))
    return NoiseModel(
        sigma_px=float(np.sqrt(sigma2[best, 0])),
        nu=float(nu[best, 0]),
        share=float(share[best, 0]),
        background=float((1.0 - share[best, 0]) / (2.0 * np.pi * broad2[best, 0])),
        is_sharp=bool(sigma2[best, 0] < (SHARP * largest_px) ** 2),
    )


def noise_at(
    sights: Sequence[Sight],
    pose: RigidTransform,
    *,
    with_joints: bool = False,
    are_noisy: bool = False,
) -> NoiseModel:
    """Fit the spread of the residuals of a pose.

    Args:
        sights: Cameras with their data.
        pose: world_T_mocap.
        with_joints: Also estimate the noise of the 3D joints: it shows where near bodies have
            larger residuals than far ones.
        are_noisy: Whether these are known to be noisy: then it need not show beyond doubt.

    Raises:
        CalibrationError: No keypoint lies before a camera.

    """
    residual_px, angle_px = _residuals_at(sights, pose)
    if not len(residual_px):
        msg = 'no keypoint lies before a camera in the best pose found'
        raise CalibrationError(Reason.TOO_FEW_INLIERS, msg)
    focal_px = float(np.median([s.camera.focal_px for s in sights]))
    best = fit_noise(residual_px, largest_px=LARGEST_NOISE * focal_px)
    if not with_joints:
        return best
    ratios = (JOINT_NOISE_RATIOS / np.median(angle_px)).tolist()
    tried = [_with_joint_noise(residual_px, angle_px, r, focal_px) for r in ratios]
    likelihoods = np.array([likelihood for likelihood, _ in tried])
    top = int(np.argmax(likelihoods))
    least = 0.0 if are_noisy else JOINT_NOISE_GAIN
    if likelihoods[top] <= _log_likelihood(best, residual_px, 1.0) + least:
        return best
    if 0 < top < len(ratios) - 1:
        # Between the grid's ratios: the top of the parabola through the best three.
        before, there, after = likelihoods[top - 1 : top + 2]
        shift = 0.5 * (before - after) / (before - 2.0 * there + after)
        ratio = ratios[top] * (ratios[1] / ratios[0]) ** shift
        return _with_joint_noise(residual_px, angle_px, ratio, focal_px)[1]
    return tried[top][1]


def _with_joint_noise(
    residual_px: Array, angle_px: Array, ratio: float, focal_px: float
) -> tuple[float, NoiseModel]:
    """Log likelihood and noise where that of the 3D joints has a ratio to it, pixels."""
    widened = np.sqrt(1.0 + (ratio * angle_px) ** 2)
    noise = fit_noise(residual_px / widened, largest_px=LARGEST_NOISE * focal_px)
    likelihood = _log_likelihood(noise, residual_px, widened)
    return likelihood, replace(noise, joint_sigma_m=float(ratio * noise.sigma_px))


def _residuals_at(sights: Sequence[Sight], pose: RigidTransform) -> tuple[Array, Array]:
    """Return residuals (n,), pixels, and what a metre of noise in 3D adds to each (n,), pixels."""
    residual: list[Column] = [np.empty(0)]
    angle: list[Column] = [np.empty(0)]
    for s in sights:
        for x, uv in s.chunks():
            res, slopes = linearise(s.camera, s.camera_T_world @ pose, x, uv)
            residual.append(np.sqrt(res.squared)[res.in_view])
            squared, _ = slopes.joint_variance(s.camera.focal_px)
            angle.append(np.sqrt(squared[res.in_view]))
    return np.concatenate(residual), np.concatenate(angle)


def _log_likelihood(noise: NoiseModel, residual_px: Array, widened: Array | float) -> float:
    """Of residuals whose noise is widened.

    Gross ones have the density that was fitted, not its flat top: only then is the likelihood at
    its maximum by every parameter, and the rounding of the fit does not decide between models.
    """
    r2 = residual_px**2
    broad2 = (1.0 - noise.share) / (2.0 * np.pi * noise.background)
    fine = noise.share * _student(r2, noise.sigma_px**2 * np.square(widened), noise.nu)
    gross = (1.0 - noise.share) * _student(r2, broad2 * np.median(np.square(widened)), 1.0)
    return float(np.log(fine + gross).sum())


def _histogram(residual_px: Array) -> tuple[Array, Array]:
    """Return the squared residuals and the counts of the occupied logarithmic bins."""
    low, high = DECADES
    position = np.log10(np.clip(residual_px, 10.0**low, 10.0**high)) * BINS_PER_DECADE
    index = np.floor(position - low * BINS_PER_DECADE).astype(np.int64)
    counts = np.bincount(index).astype(np.float64)
    used = np.flatnonzero(counts)
    r2: Array = 10.0 ** (2.0 * ((used + 0.5) / BINS_PER_DECADE + low))
    return r2, counts[used]


def _student(r2: Array, sigma2: Array | float, nu: Array | float) -> Array:
    """Density of a bivariate Student-t at the squared radius, 1 / px^2."""
    decay = np.log1p(r2 / (nu * sigma2))
    density: Array = np.exp(-0.5 * (nu + 2.0) * decay) / (2.0 * np.pi * sigma2)
    return np.maximum(density, 1e-300)


def _scale(r2: Array, part: Array, sigma2: Array, nu: Array | float) -> Array:
    """One EM step of the squared scale of a bivariate Student-t."""
    weight = (nu + 2.0) / (nu + r2 / sigma2)
    total = np.maximum(2.0 * part.sum(1, keepdims=True), 1e-12)
    new: Array = np.maximum((part * weight * r2).sum(1, keepdims=True) / total, 1e-12)
    return new
