# SPDX-License-Identifier: Apache-2.0
"""How residuals are spread, and the losses that follow from it.

A residual is either the detector's noise, a bivariate Student-t of scale sigma and tail nu (a
Gaussian for large nu), or gross: a much broader one. All of it is fitted to the residuals at a
pose, so no threshold needs to be known beforehand. Near the pose the gross part is flat, so the
loss is the negative log likelihood of noise plus a constant: outliers lose their pull smoothly
where they become the better explanation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rpgd_ros.core.geometry import Array, Column
from rpgd_ros.core.linearise import Residuals

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
