# SPDX-License-Identifier: Apache-2.0
"""Reads the parameter files named on standard input as the node does, each in a fresh process.

Prints for each how that ended: 0, 2 where it was refused in our words, -14 where it hung, another
number where it crashed.
"""

from __future__ import annotations

import os
import signal
import sys

import rclpy
from rclpy.node import Node

from rpgd_ros.core.errors import InputError
from rpgd_ros.ros.declare import given_values
from rpgd_ros.ros.process import _init
from rpgd_ros.ros.setup import read_setup

HUNG_S = 20


def read(path: str) -> int:
    """Read one file; return 0, or 2 where it is refused in our words."""
    try:
        _init(['calibrator', '--ros-args', '--params-file', path])
        read_setup(given_values(Node('rpgd_calibrator')))
    except InputError:
        return 2
    finally:
        rclpy.try_shutdown()
    return 0


def main() -> None:
    """Fork for each file: this process itself never starts the threads of DDS."""
    for line in sys.stdin:
        child = os.fork()
        if not child:
            signal.alarm(HUNG_S)
            code = 1
            try:
                code = read(line.rstrip('\n'))
            finally:
                os._exit(code)
        _, status = os.waitpid(child, 0)
        sys.stdout.write(f'{os.waitstatus_to_exitcode(status)}\n')
        sys.stdout.flush()


if __name__ == '__main__':
    main()
