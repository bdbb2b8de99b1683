# SPDX-License-Identifier: Apache-2.0
"""The overlay shows keypoints and reprojected skeleton where they are."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import scenes

from rpgd_ros.core import RigidTransform
from rpgd_ros.report import overlay_sheet, write_png
from rpgd_ros.report.overlay import REPROJECTED, draw_skeleton


def test_a_joint_is_drawn_at_its_pixel_and_a_missing_one_nowhere() -> None:
    """A wrong sub-pixel shift would put all of them beside their places."""
    image = np.zeros((200, 400, 3), np.uint8)
    draw_skeleton(image, np.array([[100.0, 50.0], [np.nan, 80.0], [1e9, 2.0]]), (), (1, 2, 3))
    rows, columns = np.nonzero(image.any(-1))
    assert abs(rows.mean() - 50.0) < 0.5
    assert abs(columns.mean() - 100.0) < 0.5
    assert len(rows) < 60


def test_the_calibrated_skeleton_covers_the_keypoints_and_a_wrong_one_does_not() -> None:
    """What a person looks for in the picture is there to be seen."""
    case = scenes.perfect(frames=50)

    def uncovered(world_T_mocap: RigidTransform) -> int:
        sheet = overlay_sheet(case.cameras, case.observations, world_T_mocap, edges=(), instants=1)
        above_legend = sheet[:-44].astype(int)
        return int((np.abs(above_legend - REPROJECTED).sum(-1) < 60).sum())

    truth = case.truth.world_T_mocap
    moved = RigidTransform(truth.rotation, truth.translation + np.array([0.5, 0.0, 0.0]))
    assert uncovered(truth) < 0.1 * uncovered(moved)


def test_the_picture_is_written_as_a_file_that_others_open(tmp_path: Path) -> None:
    """PNG, whole."""
    case = scenes.perfect(frames=10)
    sheet = overlay_sheet(case.cameras, case.observations, case.truth.world_T_mocap, edges=())
    write_png(tmp_path / 'overlay.png', sheet)
    again = cv2.imread(str(tmp_path / 'overlay.png'))
    assert again is not None
    assert np.array_equal(again, sheet)
