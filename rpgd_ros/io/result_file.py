# SPDX-License-Identifier: Apache-2.0
"""The result file: the transform, how far to trust it, and how it came about."""

from __future__ import annotations

import math
import platform
import shlex
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from rpgd_ros import __version__
from rpgd_ros.core.camera_pose import CameraPose
from rpgd_ros.core.errors import Reason
from rpgd_ros.core.geometry import Array, RigidTransform, euler_zyx_from_rotation
from rpgd_ros.core.result import Calibration, GroupFit
from rpgd_ros.io.atomic import refuse_link, write_atomic
from rpgd_ros.io.backups import back_up, backups, utc
from rpgd_ros.io.camera_poses import (
    poses_tree,
    read_covariance,
    read_poses,
    read_transform,
    transform_tree,
)
from rpgd_ros.io.found import FOUND, Found, Pair, StoredLevel, found_tree, read_found
from rpgd_ros.io.frames import NONE, Frames
from rpgd_ros.io.strict import Node, read_yaml

__all__ = [
    'StoredLevel',
    'StoredResult',
    'backups',
    'read_result',
    'result_text',
    'write_result',
]

SCHEMA: Final = 1
NO_LEVELS: Final[Mapping[str, StoredLevel]] = {}
CONVENTION: Final = (
    'x_world = world_T_mocap @ x_mocap: the pose of the MoCap origin in the world, metres, '
    'right-handed; TF carries it from world_frame (parent) to mocap_frame (child). '
    'Covariance of (rotation [rad], translation [m]), both along the axes of the world; those of '
    'camera_poses along the axes of the camera. time_offset_s, clock_rate, focal_error and '
    'skeleton_scale are [value, standard deviation]: seconds that a video is stamped late, '
    'seconds per second, and shares by which focal length and skeleton were given too small.'
)
# Keys that nothing is read from: for people and other programs.
FOR_PEOPLE: Final = (
    *('convention', 'found', 'median_px', 'p95_px', 'inliers', 'correspondences', 'frames'),
    *('threshold_px', 'seconds', 'joints', 'parameters', 'versions', 'for_other_tools'),
    *('covariance_over_time', 'centroid_mocap'),
)


@dataclass(frozen=True, slots=True, eq=False)
class StoredResult:
    """What a result file says.

    Attributes:
        world_frame: Parent frame.
        mocap_frame: Child frame.
        world_T_mocap: To the last bit of what was written.
        covariance: (6, 6) of (d_rot [rad], d_t [m]), world frame.
        stamp_ns: When the transform was found, since 1970.
        mpjpe_px: Mean residual over all correspondences, pixels.
        inlier_ratio: Inliers over correspondences.
        sigma_rotation_deg: Standard deviation of the rotation, degrees.
        sigma_position_m: Standard deviation of the body's position, metres.
        camera_mpjpe_px: Mean residual by camera, pixels; NaN where a camera saw nothing.
        warnings: Sentences for people.
        camera_poses: Extrinsics by camera, where they were found.
        optical_frames: Names of their frames, by camera.
        found: Clocks, joints, lenses, persons, and how each camera fitted.

    """

    world_frame: str
    mocap_frame: str
    world_T_mocap: RigidTransform
    covariance: Array
    stamp_ns: int
    mpjpe_px: float
    inlier_ratio: float
    sigma_rotation_deg: float
    sigma_position_m: float
    camera_mpjpe_px: Mapping[str, float]
    warnings: tuple[str, ...]
    camera_poses: Mapping[str, CameraPose] = field(default_factory=dict)
    optical_frames: Mapping[str, str] = field(default_factory=dict)
    found: Found = field(default_factory=Found)

    @property
    def time_offset_s(self) -> Mapping[str, Pair]:
        """(offset, sigma) by camera, where estimated, seconds."""
        return self.found.time_offset_s


def write_result(
    path: Path | str,
    calibration: Calibration,
    *,
    world_frame: str,
    mocap_frame: str,
    stamp_ns: int,
    optical_frames: Mapping[str, str] = NONE,
    levels: Mapping[str, StoredLevel] = NO_LEVELS,
) -> None:
    """Write an accepted calibration; a file that was there becomes a dated backup beside it.

    Args:
        path: Result file. The folder must exist.
        calibration: What was found.
        world_frame: Parent frame.
        mocap_frame: Child frame.
        stamp_ns: When it was found, since 1970.
        optical_frames: By camera, where it is not `<camera>_optical_frame`.
        levels: How each camera fits it, by camera: what a later recording is compared with.

    Raises:
        InputError: NOT_WRITABLE. The old file is untouched.

    """
    text = result_text(
        calibration,
        world_frame=world_frame,
        mocap_frame=mocap_frame,
        stamp_ns=stamp_ns,
        optical_frames=optical_frames,
        levels=levels,
    )
    write_result_text(Path(path), text)


def write_result_text(path: Path, text: str) -> None:
    """Write the text of a result file; arguments, backup and errors as for `write_result`."""
    refuse_link(path)
    back_up(path)
    write_atomic(path, text)


def result_text(
    calibration: Calibration,
    *,
    world_frame: str,
    mocap_frame: str,
    stamp_ns: int,
    optical_frames: Mapping[str, str] = NONE,
    levels: Mapping[str, StoredLevel] = NO_LEVELS,
) -> str:
    """Return a calibration as the text of a result file; arguments as `write_result`."""
    c = calibration
    pose = c.world_T_mocap
    frames = Frames(world_frame, mocap_frame, optical_frames)
    tree = {
        'schema': SCHEMA,
        'convention': CONVENTION,
        'world_frame': world_frame,
        'mocap_frame': mocap_frame,
        'found': utc(stamp_ns),
        'stamp_ns': int(stamp_ns),
        'world_T_mocap': transform_tree(pose),
        'sigma': {'rotation_deg': c.sigma_rotation_deg, 'position_m': c.sigma_position_m},
        'covariance': c.covariance.tolist(),
        'covariance_over_time': c.covariance_over_time.tolist(),
        'centroid_mocap': c.centroid_mocap.tolist(),
        **{
            name: getattr(c, name)
            for name in (
                *('mpjpe_px', 'median_px', 'p95_px', 'inlier_ratio', 'inliers'),
                *('correspondences', 'frames', 'threshold_px', 'seconds'),
            )
        },
        'cameras': {name: _fit(fit) for name, fit in c.per_camera.items()},
        'camera_poses': poses_tree(c.camera_poses, frames),
        'joints': {str(name): _fit(fit) for name, fit in c.per_joint.items()},
        **found_tree(c, levels),
        'warnings': list(c.warnings),
        'parameters': asdict(c.config),
        'versions': {
            'rpgd_ros': __version__,
            'python': platform.python_version(),
            'numpy': np.__version__,
            # The one that the solve has loaded; files are written without it.
            'opencv': getattr(sys.modules.get('cv2'), '__version__', 'not loaded'),
        },
        'for_other_tools': for_other_tools(pose, world_frame, mocap_frame),
    }
    return yaml.safe_dump(
        _plain(tree), sort_keys=False, default_flow_style=None, allow_unicode=True, width=99
    )


def for_other_tools(
    world_T_mocap: RigidTransform, world_frame: str, mocap_frame: str
) -> dict[str, Any]:
    """Return the transform as other programs take it, ready to paste."""
    xyz = world_T_mocap.translation.tolist()
    # Fixed axes X, Y, Z, as URDF and vicon_receiver have it.
    rpy = euler_zyx_from_rotation(world_T_mocap.rotation).tolist()
    numbers = zip(
        ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw'),
        (*xyz, *world_T_mocap.quat_xyzw.tolist()),
        strict=True,
    )
    options = ' '.join(f'--{name} {value!r}' for name, value in numbers)
    frames = f'--frame-id {shlex.quote(world_frame)} --child-frame-id {shlex.quote(mocap_frame)}'
    return {
        'static_transform_publisher': (
            f'ros2 run tf2_ros static_transform_publisher {options} {frames}'
        ),
        'urdf_origin': (
            f'<origin xyz="{" ".join(map(repr, xyz))}" rpy="{" ".join(map(repr, rpy))}"/>'
        ),
        'vicon_receiver': {'map_xyz': xyz, 'map_rpy': rpy, 'map_rpy_in_degrees': False},
    }


def read_result(path: Path | str) -> StoredResult:
    """Read a result file.

    Raises:
        InputError: BAD_RESULT_FILE. The message names file, key, what was found and what is
            needed.

    """
    root = read_yaml(path, Reason.BAD_RESULT_FILE)
    top = root.mapping(
        (
            *('schema', 'world_frame', 'mocap_frame', 'stamp_ns', 'world_T_mocap', 'sigma'),
            *('covariance', 'mpjpe_px', 'inlier_ratio', 'cameras'),
        ),
        ('warnings', 'camera_poses', *FOUND, *FOR_PEOPLE),
    )
    if top['schema'].integer(0, 10**6) != SCHEMA:
        top['schema'].refuse(
            f'schema {top["schema"].value} is unknown, this version reads {SCHEMA}'
        )
    sigma = top['sigma'].mapping(('rotation_deg', 'position_m'))
    warnings = top['warnings'].sequence() if 'warnings' in top else []
    poses, optical = read_poses(top['camera_poses']) if 'camera_poses' in top else ({}, {})
    return StoredResult(
        world_frame=top['world_frame'].text(),
        mocap_frame=top['mocap_frame'].text(),
        world_T_mocap=read_transform(top['world_T_mocap']),
        covariance=read_covariance(top['covariance']),
        stamp_ns=top['stamp_ns'].integer(0, 2**63 - 1),
        mpjpe_px=top['mpjpe_px'].number(0.0),
        inlier_ratio=top['inlier_ratio'].number(0.0, 1.0),
        sigma_rotation_deg=sigma['rotation_deg'].number(0.0),
        sigma_position_m=sigma['position_m'].number(0.0),
        camera_mpjpe_px={name: _mpjpe(node) for name, node in top['cameras'].items()},
        warnings=tuple(node.text() for node in warnings),
        camera_poses=poses,
        optical_frames=optical,
        found=read_found(top),
    )


def _fit(fit: GroupFit) -> dict[str, Any]:
    return {
        'mpjpe_px': fit.mpjpe_px,
        'inlier_mpjpe_px': fit.inlier_mpjpe_px,
        'inliers': fit.inliers,
        'correspondences': fit.correspondences,
        'bias_px': list(fit.bias_px),
    }


def _plain(value: Any) -> Any:
    """Return plain Python values; what is not a number becomes null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _mpjpe(camera: Node) -> float:
    keys = ('mpjpe_px', 'inlier_mpjpe_px', 'inliers', 'correspondences', 'bias_px')
    error = camera.mapping(keys)['mpjpe_px']
    return math.nan if error.value is None else error.number(0.0)
