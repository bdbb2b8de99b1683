# SPDX-License-Identifier: Apache-2.0
"""Questions that are asked at the optimum, without correcting for their answers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.adjust import Problem, State, prior
from rpgd_ros.core.focal import FocalCheck
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.moments import Moments, sum_moments
from rpgd_ros.core.thin import budget, thin
from rpgd_ros.core.unknowns import System, Unknowns, assemble

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.linearise import Sight
    from rpgd_ros.core.noise import Loss
    from rpgd_ros.core.synchronise import Settled

POINTS = 8192  # that are looked at: 3 ms
SIZE_SIGMAS, LEAST_SIZE = 5.0, 0.003  # of the skeleton: beyond doubt, and worth a word


@dataclass(frozen=True, slots=True, eq=False)
class Questions:
    """A part of the data at the optimum, ready to be asked.

    Attributes:
        sights: Cameras with their settled skeletons.
        moments: Sums of all directions.
        state: Where they were summed.
        unknowns: What was estimated there.
        centroid_mocap: (3,) pivot, metres.

    """

    sights: Sequence[Sight]
    moments: Moments
    state: State
    unknowns: Unknowns
    centroid_mocap: Array

    @classmethod
    def of_pose(
        cls, sights: Sequence[Sight], pose: RigidTransform, centroid: Array, loss: Loss
    ) -> Questions:
        """Ask where nothing but the pose was estimated."""
        few = thin(sights, 0, budget(sights, POINTS))
        n = len(few)
        state = State.begin(pose, n, few[0].view.n_joints)
        problem = Problem(few, None, None, centroid)
        return cls._asked(problem, state, Unknowns((-1,) * n, (-1,) * n), loss)

    @classmethod
    def of_settled(cls, problem: Problem, at: Settled) -> Questions:
        """Ask where more was."""
        few = thin(problem.sights, 0, budget(problem.sights, POINTS))
        return cls._asked(replace(problem, sights=few), at.state, at.unknowns, at.noise)

    @classmethod
    def _asked(cls, problem: Problem, state: State, unknowns: Unknowns, loss: Loss) -> Questions:
        scene = problem.scene(state)
        moments = sum_moments(scene, state.pose, loss)
        return cls(scene.sights, moments, state, unknowns, problem.centroid_mocap)

    def focal(self, *, is_common: bool) -> FocalCheck:
        """Ask for the focal lengths: one error of all cameras, or of each."""
        n = len(self.sights)
        return FocalCheck.of(*self._with(focal=(0,) * n if is_common else tuple(range(n))))

    def size(self) -> tuple[float, float] | None:
        """Share by which the skeleton should be larger, and its sigma; None for one camera.

        A single camera sees the same of a larger body farther away.
        """
        if len(self.sights) < 2:
            return None
        system, precision = self._with(with_scale=True)
        step, _ = system.step(precision, self._values(system))
        column = system.unknowns.scale.start
        sigma = np.sqrt(system.covariance(precision)[column, column])
        return float(step[column]), float(sigma)

    def _with(self, **more: bool | tuple[int, ...]) -> tuple[System, Array]:
        """Sums with more unknowns, and the precision of the priors of those that were there."""
        unknowns = replace(self.unknowns, **more)  # type: ignore[arg-type]
        pivot = self.state.pose @ self.centroid_mocap
        system = assemble(self.moments, unknowns, self.sights, pivot)
        precision = np.zeros(len(unknowns))
        precision[: len(self.unknowns)], _ = prior(self.unknowns, self.state)
        return system, precision

    def _values(self, system: System) -> Array:
        values = np.zeros(len(system.unknowns))
        _, values[: len(self.unknowns)] = prior(self.unknowns, self.state)
        return values


def size_sentence(size: tuple[float, float]) -> str | None:
    """Say to a person that the skeleton has the wrong size, where it has."""
    error, sigma = size
    if abs(error) <= max(LEAST_SIZE, SIZE_SIGMAS * sigma):
        return None
    way = 'small' if error > 0.0 else 'large'
    return (
        f'the MoCap skeleton looks {100 * abs(error):.1f} +- {100 * sigma:.1f} % too {way}: a '
        'suit with the wrong body size, or a MoCap volume calibrated with the wrong wand length'
    )
