# SPDX-License-Identifier: Apache-2.0
"""A flag in place of an exception for SIGINT and SIGTERM. Imports nothing that takes time."""

from __future__ import annotations

import signal
from types import FrameType


class StopFlag:
    """Set by SIGINT and SIGTERM, which do nothing else.

    rclpy's own handler raises KeyboardInterrupt inside whatever callback is running. A flag,
    looked at between two callbacks, ends the node where it is whole.
    """

    def __init__(self) -> None:
        """Take the two signals."""
        self.is_set = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.is_set = True
