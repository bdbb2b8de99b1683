# SPDX-License-Identifier: Apache-2.0
"""The derivatives by everything beyond the pose are those of the projection."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scenes

from rpgd_ros.core.adjust import Problem, State
from rpgd_ros.core.body_frame import body_frames
from rpgd_ros.core.geometry import Array, so3_exp
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.moments import N_ALL, N_ESTIMATED, Scene, sum_moments
from rpgd_ros.core.noise import NoiseModel
from rpgd_ros.core.normal import apply_delta
from rpgd_ros.core.observations import MocapTrack
from rpgd_ros.core.timeline import Timeline
from rpgd_ros.core.unknowns import Unknowns, assemble

LOSS = NoiseModel(sigma_px=2.0, nu=6.0, share=0.9, background=1e-6)
NAMES = ['offset', 'rate', 'joint x', 'joint y', 'joint z', 'focal', 'radial', 'scale']


@pytest.fixture(scope='module')
def given() -> tuple[Problem, State]:
    """Four cameras with late video and misplaced joints, near the optimum."""
    case = scenes.scene(frames=120, lag_s=0.02, bias_m=0.02)
    sights = [Sight(c, v) for c, v in zip(case.cameras, case.observations.views, strict=True)]
    track = case.observations.mocap
    assert track is not None
    centroid = np.nanmean(track.x_mocap, axis=(0, 1))
    n_joints = case.observations.n_joints
    random = np.random.default_rng(0)
    timeline = Timeline(track)
    middle_s = float(timeline.seconds(track.stamp_ns)[-1] / 2)
    body = body_frames(track.x_mocap)[0]
    problem = Problem(sights, timeline, body, centroid, middle_s=middle_s)
    state = replace(
        State.begin(case.truth.world_T_mocap, len(sights), n_joints),
        offset_s=np.array([0.005, 0.01, 0.02, 0.03]),
        rate=np.array([1e-3, 0.0, -2e-3, 0.0]),
        joint_offset=random.normal(0.0, 0.01, (n_joints, 3)),
    )
    return problem, state


def moved(problem: Problem, state: State, name: str, by: float) -> Scene:
    """Return the scene with one thing changed, the same in all cameras."""
    joint = state.joint_offset.copy()
    axis = 'xyz'.find(name[-1])
    if name.startswith('joint'):
        joint[:, axis] += by
    changed = replace(
        state,
        offset_s=state.offset_s + by * (name == 'offset'),
        rate=state.rate + by * (name == 'rate'),
        joint_offset=joint,
        focal=state.focal + by * (name == 'focal'),
        scale=state.scale + by * (name == 'scale'),
    )
    scene = problem.scene(changed)
    if name != 'radial':
        return scene
    k1 = by * np.eye(1, 5)[0]
    sights = [
        replace(s, camera=replace(s.camera, distortion=s.camera.distortion + k1))
        for s in scene.sights
    ]
    return replace(scene, sights=sights)


# A larger skeleton has larger noise, and so has one that a lens enlarges: the sums know that, the
# cost at a given noise does not.
OF_NOISE = {'radial', 'scale'}


@pytest.mark.parametrize(
    ('name', 'joint_sigma_m'),
    [(n, 0.0) for n in NAMES] + [(n, 0.02) for n in NAMES if n not in OF_NOISE],
)
def test_each_derivative_is_the_numeric_one(
    given: tuple[Problem, State], name: str, joint_sigma_m: float
) -> None:
    """A wrong sign would double what it should remove."""
    problem, state = given
    loss = replace(LOSS, joint_sigma_m=joint_sigma_m)
    n_joints, n_views = len(state.joint_offset), len(problem.sights)
    common = (0,) * n_views
    unknowns = Unknowns(common, common, n_joints, common, common, with_scale=True)
    scene = problem.scene(state)
    system = assemble(
        sum_moments(scene, state.pose, loss), unknowns, scene.sights,
        state.pose @ problem.centroid_mocap,
    )  # fmt: skip
    joints = [list(range(unknowns.joints.start + k, unknowns.joints.stop, 3)) for k in range(3)]
    slices = (unknowns.offsets, unknowns.rates, unknowns.focals, unknowns.radials, unknowns.scale)
    columns = [[*range(s.start, s.stop)] for s in slices]
    columns[2:2] = joints
    analytic = float(np.sum(system.gradient[columns[NAMES.index(name)]]))
    step = 2e-4 if name != 'rate' else 5e-5
    # The radius is taken where the lens shows the point.
    slack = 0.1 if name == 'radial' else 0.01
    costs = [
        sum_moments(moved(problem, state, name, by), state.pose, loss, n=N_ESTIMATED).cost
        for by in (step, -step)
    ]
    assert analytic == pytest.approx((costs[0] - costs[1]) / (2.0 * step), rel=slack)


def test_the_information_times_its_curvature_is_the_second_derivative() -> None:
    """On Gaussian and on heavy-tailed residuals, to a few percent of sampling."""
    case = scenes.scene('aistpp', frames=200, seed=1)
    sights = [Sight(c, v) for c, v in zip(case.cameras, case.observations.views, strict=True)]
    x = case.observations.views[0].x_mocap
    centroid = np.nanmean(x, axis=(0, 1))
    problem = Problem(sights, None, None, centroid)
    n = len(sights)
    state = State.begin(case.truth.world_T_mocap, n, x.shape[1])
    loss = NoiseModel(sigma_px=4.0, nu=3.0, share=0.95, background=1e-7)
    unknowns = Unknowns((-1,) * n, (-1,) * n)

    def gradient(k: int, by: float) -> Array:
        delta = np.zeros(6)
        delta[k] = by
        pose = apply_delta(state.pose, delta, state.pose @ centroid)
        scene = problem.scene(state)
        moments = sum_moments(scene, pose, loss, n=N_ESTIMATED)
        return assemble(moments, unknowns, sights, pose @ centroid).gradient

    scene = problem.scene(state)
    moments = sum_moments(scene, state.pose, loss, n=N_ESTIMATED)
    hessian = assemble(moments, unknowns, sights, state.pose @ centroid).hessian
    for k in range(6):
        numeric = (gradient(k, 1e-4)[k] - gradient(k, -1e-4)[k]) / 2e-4
        assert hessian[k, k] == pytest.approx(numeric, rel=0.1)


def test_fewer_directions_give_the_same_sums(given: tuple[Problem, State]) -> None:
    """What is not asked for costs no time and changes nothing."""
    problem, state = given
    scene = problem.scene(state)
    few, whole = (sum_moments(scene, state.pose, LOSS, n=n) for n in (N_ESTIMATED, N_ALL))
    np.testing.assert_allclose(
        few.information, whole.information[..., :N_ESTIMATED, :N_ESTIMATED], rtol=1e-5
    )
    assert few.cost == pytest.approx(whole.cost)


def test_the_heading_follows_the_body_wherever_up_is() -> None:
    """Turned by a known angle about any axis, a skeleton's heading turns with it."""
    case = scenes.scene(frames=300, seed=3)
    track = case.observations.mocap
    assert isinstance(track, MocapTrack)
    bodies = body_frames(track.x_mocap)
    assert len(bodies) > 1
    for body in bodies:
        first = body.headings(track.x_mocap)
        np.testing.assert_allclose(
            first @ first.swapaxes(1, 2), np.broadcast_to(np.eye(3), first.shape), atol=1e-9
        )
        turn = so3_exp(0.7 * body.up)
        again = body.headings(track.x_mocap @ turn.T)
        np.testing.assert_allclose(again, turn @ first, atol=0.02)
        vertical = case.truth.world_T_mocap.rotation @ body.up
        assert abs(vertical[2]) > 0.97


def test_a_missing_trunk_keeps_the_last_heading() -> None:
    """Gaps of the track leave no hole in the frame of the body."""
    track = scenes.scene(frames=100, seed=0).observations.mocap
    assert track is not None
    body = body_frames(track.x_mocap)[0]
    x = track.x_mocap.copy()
    x[40:60] = np.nan
    x[70, 3] = 1e300
    headings = body.headings(x)
    np.testing.assert_array_equal(headings[45], headings[39])
    assert np.isfinite(headings).all()


@pytest.mark.parametrize('x', [np.zeros((50, 17, 3)), np.ones((1, 17, 3)), np.zeros((9, 2, 3))])
def test_what_has_no_heading_has_no_frame(x: Array) -> None:
    """A point, a single frame, two joints."""
    assert body_frames(x) == []


def test_skeletons_of_which_none_is_whole_have_no_frame() -> None:
    """There is no shape to begin with where each lacks one of the joints."""
    track = scenes.scene(frames=170, seed=0).observations.mocap
    assert track is not None
    x = track.x_mocap.copy()
    assert body_frames(x)
    frame = np.arange(len(x))
    x[frame, frame % x.shape[1]] = np.nan
    assert body_frames(x) == []
