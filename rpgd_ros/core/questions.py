# SPDX-License-Identifier: Apache-2.0
"""Questions that are asked at the optimum, without correcting for their answers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rpgd_ros.core.adjust import FOCAL_PRIOR, Problem, State, prior
from rpgd_ros.core.answer import Answer
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.moments import Moments, sum_moments
from rpgd_ros.core.thin import thin
from rpgd_ros.core.unknowns import Solution, Unknowns, assemble

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.linearise import Sight
    from rpgd_ros.core.noise import Loss
    from rpgd_ros.core.synchronise import Settled

POINTS, SETTLED_POINTS = 8192, 65_536  # that are looked at: 3 and 25 ms
LEAST_FOCAL = 0.001  # better than a chessboard does
RADIAL_PRIOR, LEAST_RADIAL = 0.01, 0.01  # of k1, by a chessboard: two pixels at the rim
SIZE_PRIOR, LEAST_SIZE = 0.003, 0.003  # of a MoCap volume that was calibrated with its wand


class Lenses(NamedTuple):
    """What the film says of the lenses.

    Attributes:
        focal: Errors of the focal lengths, with k1 as given where it is not doubted.
        radial: Errors of k1, whatever the focal lengths are.
        both: All of them.

    """

    focal: Answer
    radial: Answer
    both: Answer


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
        few = thin(sights, POINTS)
        n = len(few)
        state = State.begin(pose, n, few[0].view.n_joints)
        problem = Problem(few, None, None, centroid)
        return cls._asked(problem, state, Unknowns((-1,) * n, (-1,) * n), loss)

    @classmethod
    def of_settled(cls, problem: Problem, at: Settled) -> Questions:
        """Ask where more was."""
        few = thin(problem.sights, SETTLED_POINTS)
        return cls._asked(replace(problem, sights=few), at.state, at.unknowns, at.noise)

    @classmethod
    def _asked(cls, problem: Problem, state: State, unknowns: Unknowns, loss: Loss) -> Questions:
        scene = problem.scene(state)
        moments = sum_moments(scene, state.pose, loss)
        return cls(scene.sights, moments, state, unknowns, problem.centroid_mocap)

    def lenses(self, *, is_common: bool) -> Lenses:
        """Ask for focal length and radial distortion: one error of all cameras, or of each."""
        n = len(self.sights)
        numbers = (0,) * n if is_common else tuple(range(n))
        whole, value = self._with(focal=numbers, radial=numbers)
        unknowns = whole.system.unknowns
        prior, least = np.zeros((2, len(unknowns)))
        prior[unknowns.focals], least[unknowns.focals] = FOCAL_PRIOR, LEAST_FOCAL
        prior[unknowns.radials], least[unknowns.radials] = RADIAL_PRIOR, LEAST_RADIAL

        def asked(solution: Solution, value: Array, part: slice) -> Answer:
            return Answer.of(solution, part, value, prior=prior[part], least=least[part])

        both = asked(whole, value, slice(unknowns.focals.start, unknowns.radials.stop))
        radial = asked(whole, value, unknowns.radials)
        freed = np.where(radial.doubted, np.cumsum(radial.doubted) - 1, -1)[list(numbers)]
        some = self._with(focal=numbers, radial=tuple(freed.tolist()))
        return Lenses(asked(*some, unknowns.focals), radial, both)

    def size(self) -> Answer | None:
        """Ask for the size of the skeleton; None for one camera.

        A single camera sees the same of a larger body farther away.
        """
        if len(self.sights) < 2:
            return None
        solution, value = self._with(with_scale=True)
        return Answer.of(
            solution,
            solution.system.unknowns.scale,
            value,
            prior=np.array([SIZE_PRIOR]),
            least=np.array([LEAST_SIZE]),
        )

    def _with(
        self, *, focal: tuple[int, ...] = (), radial: tuple[int, ...] = (),
        with_scale: bool = False,
    ) -> tuple[Solution, Array]:  # fmt: skip
        """Solve with more unknowns; and the values of those that were there and have a prior."""
        unknowns = replace(self.unknowns, focal=focal, radial=radial, with_scale=with_scale)
        pivot = self.state.pose @ self.centroid_mocap
        system = assemble(self.moments, unknowns, self.sights, pivot)
        precision, value = np.zeros((2, len(unknowns)))
        n = len(self.unknowns)
        precision[:n], value[:n] = prior(self.unknowns, self.state)
        return system.solved(precision), value


def focal_sentences(focal: Answer, names: Sequence[str]) -> list[str]:
    """Say to a person what is wrong; the names are those of the cameras asked one by one."""
    out = []
    for k in focal.wrong:
        whose = f'focal length of camera {names[k]} looks' if names else 'focal lengths look'
        way = 'short' if focal.error[k] > 0.0 else 'long'
        out.append(
            f'the {whose} {focal.percent(k)} too {way}: the intrinsics do not fit the film. '
            'Calibrate them again; the reported sigma holds what that may move'
        )
    return out


def radial_sentences(radial: Answer, names: Sequence[str]) -> list[str]:
    """Say to a person which lens is not the one that was given."""
    out = []
    for k in radial.wrong:
        whose = f'lens of camera {names[k]} bends' if names else 'lenses bend'
        out.append(
            f'the {whose} the image otherwise than given (radial distortion k1 is off by '
            f'{radial.error[k]:+.3f} +- {radial.sigma[k]:.3f}): the intrinsics do not fit the '
            'film. Calibrate them again; the reported sigma holds what that may move'
        )
    return out


def size_sentence(size: Answer) -> str:
    """Say to a person that the skeleton has the wrong size."""
    way = 'small' if size.error[0] > 0.0 else 'large'
    return (
        f'the MoCap skeleton looks {size.percent(0)} too {way}: a suit with the wrong body size, '
        'or a MoCap volume calibrated with the wrong wand length'
    )
