# SPDX-License-Identifier: Apache-2.0
"""Descends in pose, clocks and joint offsets together.

A video that is stamped late shows the body where it has been: MoCap time = video stamp - offset.
A detector's hip is not the MoCap's hip: it sits elsewhere on the body and turns with it. At
walking speed 5 ms cost as much as the whole rest of the error, 2 cm ten times that, and the
reprojection error hides both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.moments import N_ALL, N_ESTIMATED, Scene, sum_moments
from rpgd_ros.core.noise import NoiseModel
from rpgd_ros.core.noise_fit import noise_at
from rpgd_ros.core.normal import apply_delta
from rpgd_ros.core.unknowns import Solution, System, Unknowns, assemble

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.body_frame import BodyFrame
    from rpgd_ros.core.noise import Loss
    from rpgd_ros.core.timeline import Timeline

CONVERGED = 1e-6  # Newton decrement, as in `refine`
LARGEST_STEP_S = 0.1  # beyond it velocities have changed
LEAST_SHRINK = 1e-3
# Standard deviations of the joints' offsets that are weighed against each other, metres, and how
# much (log likelihood) any must explain the data better than none.
JOINT_SIGMAS_M = np.geomspace(0.001, 0.08, 14)
JOINT_GAIN = 15.0
JOINT_SIGMA_M = 0.02  # to begin with
FOCAL_PRIOR = 0.005  # a chessboard filmed in haste: standard deviation of a focal length


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Everything that is estimated.

    Attributes:
        pose: world_T_mocap.
        offset_s: (V,) seconds by which each video is stamped late in mid-recording.
        rate: (V,) how much later it gets per second.
        joint_offset: (J, 3) where the detector sees each joint, metres, the body's frame.
        focal: (V,) share by which each focal length is longer than given.
        scale: Share by which the skeleton is larger than given, about the body's centroid.
        joint_sigma_m: Standard deviation of the prior of the joints' offsets, per axis; 0 = they
            are held.

    """

    pose: RigidTransform
    offset_s: Array
    rate: Array
    joint_offset: Array
    focal: Array
    scale: float = 0.0
    joint_sigma_m: float = 0.0

    @classmethod
    def begin(cls, pose: RigidTransform, n_views: int, n_joints: int) -> Self:
        """Take everything but the pose as it was given."""
        zero = np.zeros(n_views)
        return cls(pose, zero, zero, np.zeros((n_joints, 3)), zero)

    def moved(self, delta: Array, unknowns: Unknowns, pivot_world: Array) -> State:
        """Return the state after a step of the unknowns."""
        joint_offset = self.joint_offset
        if unknowns.n_joints:
            joint_offset = joint_offset + delta[unknowns.joints].reshape(-1, 3)
        return replace(
            self,
            pose=apply_delta(self.pose, delta[:6], pivot_world),
            offset_s=self.offset_s + _by_camera(delta[unknowns.offsets], unknowns.offset),
            rate=self.rate + _by_camera(delta[unknowns.rates], unknowns.rate),
            joint_offset=joint_offset,
            focal=self.focal + _by_camera(delta[unknowns.focals], unknowns.focal),
            scale=self.scale + float(delta[unknowns.scale].sum()),
        )


def _by_camera(step: Array, numbers: Sequence[int]) -> Array:
    """(V,) of the steps of some cameras; zero for the others. () for none."""
    return np.array([step[n] if n >= 0 else 0.0 for n in numbers]) if numbers else np.zeros(1)


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What is given: cameras, MoCap track, the frame of the body.

    Attributes:
        sights: Cameras with their data as they came.
        timeline: The MoCap track; None where no time is known.
        body: The mean shape of the body; None where it has no frame.
        centroid_mocap: (3,) centre of the body, metres.
        are_joints_noisy: Whether the track itself shows that its joints are noisy.
        middle_s: Middle of the recording, seconds of the timeline: where a clock that runs wrong
            is off by its offset alone.

    """

    sights: Sequence[Sight]
    timeline: Timeline | None
    body: BodyFrame | None
    centroid_mocap: Array
    are_joints_noisy: bool = False
    middle_s: float = 0.0

    def noise_at(self, state: State, *, with_joints: bool) -> NoiseModel:
        """Fit the spread of the residuals of a state."""
        return noise_at(
            self.scene(state).sights, state.pose, with_joints=with_joints,
            are_noisy=self.are_joints_noisy,
        )  # fmt: skip

    def scene(self, state: State) -> Scene:
        """Give each camera the skeletons of its clock, joints where its detector sees them."""
        sights, velocities, turns, times = [], [], [], []
        for v, sight in enumerate(self.sights):
            x, seconds = sight.view.x_mocap, np.zeros(sight.view.n_frames)
            turn = None
            stamp_ns = sight.view.stamp_ns
            if self.timeline is not None and stamp_ns is not None:
                t = self.timeline.seconds(stamp_ns)
                seconds = t - self.middle_s
                t = t - state.offset_s[v] - state.rate[v] * seconds
                x, velocity = self.timeline.at(t)
                velocities.append(velocity)
                if self.body is not None:
                    turn = self.timeline.turned(self.body, t)
            elif self.body is not None:
                turn = self.body.headings(x)
            if turn is not None:
                turns.append(turn)
                if state.joint_offset.any():
                    x = x + np.einsum('fik,jk->fji', turn, state.joint_offset)
            if state.scale:
                x = self.centroid_mocap + (1.0 + state.scale) * (x - self.centroid_mocap)
            factor = 1.0 + float(state.focal[v])
            camera = sight.camera if factor == 1.0 else sight.camera.with_focal(factor)
            times.append(seconds)
            sights.append(Sight(camera, replace(sight.view, x_mocap=x)))
        return Scene(sights, velocities or None, turns or None, times, self.centroid_mocap)


def look(problem: Problem, state: State, unknowns: Unknowns, loss: Loss) -> System:
    """Sum the normal equations of the unknowns at a state."""
    scene = problem.scene(state)
    n = N_ALL if unknowns.focal or unknowns.with_scale else N_ESTIMATED
    moments = sum_moments(scene, state.pose, loss, n=n)
    return assemble(moments, unknowns, scene.sights, state.pose @ problem.centroid_mocap)


def solved_at(problem: Problem, state: State, unknowns: Unknowns, loss: Loss) -> Solution:
    """Sum the normal equations at a state, and solve them with its priors."""
    precision, _ = prior(unknowns, state)
    return look(problem, state, unknowns, loss).solved(precision)


def adjust(
    problem: Problem, state: State, unknowns: Unknowns, loss: Loss,
    *, max_steps: int, check: Callable[[float], None],
) -> tuple[State, System]:  # fmt: skip
    """Go to the nearest optimum by Newton's method.

    Cost and prior together never rise, but for the last step, which is not looked at.

    Args:
        problem: What is given.
        state: Start.
        unknowns: What may move.
        loss: Loss of the squared residual.
        max_steps: Most steps tried.
        check: Called with the fraction done; raises to end the run.

    Returns:
        The state, and the sums where the last step began.

    """
    shrink = 1.0
    here = look(problem, state, unknowns, loss)
    for step in range(1, max_steps + 1):
        check(step / max_steps)
        precision, value = prior(unknowns, state)
        delta, decrement = here.solved(precision).step(value)
        longest = np.abs(delta[unknowns.offsets]).max(initial=0.0)
        delta *= shrink * min(1.0, LARGEST_STEP_S / max(longest, 1e-12))
        moved = state.moved(delta, unknowns, state.pose @ problem.centroid_mocap)
        if decrement < CONVERGED or step == max_steps:
            return moved, here
        there = look(problem, moved, unknowns, loss)
        before, after = (s.cost + _prior_cost(at) for s, at in ((here, state), (there, moved)))
        if after <= before * (1.0 + 1e-7):
            state, here, shrink = moved, there, 1.0
        else:
            shrink *= 0.5
            if shrink < LEAST_SHRINK:
                break
    return state, here


def prior(unknowns: Unknowns, state: State) -> tuple[Array, Array]:
    """(p,) precision of the prior of each unknown, and its present value.

    Focal lengths, where they are unknown, are so camera by camera.
    """
    precision, value = np.zeros((2, len(unknowns)))
    if unknowns.n_joints:
        precision[unknowns.joints] = state.joint_sigma_m**-2
        value[unknowns.joints] = state.joint_offset.ravel()
    if unknowns.focal:
        precision[unknowns.focals] = FOCAL_PRIOR**-2
        value[unknowns.focals] = state.focal
    return precision, value


def _prior_cost(state: State) -> float:
    cost = 0.5 * float((state.focal**2).sum()) / FOCAL_PRIOR**2
    if state.joint_sigma_m:
        cost += 0.5 * float((state.joint_offset**2).sum()) / state.joint_sigma_m**2
    return cost


def joint_sigma(system: System, state: State) -> tuple[float, float]:
    """Choose the spread of the joints' offsets by the likelihood of the data (empirical Bayes).

    Pose and clocks are projected out. What remains says of the offsets o, to second order, that
    the cost is `o^T S o / 2 - b^T o`; with a prior of standard deviation s the likelihood is
    `|1 + s^2 S|^(-1/2) exp(b^T (S + s^-2)^-1 b / 2)`.

    Args:
        system: With joints among its unknowns, at the state.
        state: Where it was summed.

    Returns:
        Metres, 0 where no offsets explain the data as well; and by how much the log likelihood
        is above that of none.

    """
    joints = system.unknowns.joints
    rest = np.ones(len(system.unknowns), bool)
    rest[joints] = False
    inner = np.linalg.pinv(system.hessian[np.ix_(rest, rest)], hermitian=True)
    across = system.hessian[joints, rest] @ inner
    s = system.hessian[joints, joints] - across @ system.hessian[rest][:, joints]
    values, vectors = np.linalg.eigh(0.5 * (s + s.T))
    values = np.maximum(values, 0.0)
    pull = system.gradient[joints] - across @ system.gradient[rest]
    b = vectors.T @ (s @ state.joint_offset.ravel() - pull)
    best, most = 0.0, JOINT_GAIN
    for sigma in JOINT_SIGMAS_M:
        gain = 0.5 * float(np.sum(b**2 / (values + sigma**-2) - np.log1p(sigma**2 * values)))
        if gain > most:
            best, most = float(sigma), gain
    return best, most
