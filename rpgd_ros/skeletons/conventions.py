# SPDX-License-Identifier: Apache-2.0
"""Named joint conventions, and what is known of joints by their names alone."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from rpgd_ros.skeletons import tables, trackers

NONE = '-'
SIDES = {'left': 'l', 'right': 'r'}

# Words of a limb's joint where each name is that of a joint, and where each is that of a bone,
# whose upper end is meant: BVH files, Human3.6M, Xsens. A shoulder is the joint of the arm in the
# one and the collar bone in the other, so a list is read in one way or the other, never in both.
JOINT_WORDS = {
    'shoulder': ('shoulder', 'shoulderjc', 'sjc'),
    'elbow': ('elbow', 'elbowjc', 'ejc'),
    'wrist': ('wrist', 'wristjc', 'wjc'),
    'hip': ('hip', 'hipjc', 'hjc'),
    'knee': ('knee', 'kneejc', 'kjc'),
    'ankle': ('ankle', 'anklejc', 'ajc'),
    'eye': ('eye',),
    'ear': ('ear',),
    'heel': ('heel',),
    'big_toe': ('bigtoe',),
    'small_toe': ('smalltoe',),
}
BONE_WORDS = {
    'shoulder': ('arm', 'upperarm', 'uparm', 'uarm'),
    'elbow': ('forearm', 'lowerarm', 'farm'),
    'wrist': ('hand',),
    'hip': ('upleg', 'upperleg', 'thigh'),
    'knee': ('leg', 'lowerleg', 'shin'),
    'ankle': ('foot',),
    'toe_base': ('toebase', 'toe'),
}
MIDDLE_WORDS = {'nose': 'nose', 'pelvis': 'pelvis', 'midhip': 'pelvis', 'headtop': 'head_top'}


class _Joint(NamedTuple):
    """One line of a table."""

    name: str
    landmark: str
    neighbours: tuple[str, ...]


def _read(convention: str, table: str) -> tuple[_Joint, ...]:
    joints = []
    for line in table.strip().splitlines():
        name, landmark, *neighbours = line.split()
        if landmark == NONE:
            landmark = f'{name} of {convention}'
        joints.append(_Joint(name, landmark, tuple(n for n in neighbours if n != NONE)))
    return tuple(joints)


_TABLES: Mapping[str, tuple[_Joint, ...]] = {
    name: _read(name, getattr(source, name.upper()))
    for source, names in (
        (
            tables,
            (
                *('coco17', 'body25', 'halpe26', 'h36m17', 'h36m32', 'mpi28', 'kinect20'),
                *('azure32', 'mediapipe33', 'plug_in_gait'),
            ),
        ),
        (trackers, ('openpose18', 'hri18', 'zed34', 'zed38', 'xsens23')),
    )
    for name in names
}

CONVENTIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {convention: tuple(j.name for j in joints) for convention, joints in _TABLES.items()}
)


def _edges_of(joints: Sequence[_Joint]) -> tuple[tuple[int, int], ...]:
    index = {joint.name: j for j, joint in enumerate(joints)}
    return tuple((index[n], j) for j, joint in enumerate(joints) for n in joint.neighbours)


EDGES: Mapping[str, tuple[tuple[int, int], ...]] = MappingProxyType(
    {convention: _edges_of(joints) for convention, joints in _TABLES.items()}
)


def _sided_words(words: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Spell each word with each side before and after it, whole and as a letter."""
    return {
        spelling: f'{side}_{part}'
        for part, forms in words.items()
        for form in forms
        for side, letter in SIDES.items()
        for spelling in (side + form, form + side, letter + form, form + letter)
    }


_JOINTS_BY_WORD = _sided_words(JOINT_WORDS) | MIDDLE_WORDS
_BONES_BY_WORD = _sided_words(BONE_WORDS) | MIDDLE_WORDS | {'hips': 'pelvis'}
_BONES_THAT_TELL = _sided_words({k: BONE_WORDS[k] for k in ('shoulder', 'hip')})


def landmarks(names: Sequence[str]) -> tuple[str | None, ...]:
    """Return the landmark of the body that each joint is, or None where the name does not tell.

    Names that all belong to one published convention are read by it. Others are read one by one:
    `left_hip`, `HIP_LEFT`, `LHip`, `LHipJC` and `LHJC` are the left hip, as is the bone
    `LeftUpLeg`.

    Args:
        names: (J,) joints of one message.

    """
    tuple_of_names = tuple(names)
    meanings: dict[str, set[str]] = defaultdict(set)
    for convention, joints in _TABLES.items():
        if CONVENTIONS[convention] == tuple_of_names:
            return tuple(joint.landmark for joint in joints)
        if set(CONVENTIONS[convention]).issuperset(names):
            for joint in joints:
                meanings[joint.name].add(joint.landmark)
    if meanings:
        # Where conventions that hold all these names differ over one of them, it tells nothing.
        return tuple(next(iter(m)) if len(m := meanings[name]) == 1 else None for name in names)
    words = [''.join(c for c in name.lower() if c.isalnum()) for name in names]
    are_bones = any(word in _BONES_THAT_TELL for word in words)
    known = _BONES_BY_WORD if are_bones else _JOINTS_BY_WORD
    return tuple(known.get(word) for word in words)


def edges(names: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Return the bones to draw, as pairs of indices into the names.

    Lists of names that are no published convention get the bones of COCO's landmarks among them.
    """
    for convention, known in CONVENTIONS.items():
        if known == tuple(names):
            return EDGES[convention]
    index = {mark: j for j, mark in enumerate(landmarks(names)) if mark is not None}
    coco = CONVENTIONS['coco17']
    return tuple(
        (index[coco[a]], index[coco[b]])
        for a, b in EDGES['coco17']
        if coco[a] in index and coco[b] in index
    )


def mirror(names: Sequence[str]) -> tuple[int, ...]:
    """Return the index of each joint's mirror image; its own where it has none."""
    marks = landmarks(names)
    index = {mark: j for j, mark in enumerate(marks) if mark is not None}
    return tuple(
        index.get(_other_side(mark), j) if mark is not None else j for j, mark in enumerate(marks)
    )


def _other_side(landmark: str) -> str:
    side, _, rest = landmark.partition('_')
    other = {'left': 'right', 'right': 'left'}.get(side)
    return f'{other}_{rest}' if other else landmark
