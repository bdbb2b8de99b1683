# SPDX-License-Identifier: Apache-2.0
"""Calls ~/reset again and again and hears nothing, see `deaf_readers.xml`, until it is ended."""

from __future__ import annotations

from std_srvs.srv import Trigger

from rpgd_ros.ros.player import Peer


def main() -> None:
    """Call every 0.2 s; the service never looks ready to one that it cannot answer."""
    with Peer('deaf') as peer:
        client = peer.node.create_client(Trigger, 'rpgd_calibrator/reset')
        while True:
            client.call_async(Trigger.Request())
            peer.wait_until(lambda: False, seconds=0.2)


if __name__ == '__main__':
    main()
