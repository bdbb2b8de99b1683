# SPDX-License-Identifier: Apache-2.0
"""Which unknowns are solved for, and their normal equations out of the moments.

Parameters, in this order: the pose's six (see `normal`), the offset of each clock, the rate of
each clock, three per joint (where the detector sees it, in the body's frame), and those that are
only asked about: focal lengths, radial distortions and the size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.covariance import between_groups, invert, larger
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.moments import FOCAL, JOINT, LATE, RADIAL, RATE, SCALE, TWIST, Moments
from rpgd_ros.core.normal import twist_from_delta

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.linearise import Sight

POSE = slice(0, 6)


@dataclass(frozen=True, slots=True)
class Unknowns:
    """Where each unknown stands among the parameters.

    Attributes:
        offset: Per camera the number of its clock's offset, or -1 where it is held.
        rate: Per camera the number of its clock's rate, or -1.
        n_joints: Joints with an offset of their own; 0 for none.
        focal: Per camera the number of its focal length, or -1.
        radial: Per camera the number of its radial distortion k1, or -1.
        with_scale: Whether the skeleton's size is one of them.

    """

    offset: tuple[int, ...]
    rate: tuple[int, ...]
    n_joints: int = 0
    focal: tuple[int, ...] = ()
    radial: tuple[int, ...] = ()
    with_scale: bool = False

    @property
    def offsets(self) -> slice:
        """Columns of the clocks' offsets."""
        return slice(6, 6 + _count(self.offset))

    @property
    def rates(self) -> slice:
        """Columns of the clocks' rates."""
        start = self.offsets.stop
        return slice(start, start + _count(self.rate))

    @property
    def joints(self) -> slice:
        """Columns of the joints' offsets, three by three."""
        start = self.rates.stop
        return slice(start, start + 3 * self.n_joints)

    @property
    def focals(self) -> slice:
        """Columns of the focal lengths."""
        start = self.joints.stop
        return slice(start, start + _count(self.focal))

    @property
    def radials(self) -> slice:
        """Columns of the radial distortions."""
        start = self.focals.stop
        return slice(start, start + _count(self.radial))

    @property
    def scale(self) -> slice:
        """Column of the size."""
        start = self.radials.stop
        return slice(start, start + int(self.with_scale))

    def __len__(self) -> int:
        """Return the number of parameters."""
        stop: int = self.scale.stop
        return stop

    def of_camera(self, v: int, camera_T_world: RigidTransform, pivot: Array, n: int) -> Array:
        """(n, p) the local directions of one camera by the parameters, joints left out."""
        out = np.zeros((n, len(self)))
        out[TWIST, POSE] = twist_from_delta(camera_T_world, pivot)
        for local, numbers, columns in (
            (LATE, self.offset, self.offsets),
            (RATE, self.rate, self.rates),
            (FOCAL, self.focal, self.focals),
            (RADIAL, self.radial, self.radials),
        ):
            if numbers and numbers[v] >= 0:
                out[local, columns.start + numbers[v]] = 1.0
        if self.with_scale:
            out[SCALE, self.scale] = 1.0
        return out


def _count(numbers: Sequence[int]) -> int:
    return max([*numbers, -1]) + 1


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """Normal equations of the unknowns, p parameters, without any prior.

    Attributes:
        unknowns: What they are.
        hessian: (p, p) of the cost.
        gradient: (p,).
        joint_scores: (J, p) gradient per joint.
        time_scores: (TIME_BLOCKS, p) gradient per stretch of time.
        cost: Sum of the loss.

    """

    unknowns: Unknowns
    hessian: Array
    gradient: Array
    joint_scores: Array
    time_scores: Array
    cost: float

    def solved(self, precision: Array) -> Solution:
        """Solve with a prior about zero of each parameter, of this (p,) precision; 0 for none."""
        return Solution(self, precision, invert(self.hessian + np.diag(precision)))


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Normal equations with priors, solved.

    Attributes:
        system: Without the priors.
        precision: (p,) of the prior of each parameter about zero; 0 for none.
        inverse: (p, p) covariance of independent errors.

    """

    system: System
    precision: Array
    inverse: Array

    def step(self, value: Array) -> tuple[Array, float]:
        """Return the Newton step and its decrement, from the (p,) present values of the priors."""
        pull = self.system.gradient + self.precision * value
        step = -self.inverse @ pull
        return step, float(-pull @ step)

    @property
    def covariance(self) -> Array:
        """(p, p) the larger of that of independent errors and of what differs between joints."""
        by_joint = self.inverse @ between_groups(self.system.joint_scores) @ self.inverse
        return larger(self.inverse, by_joint)

    @property
    def covariance_over_time(self) -> Array:
        """(p, p) from what differs between stretches of time."""
        return self.inverse @ between_groups(self.system.time_scores) @ self.inverse


def assemble(
    moments: Moments, unknowns: Unknowns, sights: Sequence[Sight], pivot_world: Array
) -> System:
    """Pick the normal equations of the unknowns out of the moments.

    Args:
        moments: Sums at the present state.
        unknowns: What is solved for.
        sights: The cameras.
        pivot_world: (3,) pivot of the pose's parameters, metres.

    """
    p, n = len(unknowns), moments.information.shape[-1]
    hessian = np.zeros((p, p))
    _, n_blocks, n_joints, _ = moments.gradient.shape
    joint_scores, time_scores = np.zeros((n_joints, p)), np.zeros((n_blocks, p))
    joints = unknowns.joints
    own = np.arange(joints.start, joints.stop).reshape(-1, 3)
    for v, sight in enumerate(sights):
        local = unknowns.of_camera(v, sight.camera_T_world, pivot_world, n)
        info, gradient = moments.information[v], moments.gradient[v]
        hessian += local.T @ info.sum(0) @ local
        joint_scores += gradient.sum(0) @ local
        time_scores += gradient.sum(1) @ local
        if unknowns.n_joints:
            cross = np.einsum('lp,jlk->pjk', local, info[:, :, JOINT])
            hessian[:, joints] += cross.reshape(p, -1)
            hessian[joints] += cross.reshape(p, -1).T
            for j, columns in enumerate(own):
                hessian[np.ix_(columns, columns)] += info[j, JOINT, JOINT]
                joint_scores[j, columns] += gradient[:, j, JOINT].sum(0)
            time_scores[:, joints] += gradient[:, :, JOINT].reshape(n_blocks, -1)
    gradient = joint_scores.sum(0)
    return System(unknowns, hessian, gradient, joint_scores, time_scores, moments.cost)
