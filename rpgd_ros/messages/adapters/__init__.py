# SPDX-License-Identifier: Apache-2.0
"""Skeletons and keypoints in the message types of real drivers, detectors and body trackers.

Every reader takes a whole serialised message and gives joints; nothing in the bytes makes it
raise anything but the two errors of a message that is dropped, and no count is believed before
as many bytes were seen.
"""

from rpgd_ros.messages.adapters.decode import NO_HEADER, decode, decode_people
from rpgd_ros.messages.adapters.parts import PartBatch, decode_parts
from rpgd_ros.messages.adapters.types import (
    HEADERLESS_TYPES,
    KEYPOINT_TYPES,
    NORMALISED_TYPES,
    PARTIAL_TYPES,
    POSE_STAMPED,
    SKELETON_TYPES,
)

__all__ = [
    'HEADERLESS_TYPES',
    'KEYPOINT_TYPES',
    'NORMALISED_TYPES',
    'NO_HEADER',
    'PARTIAL_TYPES',
    'POSE_STAMPED',
    'SKELETON_TYPES',
    'PartBatch',
    'decode',
    'decode_parts',
    'decode_people',
]
