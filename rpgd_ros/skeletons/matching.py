# SPDX-License-Identifier: Apache-2.0
"""Which joint of the MoCap is which keypoint of a detector."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.skeletons.conventions import CONVENTIONS, landmarks

MAX_JOINTS = 256  # the largest published body, with face and fingers, has 137
MIN_PAIRS = 3  # P3P draws three joints of one frame
MAX_SHOWN = 80  # characters of a foreign string in a message


def hint(found: object, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown name: the nearest known one, or all."""
    names = list(known)
    folded = {name.lower(): name for name in names}
    near = difflib.get_close_matches(str(found).lower(), folded, n=1)
    if near:
        return f'did you mean {folded[near[0]]}?'
    text = ', '.join(names)
    return f'known: {text[:400]}' if names else 'there are none'


def joint_names(convention_or_list: object) -> tuple[str, ...]:
    """Return the joints of a message in their order.

    Args:
        convention_or_list: Name of a published convention, or the joints themselves.

    Raises:
        InputError: BAD_RIG. Unknown convention; an empty list, more than 256 joints, a joint that
            is no text or that comes twice.

    """
    found = convention_or_list
    if isinstance(found, str):
        if found in CONVENTIONS:
            return CONVENTIONS[found]
        msg = f'unknown convention {_shown(found)}, {hint(found, CONVENTIONS)}'
        raise InputError(Reason.BAD_RIG, msg)
    if not isinstance(found, list | tuple) or not 0 < len(found) <= MAX_JOINTS:
        msg = f'need the name of a convention or a list of 1 to {MAX_JOINTS} joint names'
        raise InputError(Reason.BAD_RIG, f'{msg}, got {_shown(found)}')
    for j, name in enumerate(found):
        if not isinstance(name, str) or not name.strip():
            msg = f'joint {j} is {_shown(name)}, need a name (quote names such as no or 12)'
            raise InputError(Reason.BAD_RIG, msg)
        if name in found[:j]:
            msg = f'joint {_shown(name)} comes twice, at {found.index(name)} and {j}'
            raise InputError(Reason.BAD_RIG, msg)
    return tuple(found)


def match_joints(
    mocap_names: Sequence[str],
    keypoint_names: Sequence[str],
    joint_map: Mapping[str, str | None] | None = None,
) -> tuple[tuple[int, int], ...]:
    """Pair the joints of a MoCap with the keypoints of a detector.

    Joints of the same landmark are paired, and joints without a known landmark where both sides
    call them the same. The map goes before: it pairs a keypoint, named as the detector does or by
    its landmark, with a joint of the MoCap, or with none.

    Args:
        mocap_names: Joints of the skeleton, in message order.
        keypoint_names: Keypoints, in message order.
        joint_map: MoCap joint by keypoint; None = leave the keypoint out.

    Returns:
        Pairs (MoCap index, keypoint index), sorted by keypoint.

    Raises:
        InputError: BAD_RIG. An unknown name, one MoCap joint for two keypoints, fewer than three
            pairs.

    """
    mocap_index = {mark: j for j, mark in enumerate(_marks(mocap_names))}
    marks = _marks(keypoint_names)
    mocap_of = {k: mocap_index[mark] for k, mark in enumerate(marks) if mark in mocap_index}
    given = _read_map(mocap_names, keypoint_names, joint_map or {})
    taken = {j for j in given.values() if j is not None}
    pairs = {k: j for k, j in mocap_of.items() if k not in given and j not in taken}
    pairs |= {k: j for k, j in given.items() if j is not None}
    if len(pairs) < MIN_PAIRS:
        raise InputError(Reason.BAD_RIG, _too_few(mocap_names, keypoint_names, pairs))
    return tuple((pairs[k], k) for k in sorted(pairs))


def _marks(names: Sequence[str]) -> list[str]:
    """Return what identifies each joint: its landmark, or else its own name."""
    return [mark or f'named {n}' for mark, n in zip(landmarks(names), names, strict=True)]


def _read_map(
    mocap_names: Sequence[str],
    keypoint_names: Sequence[str],
    joint_map: Mapping[str, str | None],
) -> dict[int, int | None]:
    """Translate a joint map to indices: MoCap joint by keypoint."""
    by_landmark = {m: k for k, m in enumerate(landmarks(keypoint_names)) if m is not None}
    by_name = by_landmark | {name: k for k, name in enumerate(keypoint_names)}
    given: dict[int, int | None] = {}
    for keypoint, joint in joint_map.items():
        if keypoint not in by_name:
            msg = f'no keypoint {_shown(keypoint)}, {hint(keypoint, keypoint_names)}'
            raise InputError(Reason.BAD_RIG, msg)
        if joint is not None and joint not in mocap_names:
            msg = f'no MoCap joint {_shown(joint)}, {hint(joint, mocap_names)}'
            raise InputError(Reason.BAD_RIG, msg)
        index = None if joint is None else list(mocap_names).index(joint)
        k = by_name[keypoint]
        if k in given or (index is not None and index in given.values()):
            msg = f'{_shown(keypoint)}: {_shown(joint)} is a second pair of the same joint'
            raise InputError(Reason.BAD_RIG, msg)
        given[k] = index
    return given


def _too_few(
    mocap_names: Sequence[str], keypoint_names: Sequence[str], pairs: Mapping[int, int]
) -> str:
    found = ', '.join(f'{keypoint_names[k]}: {mocap_names[j]}' for k, j in pairs.items()) or 'none'
    unpaired = [name for j, name in enumerate(mocap_names) if j not in pairs.values()][:40]
    return (
        f'{len(pairs)} joints of the MoCap are known as keypoints ({found}), need {MIN_PAIRS}. '
        f'Give joint_map: {{keypoint: MoCap joint}}, with the MoCap joints {", ".join(unpaired)}'
    )


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= MAX_SHOWN else f'{text[: MAX_SHOWN - 3]}...'
