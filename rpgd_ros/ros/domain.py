# SPDX-License-Identifier: Apache-2.0
"""Finds a ROS domain of one's own on this machine. Needs no ROS."""

from __future__ import annotations

import itertools
import os
import socket

N_DOMAINS = 100  # those whose ports stay below the ephemeral ones of Linux
FIRST_PORT, PORTS_PER_DOMAIN = 7410, 250  # of a domain's first participant (DDSI-RTPS 9.6.2.3)

_numbers = itertools.count(os.getpid() * 7)


def free_domain() -> int:
    """Return a ROS domain id that no participant of this machine uses, another at each call.

    A node that was killed haunts its domain for up to 20 s: no domain is given twice in a row.

    Raises:
        OSError: All of them are in use.

    """
    for number in itertools.islice(_numbers, N_DOMAINS):
        domain = 1 + number % N_DOMAINS
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(('', FIRST_PORT + PORTS_PER_DOMAIN * domain))
            except OSError:
                continue
        return domain
    msg = 'every ROS domain id of this machine is in use'
    raise OSError(msg)
