# SPDX-License-Identifier: Apache-2.0
"""The life of the node's process: arguments in, spin, a clean end on a signal."""

from __future__ import annotations

import time
from collections.abc import Sequence

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.ros.node import CalibratorNode
from rpgd_ros.ros.results import ReportWriter
from rpgd_ros.ros.signals import StopFlag

STOP_SECONDS = 1.2  # for the running solve to end; the whole end is promised within 2 s
ANSWER_SECONDS = 0.1  # for calls that had arrived, and for answers to leave the process


def run_node(
    arguments: Sequence[str], stop: StopFlag, *, report: ReportWriter | None = None
) -> None:
    """Run the node until a signal ends it.

    Args:
        arguments: Command line with the program's name first.
        stop: Looked at between two callbacks; the timers of the node see to it that there is
            always a next one within 0.1 s.
        report: Writes a page beside the result when asked to save.

    Raises:
        InputError: Arguments, parameters or files that cannot be used.

    """
    _init(arguments)
    try:
        node = CalibratorNode(report=report)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        try:
            while not stop.is_set:
                executor.spin_once()
            _let_it_end(node, executor)
        except ExternalShutdownException:
            node.request_stop()
        finally:
            node.join()
            executor.shutdown()
            Node.destroy_node(node)
    finally:
        rclpy.try_shutdown()


def _let_it_end(node: CalibratorNode, executor: SingleThreadedExecutor) -> None:
    """Ask a running job to end, and stay until its caller and those who wait have heard of it."""
    node.request_stop()
    start = time.monotonic()
    while time.monotonic() < start + (STOP_SECONDS if node.is_busy else ANSWER_SECONDS):
        executor.spin_once(timeout_sec=0.02)


def _init(arguments: Sequence[str]) -> None:
    # rcl would print its own account of a bad argument before ours.
    set_logger_level('rcl', LoggingSeverity.FATAL)
    try:
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, ValueError) as error:
        found = ' '.join(str(error).split())
        msg = f'the ROS arguments cannot be read: {found}'
        raise InputError(Reason.BAD_PARAMETER, msg) from None
    set_logger_level('rcl', LoggingSeverity.INFO)
