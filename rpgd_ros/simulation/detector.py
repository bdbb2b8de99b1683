# SPDX-License-Identifier: Apache-2.0
"""A 2D pose detector: noise, missed keypoints, and the ways in which it is wholly wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, BoolArray, IntArray
from rpgd_ros.simulation.presets import Detector, OutlierKind

OUTLIER_KINDS: tuple[OutlierKind, ...] = get_args(OutlierKind)
PLAIN_KINDS: tuple[OutlierKind, ...] = OUTLIER_KINDS[:-1]

STRETCH_S = 1.0  # a detector that jumped to somebody else stays there for about a second
FAILURE_SPREAD = 0.06  # of the image height: a failed skeleton is a blob, not a cloud
TAIL_LIMIT = 60.0  # Student's t has no end; a pixel error has
NOISE_STEPS = 20
MIN_NOISE_SHARE = 0.1  # of the wanted mean error, where swaps and failures alone exceed it

# Scores say little. They fall a little with the noise, but a detector that followed the wrong
# figure in recorded footage was as sure of itself (0.73) as one that did not: beyond five sigma
# the score knows nothing.
SCORE_MEAN = 0.78
SCORE_SLOPE = 0.03
SCORE_NOISE = 0.10
SCORE_LEAST = 0.05
SCORE_REACH = 5.0


@dataclass(slots=True, eq=False)
class Shot:
    """The keypoints of one camera while they are being made.

    Attributes:
        camera: The camera.
        clean: (F, J, 2) true pixels; NaN where not before the lens.
        other: (F, J, 2) pixels of a second person, or None.
        uv: (F, J, 2) what the detector reports.
        is_seen: (F, J) whether it reports anything.
        is_inlier: (F, J) whether what it reports carries nothing but noise.

    """

    camera: Camera
    clean: Array
    other: Array | None
    uv: Array
    is_seen: BoolArray
    is_inlier: BoolArray

    @classmethod
    def of(cls, camera: Camera, clean: Array, other: Array | None) -> Shot:
        """Begin with perfect keypoints wherever the image holds them."""
        seen = in_image(camera, clean)
        return cls(camera, clean, other, clean.copy(), seen, seen.copy())


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """What one camera's detector reported, and which of it is true.

    Attributes:
        uv: (F, J, 2) pixels; NaN = not reported.
        confidence: (F, J) scores, 0 where not reported.
        is_inlier: (F, J) reported, with nothing but noise.

    """

    uv: Array
    confidence: Array
    is_inlier: BoolArray


@dataclass(frozen=True, slots=True)
class Corruption:
    """Faults on top of a detector's own.

    Attributes:
        ratio: Share of the observations that become outliers.
        kind: How: `uniform` (single keypoints anywhere), `swap` (left and right of a view),
            `person` (stretches of somebody else), `failure` (views around a random place), or
            `mixed` (a quarter of the views each).
        bias_px: Standard deviation per axis of an offset that each joint keeps in all images.

    Raises:
        InputError: A ratio outside 0 to 1, an unknown kind, a negative bias.

    """

    ratio: float = 0.0
    kind: OutlierKind = 'uniform'
    bias_px: float = 0.0

    def __post_init__(self) -> None:
        """Check at the border."""
        if not 0.0 <= self.ratio <= 1.0:
            msg = f'the outlier ratio must be 0 to 1, got {self.ratio}'
            raise InputError(Reason.BAD_INPUT, msg)
        if self.kind not in OUTLIER_KINDS:
            msg = f'unknown kind of outliers {self.kind!r}; known: {", ".join(OUTLIER_KINDS)}'
            raise InputError(Reason.BAD_INPUT, msg)
        if not (np.isfinite(self.bias_px) and self.bias_px >= 0.0):
            msg = f'the bias must be 0 or more pixels, got {self.bias_px}'
            raise InputError(Reason.BAD_INPUT, msg)

    @property
    def needs_other(self) -> bool:
        """Whether a second person has to be in the room."""
        return self.ratio > 0.0 and self.kind in {'person', 'mixed'}


def in_image(camera: Camera, uv: Array) -> BoolArray:
    """Return (F, J) whether pixels (F, J, 2) lie in the image; False for NaN."""
    return np.asarray(((uv > 0.0) & (uv < np.array(camera.size) - 1.0)).all(-1))


def detect(
    shots: Sequence[Shot],
    settings: Detector,
    corruption: Corruption,
    *,
    mirror: IntArray,
    hz: float,
    rng: np.random.Generator,
) -> tuple[list[Detection], float]:
    """Run the detector over perfect keypoints.

    Args:
        shots: One per camera; consumed.
        settings: The detector's own errors.
        corruption: Faults beyond them.
        mirror: (J,) index of each joint's mirror image.
        hz: Rate of the cameras.
        rng: Source of everything random.

    Returns:
        The detections, and the scale of the noise per axis, pixels.

    """
    # A stream each, so that outliers leave the noise and the dropouts as they were.
    rng_drop, rng_own, rng_noise, rng_bad, rng_score = rng.spawn(5)
    for shot in shots:
        _drop(shot, settings, rng_drop)
        _corrupt(shot, 'swap', settings.swap_ratio, mirror, hz, rng_own)
        _corrupt(shot, 'failure', settings.failure_ratio, mirror, hz, rng_own)
    noise = [_unit_noise(shot.uv.shape, settings.student_nu, rng_noise) for shot in shots]
    sigma_px = settings.sigma_px
    if settings.mean_error_px > 0.0:
        sigma_px = fit_noise(shots, noise, settings.mean_error_px)
    offsets = rng_bad.normal(0.0, 1.0, (len(mirror), 2)) * corruption.bias_px
    detections = []
    for shot, unit in zip(shots, noise, strict=True):
        shot.uv += sigma_px * unit + offsets
        _corrupt(shot, corruption.kind, corruption.ratio, mirror, hz, rng_bad)
        detections.append(_report(shot, max(sigma_px, 1e-3), rng_score))
    return detections, sigma_px


def _drop(shot: Shot, settings: Detector, rng: np.random.Generator) -> None:
    frames, joints = shot.is_seen.shape
    shot.is_seen &= rng.random((frames, joints)) >= settings.keypoint_dropout
    shot.is_seen &= rng.random((frames, 1)) >= settings.frame_dropout
    shot.is_inlier &= shot.is_seen


def _unit_noise(shape: tuple[int, ...], nu: float, rng: np.random.Generator) -> Array:
    """Return noise of unit scale; both axes of a keypoint share the tail of Student's t."""
    unit = rng.standard_normal(shape)
    if nu > 0.0:
        unit /= np.sqrt(rng.chisquare(nu, shape[:-1])[..., None] / nu)
        np.clip(unit, -TAIL_LIMIT, TAIL_LIMIT, out=unit)
    return unit


def fit_noise(shots: Sequence[Shot], noise: Sequence[Array], mean_error_px: float) -> float:
    """Return the scale at which noise and faults together have the wanted mean error, pixels.

    Args:
        shots: With their own swaps and failures, without noise.
        noise: (F, J, 2) per shot, of unit scale.
        mean_error_px: Mean distance to the true pixels over all that is seen.

    """
    fault = np.concatenate([(s.uv - s.clean)[s.is_seen] for s in shots])
    unit = np.concatenate([n[s.is_seen] for s, n in zip(shots, noise, strict=True)])
    if not len(unit):
        return 0.0
    scale = mean_error_px
    for _ in range(NOISE_STEPS):  # Newton: the mean is nearly linear in the scale
        error = fault + scale * unit
        length = np.maximum(np.linalg.norm(error, axis=1), 1e-12)
        miss = float(length.mean()) - mean_error_px
        slope = float(((error * unit).sum(-1) / length).mean())
        scale = max(scale - miss / slope, MIN_NOISE_SHARE * mean_error_px)
        if abs(miss) < 1e-6 * mean_error_px:
            break
    return scale


def _corrupt(
    shot: Shot,
    kind: OutlierKind,
    ratio: float,
    mirror: IntArray,
    hz: float,
    rng: np.random.Generator,
) -> None:
    """Turn a share of the observations into outliers of one kind, in place."""
    if ratio <= 0.0:
        return
    frames = len(shot.uv)
    if kind == 'mixed':
        which = rng.integers(len(PLAIN_KINDS), size=frames)
        for number, plain in enumerate(PLAIN_KINDS):
            _hit(shot, plain, ratio, mirror, hz, rng, frames_allowed=which == number)
        return
    _hit(shot, kind, ratio, mirror, hz, rng, frames_allowed=np.ones(frames, dtype=bool))


def _hit(
    shot: Shot,
    kind: OutlierKind,
    ratio: float,
    mirror: IntArray,
    hz: float,
    rng: np.random.Generator,
    *,
    frames_allowed: BoolArray,
) -> None:
    frames, joints = shot.is_seen.shape
    size = np.array(shot.camera.size)
    if kind == 'uniform':
        hit = rng.random((frames, joints)) < ratio
        wrong = rng.uniform(0.0, 1.0, (frames, joints, 2)) * size
    elif kind == 'person' and shot.other is not None:
        length = max(2, round(STRETCH_S * hz))
        stretches = rng.random(frames // length + 2) < ratio
        start = int(rng.integers(length))
        hit = np.repeat(stretches, length)[start : start + frames, None] & in_image(
            shot.camera, shot.other
        )
        wrong = shot.other + (shot.uv - shot.clean)
    elif kind == 'swap':
        hit = (rng.random((frames, 1)) < ratio) & (mirror != np.arange(joints))
        wrong = shot.uv[:, mirror]
    else:
        hit = np.broadcast_to(rng.random((frames, 1)) < ratio, (frames, joints))
        centre = rng.uniform(0.1, 0.9, (frames, 1, 2)) * size
        wrong = centre + rng.normal(0.0, FAILURE_SPREAD * size[1], (frames, joints, 2))
    hit = hit & frames_allowed[:, None] & shot.is_seen & np.isfinite(wrong).all(-1)
    shot.uv[hit] = wrong[hit]
    shot.is_inlier &= ~hit


def _report(shot: Shot, sigma_px: float, rng: np.random.Generator) -> Detection:
    """Blank what is not seen, and give scores that know little of the error."""
    error = np.linalg.norm(shot.uv - shot.clean, axis=-1)
    score = SCORE_MEAN - SCORE_SLOPE * np.log1p(np.minimum(error / sigma_px, SCORE_REACH))
    score += SCORE_NOISE * rng.standard_normal(score.shape)
    confidence = np.where(shot.is_seen, np.clip(score, SCORE_LEAST, 1.0), 0.0)
    shot.uv[~shot.is_seen] = np.nan
    return Detection(shot.uv, confidence, shot.is_inlier)
