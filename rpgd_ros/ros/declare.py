# SPDX-License-Identifier: Apache-2.0
"""Declares the parameters at a node, and takes changes while it runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from rpgd_ros.core.errors import InputError
from rpgd_ros.ros.parameters import (
    FOREIGN_NAMES,
    FOREIGN_PREFIXES,
    Parameter,
    Value,
    parameters,
    read_config,
)
from rpgd_ros.ros.parameters_text import meaning
from rpgd_ros.ros.settings import NodeConfig

INT64_MAX = 2**63 - 1
DOUBLE_MAX = 1.7976931348623157e308


def given_values(node: Node) -> dict[str, object]:
    """Return what the command line and parameter files set for this node, less rclpy's own names.

    An empty list has no type in rcl and comes as None.
    """
    return {
        name: parameter.value
        for name, parameter in _overrides(node).items()
        if name not in FOREIGN_NAMES and not name.startswith(FOREIGN_PREFIXES)
    }


def is_given(node: Node, name: str) -> bool:
    """Say whether the command line or a parameter file set a value."""
    return name in _overrides(node)


def declare(node: Node, config: NodeConfig, cameras: Sequence[str]) -> None:
    """Declare every parameter with the value that the configuration has."""
    for parameter in parameters(cameras, defaults=config):
        value = _to_ros(parameter.default)
        node.declare_parameter(parameter.name, value, descriptor(parameter), ignore_override=True)


def descriptor(parameter: Parameter) -> ParameterDescriptor:
    """Return what `ros2 param describe` shows of one parameter."""
    is_float = isinstance(parameter.default, float)
    found = ParameterDescriptor(
        name=parameter.name,
        description=meaning(parameter),
        read_only=not parameter.setting.is_live,
        # With a static type rclpy refuses 10 where the default is 10.0.
        dynamic_typing=is_float,
    )
    low, high = parameter.setting.low, parameter.setting.high
    if is_float:
        found.floating_point_range = [
            FloatingPointRange(from_value=max(low, -DOUBLE_MAX), to_value=min(high, DOUBLE_MAX))
        ]
    elif isinstance(parameter.default, int) and not isinstance(parameter.default, bool):
        found.integer_range = [
            IntegerRange(from_value=int(max(low, -INT64_MAX)), to_value=int(min(high, INT64_MAX)))
        ]
    return found


class LiveParameters:
    """Checks changes at run time as a whole and hands on the new configuration."""

    def __init__(
        self,
        node: Node,
        config: NodeConfig,
        cameras: Sequence[str],
        *,
        on_change: Callable[[NodeConfig], None],
    ) -> None:
        """Begin to listen.

        Args:
            node: Node whose parameters are declared.
            config: The configuration that it started with.
            cameras: Cameras that the rig file has.
            on_change: Called with each new configuration, in the executor's thread.

        """
        self.config = config
        self._cameras = tuple(cameras)
        self._on_change = on_change
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _check(self, changes: list[RosParameter]) -> SetParametersResult:
        try:
            self._read(changes)
        except InputError as error:
            return SetParametersResult(successful=False, reason=error.message)
        return SetParametersResult(successful=True)

    def _apply(self, changes: list[RosParameter]) -> None:
        config = self._read(changes)
        if config != self.config:
            self.config = config
            self._on_change(config)

    def _read(self, changes: list[RosParameter]) -> NodeConfig:
        given: Mapping[str, object] = {
            change.name: change.value
            for change in changes
            if change.name not in FOREIGN_NAMES and not change.name.startswith(FOREIGN_PREFIXES)
        }
        return read_config(given, self._cameras, base=self.config)


def _overrides(node: Node) -> dict[str, RosParameter]:
    # rclpy keeps these to itself until a parameter of that name is declared: it would never notice
    # the ones that nobody declares, which are the misspelt ones.
    found: dict[str, RosParameter] = cast('Any', node.handle).get_parameters(RosParameter)
    return found


def _to_ros(value: Value) -> bool | int | float | str | list[str]:
    # rclpy takes an empty list for one of bytes: one empty name says "none" and keeps the type.
    return (list(value) or ['']) if isinstance(value, tuple) else value
