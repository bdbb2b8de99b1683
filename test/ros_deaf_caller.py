# SPDX-License-Identifier: Apache-2.0
"""Calls ~/reset again and again and hears nothing, see `deaf_readers.xml`; ends with SIGTERM."""

from __future__ import annotations

import contextlib

import rclpy
from rclpy.executors import ExternalShutdownException
from std_srvs.srv import Trigger


def main() -> None:
    """Call every 0.2 s; the service never looks ready to one that it cannot answer."""
    rclpy.init()
    node = rclpy.create_node('deaf')
    client = node.create_client(Trigger, 'rpgd_calibrator/reset')
    node.create_timer(0.2, lambda: client.call_async(Trigger.Request()))
    with contextlib.suppress(ExternalShutdownException):
        rclpy.spin(node)


if __name__ == '__main__':
    main()
