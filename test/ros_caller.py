# SPDX-License-Identifier: Apache-2.0
"""Calls a Trigger service from a process of its own until it succeeds, and prints the answers."""

from __future__ import annotations

import sys

from rpgd_ros.ros.player import Peer


def main() -> int:
    """Call at most a hundred times."""
    with Peer('caller') as peer:
        for _ in range(100):
            answer = peer.call(sys.argv[1], seconds=10.0)
            if answer is None:
                return 1
            sys.stdout.write(f'{answer.message}\ncalled\n')
            if answer.success:
                return 0
    return 1


if __name__ == '__main__':
    sys.exit(main())
