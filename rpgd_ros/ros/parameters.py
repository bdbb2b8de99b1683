# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node by name, made from the dataclasses that hold them. Needs no ROS.

A parameter is called `<stage>.<field>`, those of `NodeSettings` have no prefix, and those of one
camera begin with `camera.<name>.`. Defaults, ranges, units and meanings come from the fields.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rpgd_ros.core.config import Setting, settings_of
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.ros.settings import CameraSettings, NodeConfig

Value = bool | int | float | str | tuple[str, ...]

MAX_SHOWN = 80  # characters of a foreign string in a message
CAMERA_PREFIX = 'camera.'
# Stages of `NodeConfig` and their names outside: all that concerns time is called sync.
STAGES = (
    ('mocap', 'mocap.'),
    ('sync', 'sync.'),
    ('clocks', 'sync.'),
    ('buffer', 'buffer.'),
    ('auto', 'auto.'),
    ('rig', 'rig.'),
    ('ransac', 'ransac.'),
    ('refine', 'refine.'),
    ('accept', 'accept.'),
)
# Of every node: declared by rclpy itself, or by a subscription that lets its QoS be overridden.
FOREIGN_NAMES = ('use_sim_time', 'start_type_description_service')
FOREIGN_PREFIXES = ('qos_overrides.',)
FROM_RIG = ('world_frame', 'mocap_frame')
FROM_RIG_PREFIXES = ('mocap.', CAMERA_PREFIX)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One declared parameter.

    Attributes:
        name: Full name.
        default: Its value where none is given.
        setting: Meaning, unit and range.
        is_from_rig: Whether the rig file gives the default.

    """

    name: str
    default: Value
    setting: Setting
    is_from_rig: bool = False

    def read(self, value: object) -> Value:
        """Check a given value and return it in the type of the default.

        An integer may stand for a float. None stands for an empty list: rcl gives no type to one.

        Raises:
            InputError: Wrong type or outside the range.

        """
        if value is False and 'off' in self.setting.choices:
            value = 'off'  # unquoted it is a boolean to YAML, on the command line and in files
        read = _typed(self.default, value)
        if read is None:
            msg = f'parameter {self.name}: need {_type_name(self.default)}, got {shown(value)}'
            raise InputError(Reason.BAD_PARAMETER, msg)
        complaint = self.setting.complaint(read)
        if complaint:
            msg = f'parameter {self.name}: {complaint}'
            raise InputError(Reason.BAD_PARAMETER, msg)
        return read


def parameters(cameras: Sequence[str], *, defaults: NodeConfig | None = None) -> list[Parameter]:
    """List all parameters of a node with these cameras, in the order of the documentation."""
    config = defaults or NodeConfig()
    found = list(_of_stage('', config.node))
    for slot, prefix in STAGES:
        found += _of_stage(prefix, getattr(config, slot))
    for name in cameras:
        found += _of_stage(f'{CAMERA_PREFIX}{name}.', config.cameras.get(name, CameraSettings()))
    return found


def read_config(
    given: Mapping[str, object], cameras: Sequence[str], *, base: NodeConfig | None = None
) -> NodeConfig:
    """Build the configuration from given values.

    Args:
        given: Values by full parameter name.
        cameras: Cameras that the rig file has.
        base: Values of what is not given; None = the defaults.

    Raises:
        InputError: An unknown name, a wrong type, a value outside its range, an unknown camera.

    """
    config = base or NodeConfig()
    check_names(given, cameras)
    known = {p.name: p for p in parameters(cameras)}
    changes: dict[str, dict[str, Value]] = {}
    for name, value in given.items():
        stage, _, key = name.rpartition('.')
        changes.setdefault(stage, {})[key] = known[name].read(value)
    per_camera = dict(config.cameras)
    for stage, values in changes.items():
        if stage.startswith(CAMERA_PREFIX):
            camera = stage.removeprefix(CAMERA_PREFIX)
            before = per_camera.get(camera, CameraSettings())
            per_camera[camera] = _changed(before, values)
        else:
            for key, value in values.items():
                slot = _slot(config, stage, key)
                config = _changed(config, {slot: _changed(getattr(config, slot), {key: value})})
    config = replace(config, cameras=per_camera)
    check_cameras(config.node.cameras, cameras)
    return config


def check_names(given: Iterable[str], cameras: Sequence[str] | None) -> None:
    """Refuse names that no parameter has.

    Args:
        given: Full parameter names.
        cameras: Cameras that the rig file has; None where they are not known yet, which lets
            every `camera.*` pass.

    Raises:
        InputError: BAD_PARAMETER with the nearest known name, or UNKNOWN_CAMERA.

    """
    known = {p.name for p in parameters(cameras or ())}
    for name in given:
        is_for_later = cameras is None and name.startswith(CAMERA_PREFIX)
        if name not in known and not is_for_later:
            raise _unknown(name, known, cameras or ())


def check_cameras(wanted: Sequence[str], known: Sequence[str]) -> None:
    """Refuse names in parameter `cameras` that the rig file does not have.

    Raises:
        InputError: UNKNOWN_CAMERA, naming those that exist.

    """
    for name in wanted:
        if name not in known:
            msg = f'parameter cameras: the rig file has no {shown(name)}, it has {listed(known)}'
            raise InputError(Reason.UNKNOWN_CAMERA, msg)


def shown(value: object) -> str:
    """Return a foreign value as it may stand in a message or log."""
    text = repr(value)
    return text if len(text) <= MAX_SHOWN else f'{text[: MAX_SHOWN - 3]}...'


def listed(names: Sequence[str]) -> str:
    """Return names as a comma-separated list."""
    return ', '.join(names) or 'none'


def _of_stage(prefix: str, stage: object) -> Iterator[Parameter]:
    for f, s in settings_of(stage):
        name = prefix + f.name
        is_from_rig = name in FROM_RIG or name.startswith(FROM_RIG_PREFIXES)
        yield Parameter(name, getattr(stage, f.name), s, is_from_rig)


def _slot(config: NodeConfig, stage: str, key: str) -> str:
    """Return the attribute of the configuration that holds `<stage>.<key>`."""
    if not stage:
        return 'node'
    slots = (slot for slot, prefix in STAGES if prefix == f'{stage}.')
    return next(s for s in slots if hasattr(getattr(config, s), key))


def _changed(stage: Any, values: Mapping[str, Any]) -> Any:
    return replace(stage, **values)


def _typed(default: Value, value: object) -> Value | None:
    """Return a value in the type of the default, or None where that cannot be."""
    if isinstance(default, bool):
        return value if isinstance(value, bool) else None
    if isinstance(default, float):
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return float(value) if is_number else None  # type: ignore[arg-type]
    if isinstance(default, int):
        return value if isinstance(value, int) and not isinstance(value, bool) else None
    if isinstance(default, str):
        return value if isinstance(value, str) else None
    items = () if value is None else value
    if isinstance(items, list | tuple) and all(isinstance(item, str) for item in items):
        return tuple(item for item in items if item)
    return None


def _type_name(default: Value) -> str:
    names = {bool: 'true or false', float: 'a number', int: 'an integer', str: 'a string'}
    return names.get(type(default), 'a list of strings')


def _unknown(name: str, known: Iterable[str], cameras: Sequence[str]) -> InputError:
    camera = name.removeprefix(CAMERA_PREFIX).partition('.')[0]
    if name.startswith(CAMERA_PREFIX) and camera not in cameras:
        msg = (
            f'parameter {shown(name)}: the rig file has no camera {shown(camera)}, '
            f'it has {listed(cameras)}'
        )
        return InputError(Reason.UNKNOWN_CAMERA, msg)
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    hint = f'did you mean {near[0]}?' if near else 'config/calibrator.yaml lists all of them'
    return InputError(Reason.BAD_PARAMETER, f'unknown parameter {shown(name)}: {hint}')
