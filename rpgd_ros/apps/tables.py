# SPDX-License-Identifier: Apache-2.0
"""Tables for people: what came in, and what was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from rpgd_ros.apps.found_tables import found_rows, joint_rows, unseen_sentence
from rpgd_ros.core.camera_pose import CameraPose, is_mocap_world
from rpgd_ros.core.result import Calibration, GroupFit
from rpgd_ros.report import StreamCount


def print_streams(console: Console, streams: Sequence[StreamCount]) -> None:
    """Print what became of the messages of each stream."""
    table = new_table('stream', 'topic', 'messages', 'kept', 'paired', 'dropped, missing joints')
    for stream in streams:
        rest = ', '.join(f'{n} {reason}' for reason, n in stream.dropped.items())
        paired = '' if stream.paired is None else str(stream.paired)
        table.add_row(
            escape(stream.stream),
            escape(stream.topic),
            str(stream.received),
            str(stream.kept),
            paired,
            rest,
        )
    console.print(table)


def print_calibration(
    console: Console, calibration: Calibration, world_frame: str, mocap_frame: str
) -> None:
    """Print the transform, how sure it is, and how each camera agrees with it."""
    table = new_table('camera', 'agree', 'keypoints', 'MPJPE px', 'agreeing px', 'bias px')
    for fit in calibration.per_camera.values():
        table.add_row(*_camera_row(fit))
    console.print(table)
    pose, covariance = calibration.world_T_mocap, calibration.covariance
    poses = calibration.camera_poses
    sigma_deg, sigma_m = calibration.worst_sigma
    table = new_table('', '')
    table.show_header = False
    frames = f'{world_frame} <- {mocap_frame}'
    for name, value in (
        ('transform', f'{frames}: x_world = R x_mocap + t'),
        ('t (x y z)', f'{_numbers(pose.translation)} m'),
        ('q (x y z w)', _numbers(pose.quat_xyzw)),
        (
            'sigma',
            'none: the MoCap frame is the world'
            if is_mocap_world(poses, covariance)
            else f'{sigma_deg:.3f} deg, {1000 * sigma_m:.1f} mm at the body',
        ),
        ('MPJPE', f'{calibration.mpjpe_px:.2f} px, median {calibration.median_px:.2f} px'),
        ('inliers', f'{100 * calibration.inlier_ratio:.1f} % of {calibration.correspondences}'),
        ('frames', str(calibration.frames)),
        ('solve', f'{calibration.seconds:.2f} s'),
        *found_rows(calibration),
    ):
        table.add_row(escape(name), escape(value))
    console.print(table)
    _print_joints(console, calibration)
    if poses:
        _print_poses(console, poses)
    for warning in calibration.warnings:
        console.print(f'warning: {warning}', markup=False, highlight=False, soft_wrap=True)


def _print_joints(console: Console, calibration: Calibration) -> None:
    """Print where the detector sees the joints, and what nobody can see of that."""
    rows = list(joint_rows(calibration))
    if rows:
        table = new_table(
            'joint', 'seen beside the MoCap by x y z, mm, turning with the body', 'sigma'
        )
        for row in rows:
            table.add_row(*map(escape, row))
        console.print(table)
    unseen = unseen_sentence(calibration)
    if unseen:
        console.print(unseen, markup=False, highlight=False, soft_wrap=True)


def _print_poses(console: Console, poses: Mapping[str, CameraPose]) -> None:
    """Print where the cameras stand that had no extrinsics."""
    table = new_table('placed', 'x y z in the world, m', 'sigma deg', 'body mm', 'place mm')
    for name, pose in poses.items():
        table.add_row(
            name,
            ' '.join(f'{v:.4f}' for v in pose.world_T_camera.translation),
            f'{pose.sigma_rotation_deg:.3f}',
            f'{1000 * pose.sigma_position_m:.1f}',
            f'{1000 * pose.sigma_centre_m:.1f}',
        )
    console.print(table)


def _camera_row(fit: GroupFit) -> tuple[str, ...]:
    return (
        escape(fit.name),
        f'{100 * fit.inlier_ratio:.1f} %',
        str(fit.correspondences),
        f'{fit.mpjpe_px:.2f}',
        f'{fit.inlier_mpjpe_px:.2f}',
        f'{fit.bias_px[0]:+.2f} {fit.bias_px[1]:+.2f}',
    )


def _numbers(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    return ' '.join(f'{value:.6f}' for value in values)


def new_table(*columns: str) -> Table:
    """Return an empty table as all programs print it: words left, numbers right."""
    table = Table(box=None, pad_edge=False, header_style='bold')
    for i, column in enumerate(columns):
        table.add_column(column, overflow='fold', justify='left' if i < 2 else 'right')
    return table
