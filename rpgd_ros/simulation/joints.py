# SPDX-License-Identifier: Apache-2.0
"""Which landmark of the simulated body stands for each joint of a named convention.

Orders are those of `rpgd_ros.skeletons.CONVENTIONS`; a test keeps the two together. Joints that
coincide in a dataset (Human3.6M repeats neck, wrist and ankle) get places of their own here, so
that every column carries its own noise and none counts twice for nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import IntArray


def _sided(side: str, *names: str) -> tuple[str, ...]:
    return tuple(f'{side}_{name}' for name in names)


def _pairwise(*names: str) -> tuple[str, ...]:
    return tuple(f'{side}_{name}' for name in names for side in ('left', 'right'))


_COCO17 = ('nose', *_pairwise('eye', 'ear', 'shoulder', 'elbow', 'wrist', 'hip', 'knee', 'ankle'))
_LEG32 = ('hip', 'knee', 'ankle', 'toe_base', 'toe_tip')
_ARM32 = (
    *('clavicle', 'shoulder', 'elbow', 'wrist'),
    *('thumb_base', 'thumb_tip', 'hand', 'hand_tip'),
)

LANDMARKS_OF: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        'coco17': _COCO17,
        'mpi28': (
            *('chest', 'thorax', 'spine_upper', 'spine_lower', 'pelvis'),
            *('neck', 'head', 'head_top'),
            *_sided('left', 'clavicle', 'shoulder', 'elbow', 'wrist', 'hand'),
            *_sided('right', 'clavicle', 'shoulder', 'elbow', 'wrist', 'hand'),
            *_sided('left', *_LEG32),
            *_sided('right', *_LEG32),
        ),
        'h36m32': (
            'pelvis',
            *_sided('right', *_LEG32),
            *_sided('left', *_LEG32),
            *('spine_lower', 'spine_upper', 'neck', 'head', 'head_top'),
            *_sided('left', *_ARM32),
            *_sided('right', *_ARM32),
        ),
        'kinect20': (
            *('pelvis', 'spine_middle', 'thorax', 'head_centre'),
            *_sided('left', 'shoulder', 'elbow', 'wrist', 'hand'),
            *_sided('right', 'shoulder', 'elbow', 'wrist', 'hand'),
            *_sided('left', 'hip', 'knee', 'ankle', 'foot'),
            *_sided('right', 'hip', 'knee', 'ankle', 'foot'),
        ),
    }
)


def landmarks_of(convention: str) -> tuple[str, ...]:
    """Return the landmarks of a convention, in its order.

    Raises:
        InputError: Unknown convention.

    """
    if convention not in LANDMARKS_OF:
        msg = f'no body for the convention {convention[:80]!r}; known: {", ".join(LANDMARKS_OF)}'
        raise InputError(Reason.BAD_INPUT, msg)
    return LANDMARKS_OF[convention]


def mirror_of(landmarks: Sequence[str]) -> IntArray:
    """Return the index (J,) of each landmark's mirror image; its own where there is none."""
    index = {name: j for j, name in enumerate(landmarks)}
    swapped = {'left': 'right', 'right': 'left'}
    mirror = []
    for j, name in enumerate(landmarks):
        side, _, rest = name.partition('_')
        mirror.append(index.get(f'{swapped[side]}_{rest}', j) if side in swapped else j)
    return np.array(mirror, dtype=np.int64)
