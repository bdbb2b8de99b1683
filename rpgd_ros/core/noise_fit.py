# SPDX-License-Identifier: Apache-2.0
"""Fits of the noise to the residuals at a pose, by maximum likelihood."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.errors import CalibrationError, Reason
from rpgd_ros.core.geometry import Array, Column, RigidTransform
from rpgd_ros.core.linearise import Sight, linearise
from rpgd_ros.core.noise import NoiseModel

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


def fit_noise(residual_px: Array, *, largest_px: float) -> NoiseModel:
    """Fit the spread of residuals by maximum likelihood (EM on a histogram of their logarithm).

    Args:
        residual_px: (n,) residuals of correspondences in view, pixels, n > 0.
        largest_px: Largest sigma to believe, pixels: beyond it a residual is no noise.

    Returns:
        The most likely model over a few tails and starting points.

    """
    (best,) = fit_noises(residual_px[None], largest_px=largest_px)
    return best


def fit_noises(residual_px: Array, *, largest_px: float) -> list[NoiseModel]:
    """Fit each of several sets of residuals (k, n): all at once takes little longer than one."""
    r2, counts = _histogram(residual_px)
    starts = np.hstack([_quantile(r2, counts, q) for q in STARTS])
    starts = np.minimum(starts, largest_px**2)
    broad2 = np.maximum(_quantile(r2, counts, 0.95), BROADER**2 * starts.max(1, keepdims=True))
    sigma2 = np.repeat(starts, len(TAILS), axis=1).reshape(-1, 1)
    nu = np.tile(TAILS, starts.size)[:, None]
    each = sigma2.size // len(counts)
    models, likelihood = _fit(
        r2, np.repeat(counts, each, 0), nu, sigma2, np.repeat(broad2, each, 0), largest_px
    )
    best = np.argmax(likelihood.reshape(len(counts), each), axis=1)
    return [models[k * each + int(b)] for k, b in enumerate(best)]


def rough_noises(residual_px: Array, *, largest_px: float) -> list[NoiseModel]:
    """Fit each of several sets of residuals (k, n) with one tail and starting point, to rank."""
    r2, counts = _histogram(residual_px)
    sigma2 = np.minimum(_quantile(r2, counts, STARTS[0]), largest_px**2)
    broad2 = np.maximum(_quantile(r2, counts, 0.95), BROADER**2 * sigma2)
    models, _ = _fit(r2, counts, np.full_like(sigma2, TAILS[0]), sigma2, broad2, largest_px)
    return models


def _fit(
    r2: Array, counts: Array, nu: Array, sigma2: Array, broad2: Array, largest_px: float
) -> tuple[list[NoiseModel], Array]:
    """Run EM from m starting points.

    Args:
        r2: (bins,) squared residuals, px^2.
        counts: (m, bins) how many there are.
        nu: (m, 1) tails.
        sigma2: (m, 1) squared scale of the noise, px^2.
        broad2: (m, 1) that of the gross part.
        largest_px: Largest sigma to believe, pixels.

    Returns:
        The models, and the log likelihood (m,) of each.

    """
    share, total = np.full_like(nu, 0.7), counts.sum(1, keepdims=True)
    for _ in range(FIT_STEPS):
        noise = share * _student(r2, sigma2, nu)
        gross = (1.0 - share) * _student(r2, broad2, 1.0)
        to_noise = counts * noise / (noise + gross)
        to_gross = counts - to_noise
        share = np.clip(to_noise.sum(1, keepdims=True) / total, 0.001, MAX_INLIER_SHARE)
        sigma2 = np.minimum(_scale(r2, to_noise, sigma2, nu), largest_px**2)
        broad2 = np.maximum(_scale(r2, to_gross, broad2, 1.0), BROADER**2 * sigma2)
    density = share * _student(r2, sigma2, nu) + (1.0 - share) * _student(r2, broad2, 1.0)
    background = (1.0 - share) / (2.0 * np.pi * broad2)
    is_sharp = sigma2 < (SHARP * largest_px) ** 2
    columns = (np.sqrt(sigma2), nu, share, background, is_sharp)
    models = [
        NoiseModel(float(s), float(n), float(p), float(b), is_sharp=bool(sharp))
        for s, n, p, b, sharp in np.broadcast(*columns)
    ]
    return models, (counts * np.log(density)).sum(1)


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
    residual_px, px_per_m = _residuals_at(sights, pose)
    if not len(residual_px):
        msg = 'no keypoint lies before a camera in the best pose found'
        raise CalibrationError(Reason.TOO_FEW_INLIERS, msg)
    focal_px = float(np.median([s.camera.focal_px for s in sights]))
    best = fit_noise(residual_px, largest_px=LARGEST_NOISE * focal_px)
    if not with_joints:
        return best
    ratios = JOINT_NOISE_RATIOS / np.median(px_per_m)
    likelihoods, models = _with_joint_noise(residual_px, px_per_m, ratios, focal_px)
    top = int(np.argmax(likelihoods))
    least = 0.0 if are_noisy else JOINT_NOISE_GAIN
    if likelihoods[top] <= _log_likelihood(best, residual_px, 1.0) + least:
        return best
    if 0 < top < len(ratios) - 1:
        # Between the grid's ratios: the top of the parabola through the best three.
        before, there, after = likelihoods[top - 1 : top + 2]
        shift = 0.5 * (before - after) / (before - 2.0 * there + after)
        ratio = ratios[top] * (ratios[1] / ratios[0]) ** shift
        _, models = _with_joint_noise(residual_px, px_per_m, np.array([ratio]), focal_px)
        return models[0]
    return models[top]


def _with_joint_noise(
    residual_px: Array, px_per_m: Array, ratios: Array, focal_px: float
) -> tuple[Array, list[NoiseModel]]:
    """Log likelihoods and noises where that of the 3D joints has a ratio (k,) to it, pixels."""
    widened = np.sqrt(1.0 + (ratios[:, None] * px_per_m) ** 2)
    noises = fit_noises(residual_px / widened, largest_px=LARGEST_NOISE * focal_px)
    likelihood = [_log_likelihood(n, residual_px, w) for n, w in zip(noises, widened, strict=True)]
    sigma_m = [r * n.sigma_px for n, r in zip(noises, ratios.tolist(), strict=True)]
    models = [replace(n, joint_sigma_m=s) for n, s in zip(noises, sigma_m, strict=True)]
    return np.array(likelihood), models


def _residuals_at(sights: Sequence[Sight], pose: RigidTransform) -> tuple[Array, Array]:
    """Return residuals (n,), pixels, and what a metre of noise in 3D adds to each (n,), pixels."""
    residual: list[Column] = [np.empty(0)]
    per_m: list[Column] = [np.empty(0)]
    for s in sights:
        for x, uv in s.chunks():
            res, slopes = linearise(s.camera, s.camera_T_world @ pose, x, uv)
            residual.append(np.sqrt(res.squared)[res.in_view])
            squared, _ = slopes.joint_variance(s.camera.focal_px)
            per_m.append(np.sqrt(squared[res.in_view]))
    return np.concatenate(residual), np.concatenate(per_m)


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
    """Return the squared residuals (bins,) and the counts (k, bins) of (k, n) residuals.

    The bins are logarithmic; those that nobody occupies are left out.
    """
    low, high = DECADES
    n_bins = round((high - low) * BINS_PER_DECADE) + 1
    position = np.log10(np.clip(residual_px, 10.0**low, 10.0**high)) * BINS_PER_DECADE
    index = np.floor(position - low * BINS_PER_DECADE).astype(np.int64)
    rows = np.arange(len(index))[:, None] * n_bins
    flat = np.bincount((index + rows).ravel(), minlength=len(index) * n_bins)
    counts = flat.reshape(-1, n_bins)
    used = np.flatnonzero(counts.any(0))
    r2: Array = 10.0 ** (2.0 * ((used + 0.5) / BINS_PER_DECADE + low))
    return r2, counts[:, used].astype(np.float64)


def _quantile(r2: Array, counts: Array, share: float) -> Array:
    """(k, 1) squared residual below which a share of each row of a histogram lies."""
    cumulated = np.cumsum(counts, 1)
    at: Array = r2[np.argmax(cumulated >= share * cumulated[:, -1:], 1)]
    return at[:, None]


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
