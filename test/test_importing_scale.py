# SPDX-License-Identifier: Apache-2.0
"""Whether the unit of a calibration is that of the skeleton: two cameras measure the person."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from camera_files import pose_of
from shoot import CAMERA_FPS, make_shoot
from shoot_files import MOCAP_FPS

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.importing import CameraPlan, Detections, Plan, SkeletonFile, plan_camera, settle
from rpgd_ros.importing.scale import check_scale
from rpgd_ros.io.rig_types import KeypointUnits


def make_plan(
    metres: float = 1.0, mocap_metres: float = 1.0, late_s: float = 0.0, *, is_share: bool = False
) -> Plan:
    """Return a walk before two cameras.

    Args:
        metres: That a metre of the calibration was written as.
        mocap_metres: Likewise, of the skeleton.
        late_s: How much later the second camera began than is said.
        is_share: Whether keypoints are shares of the image.

    """
    shoot = make_shoot()
    time_s = np.arange(len(shoot.x_mocap)) / MOCAP_FPS
    x = mocap_metres * shoot.x_mocap
    skeleton = settle(SkeletonFile(Path('walk.trc'), 'TRC', shoot.joints, time_s, x, 'm', 3))
    cameras: list[CameraPlan] = []
    for i, (camera, uv) in enumerate(zip(shoot.cameras, shoot.uv, strict=True)):
        pose = pose_of(camera)
        moved = replace(
            camera, camera_T_world=RigidTransform(pose.rotation, metres * pose.translation)
        )
        seen = uv[round(i * late_s * CAMERA_FPS) :]
        found = Detections(
            Path('video.json'), 'COCO JSON', np.arange(len(seen)),
            seen / camera.size if is_share else seen, np.ones(seen.shape[:2]), None, 0, 0, 0,
        )  # fmt: skip
        units: KeypointUnits = 'normalized' if is_share else 'pixels'
        cameras.append(
            plan_camera(
                skeleton, moved, found, joints=shoot.keypoints, fps=CAMERA_FPS, start_s=0.0,
                units=units,
            )
        )  # fmt: skip
    return Plan(skeleton, tuple(cameras), 'world')


@pytest.mark.parametrize(
    ('metres', 'asked', 'right'),
    [(100.0, None, 'cm'), (39.37, None, 'inch'), (0.01, 'cm', 'm'), (0.1, 'mm', 'cm')],
)
def test_calibration_in_another_unit_is_refused(
    metres: float, asked: str | None, right: str
) -> None:
    """With the file, both sizes and the unit that would fit."""
    message = rf'^wrong_unit: Calib.toml: the cameras see .* give --camera-units {right}$'
    with pytest.raises(InputError, match=message) as refused:
        check_scale(make_plan(metres), 'Calib.toml', asked)
    assert refused.value.reason is Reason.WRONG_UNIT


def test_format_with_a_unit_of_its_own_is_not_asked_for_another() -> None:
    """Such an option would be refused."""
    with pytest.raises(InputError, match='write its cameras with positions in the unit of its f'):
        check_scale(make_plan(1000.0), 'camchain.yaml', None, has_own=True)


@pytest.mark.parametrize(
    ('mocap_metres', 'units', 'right'), [(1.0 / 2.54, 'cm', 'inch'), (2.54, 'inch', 'cm')]
)
def test_skeleton_in_another_unit_is_refused(mocap_metres: float, units: str, right: str) -> None:
    """Where the cameras see a person of a usual size and the skeleton is none."""
    plan = make_plan(mocap_metres=mocap_metres)
    plan = replace(plan, skeleton=replace(plan.skeleton, units=units))
    message = rf'the skeleton walk.trc has .* give --units {right}$'
    with pytest.raises(InputError, match=message):
        check_scale(plan, 'Calib.toml', None)


@pytest.mark.parametrize('late_s', [0.0, 0.1, 0.5, 2.0])
def test_right_units_are_taken_whenever_the_cameras_began(late_s: float) -> None:
    """A walk between the frames moves the person; its size stays."""
    check_scale(make_plan(late_s=late_s), 'Calib.toml', None)


def test_shares_of_the_image_measure_as_pixels_do() -> None:
    """The same person, the same sizes."""
    check_scale(make_plan(is_share=True), 'Calib.toml', None)
    with pytest.raises(InputError, match='give --camera-units mm'):
        check_scale(make_plan(1000.0, is_share=True), 'Calib.toml', None)


def test_nothing_is_said_where_nothing_is_measured() -> None:
    """One camera, cameras without poses, and cameras that are not where they are said to be."""
    plan = make_plan(100.0)
    a, b = plan.cameras
    lost = [replace(c, camera=replace(c.camera, camera_T_world=None)) for c in (a, b)]
    turned = RigidTransform(pose_of(b.camera).rotation[[1, 0, 2]] * [1, 1, -1], np.zeros(3))
    astray = replace(b, camera=replace(b.camera, camera_T_world=turned))
    for cameras in ((a,), tuple(lost), (a, astray)):
        check_scale(replace(plan, cameras=cameras), 'Calib.toml', None)
