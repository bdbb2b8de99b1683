# SPDX-License-Identifier: Apache-2.0
"""Which landmark of the simulated body stands for each joint of a published convention."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from rpgd_ros.simulation.body import LANDMARKS, SIDES
from rpgd_ros.skeletons import joint_names, landmarks

# Points that only one convention names. Some coincide in their dataset (Human3.6M repeats hips,
# neck and wrists): here each has a place of its own, so that no column counts twice for nothing.
_PLACES = {
    'Spine of h36m32': 'spine_lower',
    'spine_h36m': 'spine_upper',
    'spine of mpi28': 'spine_lower',
    'spine2 of mpi28': 'spine_middle',
    'spine3 of mpi28': 'spine_upper',
    'spine4 of mpi28': 'thorax',
    'head of mpi28': 'head',
    'HIP_CENTER of kinect20': 'spine_lower',
    'SPINE of kinect20': 'spine_middle',
    'HEAD of kinect20': 'head_centre',
    'SPINE_NAVEL of azure32': 'spine_middle',
    'SPINE_CHEST of azure32': 'chest',
    'HEAD of azure32': 'head',
    'NECK of hri18': 'thorax',
    'NAVAL_SPINE of zed34': 'spine_middle',
    'CHEST_SPINE of zed34': 'chest',
    'HEAD of zed34': 'head',
    'SPINE_1 of zed38': 'spine_lower',
    'SPINE_2 of zed38': 'spine_middle',
    'SPINE_3 of zed38': 'spine_upper',
    'l5 of xsens23': 'spine_lower',
    'l3 of xsens23': 'spine_middle',
    't12 of xsens23': 'spine_upper',
    't8 of xsens23': 'chest',
    'neck of xsens23': 'neck',
    'head of xsens23': 'head',
    'left_shoulder of xsens23': 'left_clavicle',
    'right_shoulder of xsens23': 'right_clavicle',
}
_SIDED_PLACES = {
    'neck': 'clavicle',
    'wrist_end': 'hand',
    'hand_end': 'hand_tip',
    'thumb_knuckle': 'thumb',
    'hand_zed': 'hand',
    'handtip_zed': 'hand_tip',
    'thumb_zed': 'thumb',
    'foot_zed': 'foot',
    'hand_thumb_4_zed': 'thumb_tip',
    'hand_index_1_zed': 'index',
    'hand_middle_4_zed': 'hand_tip',
    'hand_pinky_1_zed': 'pinky',
}
PLACES: Mapping[str, str] = MappingProxyType(
    _PLACES | {f'{s}_{a}': f'{s}_{b}' for s in SIDES for a, b in _SIDED_PLACES.items()}
)


def landmarks_of(convention: str) -> tuple[str, ...]:
    """Return the body's landmarks for the joints of a convention, in its order.

    Raises:
        InputError: Unknown convention.

    """
    marks = landmarks(joint_names(convention))
    return tuple(mark if mark in LANDMARKS else PLACES[mark] for mark in marks if mark is not None)
