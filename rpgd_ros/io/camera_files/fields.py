# SPDX-License-Identifier: Apache-2.0
"""Checked access to the fields of foreign calibration files.

Other tools add keys as they please, so unknown keys are passed over here, unlike in our own files.
What is needed is checked as strictly, and each complaint names file and key.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import Array, RigidTransform, nearest_rotation
from rpgd_ros.core.lens import Model
from rpgd_ros.io.strict import Node, shown

MAX_SIZE: Final = 100_000  # pixels; the largest sensors have 15 000
MAX_COEFFICIENTS: Final = 14  # OpenCV's longest lens model
LARGEST: Final = 1e9  # squares of damaged numbers overflow
ROUNDING: Final = 1e-3  # of R R^T, where a file gives four decimals
# YAML 1.1 takes 1e-05, as Python prints it, for a text.
NUMBER: Final = re.compile(r'[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?')

Entries = Mapping[str, Node]


def camera_name(text: str) -> str:
    """Return a name for topics: letters, digits and _, `cam_` before one that begins otherwise."""
    name = re.sub('[^A-Za-z0-9_]', '_', text.strip())
    return name if re.match('[A-Za-z]', name) else f'cam_{name}'


def entries_of(node: Node) -> Entries:
    """Return the entries of a mapping, known or not."""
    return dict(node.items())


def need(node: Node, *names: str) -> Node:
    """Return the entry of a mapping that has one of several names.

    Raises:
        InputError: There is none; the message gives the first name.

    """
    entries = entries_of(node)
    found = next((name for name in names if name in entries), None)
    if found is None:
        node.refuse(f'{names[0]} is missing; it has {", ".join(map(shown, list(entries)[:20]))}')
    return entries[found]


def number(node: Node) -> float:
    """Return a number of at most 1e9, also one that YAML 1.1 took for a text."""
    if isinstance(node.value, str) and NUMBER.fullmatch(node.value.strip()):
        node = Node(float(node.value), node.source, node.reason, node.path)
    value = node.number()
    if abs(value) > LARGEST:
        node.refuse(f'{value:g} is no number of a camera, need at most {LARGEST:g}')
    return value


def numbers(node: Node, *lengths: int) -> list[float]:
    """Return a list of finite numbers of one of the given lengths; nested lists are unrolled."""
    values = list(_unrolled(node))
    if lengths and len(values) not in lengths:
        node.refuse(f'need {" or ".join(map(str, lengths))} numbers, got {len(values)}')
    return values


def _unrolled(node: Node) -> list[float]:
    if not isinstance(node.value, list):
        return [number(node)]
    return [value for child in node.sequence() for value in _unrolled(child)]


def matrix(node: Node, shape: tuple[int, int]) -> Array:
    """Return a matrix of a given shape: nested lists, or `rows`, `cols` and `data`."""
    data = node
    found: tuple[int, int] | None = None
    if isinstance(node.value, dict):
        found = (
            need(node, 'rows').integer(0, 10**6),
            need(node, 'cols').integer(0, 10**6),
        )
        data = need(node, 'data')
    values = numbers(data)
    if found not in {None, shape} or len(values) != shape[0] * shape[1]:
        size = f'{found[0]} x {found[1]}, ' if found else ''
        wanted = f'{shape[0]} x {shape[1]}'
        node.refuse(f'need a matrix of {wanted} numbers, got {size}{len(values)} numbers')
    return np.array(values).reshape(shape)


def coefficients(node: Node) -> Array:
    """Return lens coefficients: a list, or a matrix of one row or column."""
    data = need(node, 'data') if isinstance(node.value, dict) else node
    values = numbers(data)
    if len(values) > MAX_COEFFICIENTS:
        node.refuse(f'need at most {MAX_COEFFICIENTS} coefficients, got {len(values)}')
    while len(values) > 8 and values[-1] == 0.0:  # the thin prism, unused
        values.pop()
    return np.array(values)


def whole(node: Node) -> int:
    """Return a number of pixels, which some tools write as 1920.0."""
    value = number(node)
    if value != round(value) or not 0 < value <= MAX_SIZE:
        node.refuse(f'need a whole number from 1 to {MAX_SIZE}, got {value:g}')
    return int(value)


def size_of(node: Node) -> tuple[int, int]:
    """Return [width, height]."""
    nodes = node.sequence()
    if len(nodes) != 2:
        node.refuse(f'need [width, height], got {len(nodes)} values')
    return whole(nodes[0]), whole(nodes[1])


def rigid(node: Node, rotation: Array, translation: Sequence[float] | Array) -> RigidTransform:
    """Return a rigid transform from a rotation that was rounded when it was written.

    Raises:
        InputError: It is no rotation.

    """
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if not error <= ROUNDING:
        node.refuse(f'no rotation: R R^T differs from the identity by {error:.2g}')
    if np.linalg.det(rotation) < 0.0:
        node.refuse('the rotation is a mirror image: are the axes left-handed?')
    return RigidTransform(nearest_rotation(rotation), np.asarray(translation, dtype=np.float64))


def build_camera(
    node: Node,
    name: str,
    intrinsics: Array,
    distortion: Array,
    size: tuple[int, int],
    pose: RigidTransform | None = None,
    *,
    model: Model = 'pinhole',
) -> Camera:
    """Return a camera; what it refuses is refused with the place in the file."""
    try:
        return Camera(camera_name(name), intrinsics, distortion, size, pose, model=model)
    except ValueError as error:
        node.refuse(str(error))
