# SPDX-License-Identifier: Apache-2.0
"""The node's parameter file for programs that run without ROS, read as strictly as the node does.

A section belongs to the node where its name is `rpgd_calibrator`, in any namespace, or a wildcard
(`/**`); those of other nodes are left to them. The more exact name goes before the wildcard.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from rpgd_ros.core.errors import Reason
from rpgd_ros.io.strict import Node, read_yaml
from rpgd_ros.ros.parameters import FOREIGN_NAMES, FOREIGN_PREFIXES

NODE_NAME: Final = 'rpgd_calibrator'
WILDCARDS: Final = ('*', '**')
PARAMETERS: Final = 'ros__parameters'
SHORT_NUMBER: Final = re.compile(r'[+-]?\d+(\.\d*)?[eE][+-]?\d+', re.ASCII)


def read_parameters(path: Path | str) -> dict[str, object]:
    """Return the parameter values that a file gives to the calibrator, by full name.

    Their names and ranges are checked by `read_config`.

    Raises:
        InputError: BAD_PARAMETER. No parameter file, or nothing in it is for the calibrator.

    """
    root = read_yaml(path, Reason.BAD_PARAMETER)
    sections = list(_sections(root, ''))
    wild = [values for name, values in sections if name in WILDCARDS]
    exact = [values for name, values in sections if name == NODE_NAME]
    if not wild and not exact:
        names = ', '.join(sorted({name for name, _ in sections})) or 'none'
        root.refuse(
            f'need a section /**: or {NODE_NAME}: with {PARAMETERS}: in it, found {names[:80]}'
        )
    found: dict[str, object] = {}
    for values in (*wild, *exact):
        found |= dict(_flat('', values))
    return {
        name: value
        for name, value in found.items()
        if name not in FOREIGN_NAMES and not name.startswith(FOREIGN_PREFIXES)
    }


def _sections(node: Node, name: str) -> Iterator[tuple[str, Node]]:
    """Yield the name of each node, without its namespace, and its parameters."""
    for key, entry in node.items():
        if key == PARAMETERS:
            yield name.rpartition('/')[2], entry
        else:
            yield from _sections(entry, f'{name}/{key}')


def _flat(prefix: str, node: Node) -> Iterator[tuple[str, object]]:
    """Yield the values of a tree by their dotted names."""
    for key, entry in node.items():
        if isinstance(entry.value, Mapping):
            yield from _flat(f'{prefix}{key}.', entry)
        else:
            yield f'{prefix}{key}', _value(entry.value)


def _value(value: object) -> object:
    """Take 1e-3 for a number, as rcl does; YAML 1.1 takes it for a text."""
    is_number = isinstance(value, str) and SHORT_NUMBER.fullmatch(value)
    return float(value) if is_number and isinstance(value, str) else value
