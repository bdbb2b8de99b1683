# SPDX-License-Identifier: Apache-2.0
"""What `calibrate_bag` is told: rig file, the node's parameter file, cameras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rpgd_ros.apps.bag_run import chosen
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.io.rig import Rig, read_rig
from rpgd_ros.ros.parameters import check_names, read_config
from rpgd_ros.ros.parameters_file import read_parameters
from rpgd_ros.ros.setup import config_of, overridden
from rpgd_ros.session import SessionConfig


def rig_file_of(rig_file: Path | None, params: Path | None) -> Path:
    """Return the rig file that is to be read.

    Args:
        rig_file: Goes before `rig_file` of the parameters.
        params: Parameter file of the node; None = there is none.

    Raises:
        InputError: Nobody names one, or the parameter file cannot be used.

    """
    if rig_file is not None:
        return rig_file
    named = read_parameters(params).get('rig_file') if params is not None else None
    if isinstance(named, str) and named:
        return Path(named).expanduser()
    msg = 'no rig file: give --rig RIG.yaml, or rig_file in the parameter file'
    raise InputError(Reason.BAD_PARAMETER, msg)


def read_setup(
    rig_file: Path, params: Path | None, cameras: Sequence[str]
) -> tuple[Rig, SessionConfig]:
    """Read the rig and the settings, as the node does.

    Args:
        rig_file: The rig.
        params: Parameter file of the node; None = the defaults.
        cameras: Go before `cameras` of the parameters; empty = those.

    Returns:
        The rig with the cameras that are to be used, and the settings of the session.

    Raises:
        InputError: A file that cannot be used, an unknown parameter or camera.

    """
    given = {} if params is None else read_parameters(params)
    check_names(given, cameras=None)
    rig = read_rig(rig_file)
    if params is None:
        return chosen(rig, cameras), SessionConfig()
    if cameras:
        chosen(rig, cameras)  # refuses names that the rig file does not have
        given['cameras'] = list(cameras)
    config = read_config(given, [camera.name for camera in rig.cameras], base=config_of(rig))
    return overridden(rig, config), config.session()
