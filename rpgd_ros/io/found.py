# SPDX-License-Identifier: Apache-2.0
"""What was found beside the pose, as a part of the result file. Older files hold less of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final

from rpgd_ros.core.agreement import Disagreement
from rpgd_ros.core.drift import Drift
from rpgd_ros.core.findings import JointOffset
from rpgd_ros.core.persons import Shown
from rpgd_ros.core.result import Calibration
from rpgd_ros.io.strict import Node

Pair = tuple[float, float]  # value and standard deviation

PAIRS: Final = ('time_offset_s', 'clock_rate', 'focal_error')  # by camera
FOUND: Final = (
    *(*PAIRS, 'skeleton_scale', 'joint_offset_m', 'drift', 'disagreements', 'shown', 'levels'),
)
MAX_COUNT: Final = 2**53
# Of a contradiction.
NUMBERS: Final = ('rotation_deg', 'shift_m', 'sigma_deg', 'sigma_m', 'excess')


@dataclass(frozen=True, slots=True)
class StoredLevel:
    """How a camera fitted the accepted pose over the recording that it came from.

    Attributes:
        error_px: Median over time of the running error, pixels.
        spread_px: Robust standard deviation of that.
        shift_px: Running shift (du, dv) of the whole body in the image, pixels.
        shift_spread_px: Robust standard deviation of that.
        bias_px: How far lasting offsets of single joints shift the whole body by chance, pixels.

    """

    error_px: float
    spread_px: float
    shift_px: Pair
    shift_spread_px: float
    bias_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What a result file says beside the pose; empty where it was not estimated or is not told.

    Attributes:
        time_offset_s: (offset, sigma) by camera, seconds.
        clock_rate: (rate, sigma) by camera, seconds per second.
        focal_error: (error, sigma) by camera: share by which the given focal length is too short.
        skeleton_scale: (error, sigma): share by which the skeleton is too small.
        joint_offset_m: Where the detector sees each joint, by joint.
        drift: How fast the transform changes; None where it does not.
        disagreements: Cameras that contradicted the others.
        shown: How much of each video shows the persons with MoCap, by camera.
        levels: How each camera fitted.

    """

    time_offset_s: Mapping[str, Pair] = field(default_factory=dict)
    clock_rate: Mapping[str, Pair] = field(default_factory=dict)
    focal_error: Mapping[str, Pair] = field(default_factory=dict)
    skeleton_scale: Pair | None = None
    joint_offset_m: Mapping[str, JointOffset] = field(default_factory=dict)
    drift: Drift | None = None
    disagreements: tuple[Disagreement, ...] = ()
    shown: Mapping[str, Shown] = field(default_factory=dict)
    levels: Mapping[str, StoredLevel] = field(default_factory=dict)


def found_tree(c: Calibration, levels: Mapping[str, StoredLevel]) -> dict[str, Any]:
    """Return what a result file says beside the pose."""
    scale = c.skeleton_scale
    return {
        **{key: _known(getattr(c, key)) for key in PAIRS},
        'skeleton_scale': None if scale is None or not _is_finite(*scale) else list(scale),
        'joint_offset_m': {
            str(name): {'xyz': list(found.offset_m), 'sigma': list(found.sigma_m)}
            for name, found in c.joint_offset_m.items()
            if _is_finite(*found.offset_m, *found.sigma_m)
        },
        'drift': None if c.drift is None else c.drift._asdict(),
        'disagreements': [asdict(d) for d in c.disagreements],
        'shown': {
            name: {**shown._asdict(), 'share': shown.share} for name, shown in c.shown.items()
        },
        'levels': {name: asdict(level) for name, level in levels.items()},
    }


def read_found(top: Mapping[str, Node]) -> Found:
    """Read what a result file says beside the pose.

    Args:
        top: Its entries by key.

    Raises:
        InputError: The message names file, key, what was found and what is needed.

    """
    scale, drift = top.get('skeleton_scale'), top.get('drift')
    contradictions = top['disagreements'].sequence() if 'disagreements' in top else []
    return Found(
        time_offset_s=_pairs(top, 'time_offset_s'),
        clock_rate=_pairs(top, 'clock_rate'),
        focal_error=_pairs(top, 'focal_error'),
        skeleton_scale=None if scale is None or scale.value is None else _pair(scale),
        joint_offset_m={name: _joint(node) for name, node in _items(top, 'joint_offset_m')},
        drift=None if drift is None or drift.value is None else _drift(drift),
        disagreements=tuple(_disagreement(node) for node in contradictions),
        shown={name: _shown(node) for name, node in _items(top, 'shown')},
        levels={name: _level(node) for name, node in _items(top, 'levels')},
    )


def _known(pairs: Mapping[str, Pair]) -> dict[str, list[float]]:
    """Leave out what no number was found for: it is not known."""
    return {name: list(pair) for name, pair in pairs.items() if _is_finite(*pair)}


def _is_finite(*values: float) -> bool:
    return all(map(math.isfinite, values))


def _items(top: Mapping[str, Node], key: str) -> list[tuple[str, Node]]:
    return list(top[key].items()) if key in top else []


def _pairs(top: Mapping[str, Node], key: str) -> dict[str, Pair]:
    return {name: _pair(node) for name, node in _items(top, key)}


def _pair(node: Node) -> Pair:
    value, sigma = node.numbers(2)
    return value, sigma


def _joint(node: Node) -> JointOffset:
    parts = node.mapping(('xyz', 'sigma'))
    (x, y, z), (a, b, c) = parts['xyz'].numbers(3), parts['sigma'].numbers(3)
    return JointOffset((x, y, z), (a, b, c))


def _drift(node: Node) -> Drift:
    parts = node.mapping(Drift._fields)
    return Drift(*(_number(parts[key]) for key in Drift._fields))


def _disagreement(node: Node) -> Disagreement:
    parts = node.mapping(('camera', *NUMBERS), ('rival', 'since_s'))
    rival, since = parts.get('rival'), parts.get('since_s')
    return Disagreement(
        camera=parts['camera'].text(),
        rival=None if rival is None or rival.value is None else rival.text(),
        since_s=None if since is None or since.value is None else since.number(0.0),
        **{key: _number(parts[key]) for key in NUMBERS},
    )


def _number(node: Node) -> float:
    return math.nan if node.value is None else node.number()


def _shown(node: Node) -> Shown:
    parts = node.mapping(Shown._fields, ('share',))
    return Shown(*(parts[key].integer(0, MAX_COUNT) for key in Shown._fields))


def _level(node: Node) -> StoredLevel:
    keys = ('error_px', 'spread_px', 'shift_spread_px', 'bias_px')
    parts = node.mapping((*keys, 'shift_px'))
    shift = parts['shift_px']
    return StoredLevel(shift_px=_pair(shift), **{key: parts[key].number(0.0) for key in keys})
