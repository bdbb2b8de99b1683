# SPDX-License-Identifier: Apache-2.0
"""The parameters as text: the files in config/ and the table of the README."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path

from rpgd_ros.ros.parameters import Parameter, Value, parameters
from rpgd_ros.ros.settings import NodeConfig

EXAMPLE_CAMERA = 'cam0'
WIDTH = 99

CALIBRATOR_TITLE = (
    'Every parameter of the node with its default. Generated from the code, and never read at run '
    'time unless you pass it: ros2 run rpgd_ros calibrator --ros-args --params-file <copy of this '
    'file>. Lines marked (live) may change while the node runs and hold from the next calibration.'
)
PAPER_TITLE = (
    'The settings with which the node runs the published method, step for step: RANSAC-P3P over '
    'triplets of one frame, then gradient descent on the squared error. Generated from the code.'
)

MAX_CHOICES = 6  # that a line of the table can hold


def calibrator_yaml() -> str:
    """Return config/calibrator.yaml."""
    return yaml_text(parameters([EXAMPLE_CAMERA]), CALIBRATOR_TITLE)


def paper_yaml() -> str:
    """Return config/paper.yaml: only what differs from the defaults of the node."""
    defaults = {p.name: p.default for p in parameters([])}
    changed = [
        p for p in parameters([], defaults=NodeConfig.paper()) if p.default != defaults[p.name]
    ]
    return yaml_text(changed, PAPER_TITLE)


def write_config(folder: Path) -> None:
    """Write the files of config/ anew, after a change of the dataclasses."""
    (folder / 'calibrator.yaml').write_text(calibrator_yaml())
    (folder / 'paper.yaml').write_text(paper_yaml())


def yaml_text(listed: Sequence[Parameter], title: str) -> str:
    """Return a ROS parameter file, each value below what it means.

    Args:
        listed: Parameters with the values to write.
        title: Text of the first lines.

    """
    lines = ['# SPDX-License-Identifier: Apache-2.0', *_comment(title, ''), '/**:']
    lines.append('  ros__parameters:')
    open_keys: tuple[str, ...] = ()
    for parameter in listed:
        *parents, key = parameter.name.split('.')
        for depth, parent in enumerate(parents):
            if open_keys[: depth + 1] != tuple(parents[: depth + 1]):
                # A key without values is an error for rcl.
                lines.append(f'{_indent(depth)}{"# " * parameter.is_from_rig}{parent}:')
        open_keys = tuple(parents)
        lines += _comment(meaning(parameter), _indent(len(parents)))
        given = f'{key}: {yaml_value(parameter.default)}'
        if parameter.is_from_rig:
            given = f'# {key}: from the rig file'
        lines.append(f'{_indent(len(parents))}{given}')
    return '\n'.join(lines) + '\n'


def markdown_table() -> str:
    """Return the table of the README: name, default, range and meaning of each parameter."""
    rows = ['| parameter | default | range | meaning |', '| --- | --- | --- | --- |']
    for p in parameters(['<name>']):
        live = ' (live)' if p.setting.is_live else ''
        default = 'rig file' if p.is_from_rig else f'`{yaml_value(p.default)}`'
        cells = (f'`{p.name}`{live}', default, range_text(p), p.setting.help)
        rows.append('| ' + ' | '.join(cell.replace('|', r'\|') for cell in cells) + ' |')
    return '\n'.join(rows) + '\n'


def meaning(parameter: Parameter) -> str:
    """Return what a parameter means, its range and whether it is live, as one sentence."""
    span = range_text(parameter)
    live = ' (live)' if parameter.setting.is_live else ''
    return f'{parameter.setting.help}{f" [{span}]" if span else ""}{live}'


def range_text(parameter: Parameter) -> str:
    """Return the allowed values as text, '' where any will do."""
    s = parameter.setting
    if s.choices:
        if len(s.choices) > MAX_CHOICES:  # of message types, which have a page of their own
            return "'', or a type of docs/inputs.md"
        return ', '.join(choice or "''" for choice in s.choices)
    if math.isinf(s.low) and math.isinf(s.high):
        return s.unit
    return f'{_number(s.low)} to {_number(s.high)} {s.unit}'.rstrip()


def yaml_value(value: Value) -> str:
    """Return a value as YAML."""
    if isinstance(value, bool):
        return 'true' if value else 'false'
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    if isinstance(value, int | float):
        return repr(value)
    return '[' + ', '.join(yaml_value(item) for item in value) + ']'


def _indent(depth: int) -> str:
    return '  ' * (depth + 2)


def _comment(text: str, indent: str) -> Iterator[str]:
    for line in textwrap.wrap(text, WIDTH - len(indent) - 2):
        yield f'{indent}# {line}'


def _number(value: float) -> str:
    return 'any' if math.isinf(value) else f'{value:.10g}'
