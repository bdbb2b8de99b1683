# SPDX-License-Identifier: Apache-2.0
"""Camera calibrations as other tools write them, and as they read them."""

from rpgd_ros.io.camera_files.fields import camera_name
from rpgd_ros.io.camera_files.reading import (
    FORMATS,
    TOML,
    CameraFile,
    parse_cameras,
    read_cameras,
)
from rpgd_ros.io.camera_files.toml_writer import toml_text

__all__ = [
    'FORMATS',
    'TOML',
    'CameraFile',
    'camera_name',
    'parse_cameras',
    'read_cameras',
    'toml_text',
]
