# SPDX-License-Identifier: Apache-2.0
"""Streams of joints, stored by their stamps and paired in time.

What is stored is a function of the set of messages, and pairing is a pure function of what is
stored: a live run and its replay from a bag give the same observations, bit for bit.
"""

from rpgd_ros.pairing.config import BufferConfig, SyncConfig
from rpgd_ros.pairing.match import Match, PairCounts, match, pair
from rpgd_ros.pairing.store import Persons, Samples
from rpgd_ros.pairing.stream import JointStream
from rpgd_ros.pairing.tracks import follow

__all__ = [
    'BufferConfig',
    'JointStream',
    'Match',
    'PairCounts',
    'Persons',
    'Samples',
    'SyncConfig',
    'follow',
    'match',
    'pair',
]
