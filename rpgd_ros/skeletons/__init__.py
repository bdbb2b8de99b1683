# SPDX-License-Identifier: Apache-2.0
"""Joint conventions: published orders, landmarks, bones, mirror images, and pairs between them."""

from rpgd_ros.skeletons.conventions import CONVENTIONS, EDGES, edges, landmarks, mirror
from rpgd_ros.skeletons.matching import MAX_JOINTS, MIN_PAIRS, hint, joint_names, match_joints

__all__ = [
    'CONVENTIONS',
    'EDGES',
    'MAX_JOINTS',
    'MIN_PAIRS',
    'edges',
    'hint',
    'joint_names',
    'landmarks',
    'match_joints',
    'mirror',
]
