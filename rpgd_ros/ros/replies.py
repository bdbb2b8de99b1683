# SPDX-License-Identifier: Apache-2.0
"""Sends an answer again whose client the middleware had not found yet.

A client's call may arrive before the endpoint at which it awaits the answer has been discovered.
The middleware waits 100 ms for that and then drops the answer: one that was ready at once would
never come, and its caller would wait for ever.
"""

from __future__ import annotations

import time
import warnings
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TextIO

from rclpy.service import Service

# How rclpy tells of a dropped answer: by a warning, and by nothing else.
DROPPED = 'failed to send response'
# Each trial may take those 100 ms, so they become rare. Announcements that were lost come again
# every 3 s; who was not found after four of them has gone.
AGAIN_S = (0.2, 0.4, 0.8, 1.6, 3.2, 6.4)
REST_S = 0.3  # after a trial in vain, for everything else that the node has to do
MAX_KEPT = 100


@dataclass
class Reply:
    """An answer that has not been sent.

    Attributes:
        service: Full name of the service.
        send: Sends it, or warns.
        due_s: When to try again, by the steady clock.
        n_again: How often it was tried again.

    """

    service: str
    send: Callable[[], None]
    due_s: float
    n_again: int = 0


class Replies:
    """The answers of a node's services that could not be sent at once.

    Attributes:
        unsent: Those, at most `MAX_KEPT`.

    """

    def __init__(self) -> None:
        """Begin to hear the warnings of this process."""
        self.unsent: deque[Reply] = deque(maxlen=MAX_KEPT)
        self._is_dropped = False
        self._rests_until_s = 0.0
        self._show = warnings.showwarning
        warnings.filterwarnings('always', DROPPED, RuntimeWarning)
        warnings.showwarning = self._on_warning

    def keep(self, service: Service) -> Service:
        """Keep what this service cannot answer at once, for `send_due`."""
        send_at_once = service.send_response

        def send(response: Any, header: Any) -> None:
            send_one = partial(send_at_once, response, header)
            if not self._is_sent(send_one):
                due_s = time.monotonic() + AGAIN_S[0]
                self.unsent.append(Reply(service.service_name, send_one, due_s))

        service.send_response = send  # type: ignore[method-assign]
        return service

    def send_due(self) -> str:
        """Try the first answer again that is due.

        Returns:
            Full name of the service whose answer was given up, '' = none was.

        """
        now_s = time.monotonic()
        reply = next((reply for reply in self.unsent if reply.due_s <= now_s), None)
        if reply is None or now_s < self._rests_until_s:
            return ''
        self.unsent.remove(reply)
        if self._is_sent(reply.send):
            return ''
        self._rests_until_s = time.monotonic() + REST_S
        if reply.n_again == len(AGAIN_S) - 1:
            return reply.service
        reply.n_again += 1
        reply.due_s = time.monotonic() + AGAIN_S[reply.n_again]
        self.unsent.append(reply)
        return ''

    def _is_sent(self, send: Callable[[], None]) -> bool:
        self._is_dropped = False
        send()
        return not self._is_dropped

    def _on_warning(
        self, message: Warning | str, category: type[Warning], filename: str, lineno: int,
        file: TextIO | None = None, line: str | None = None,
    ) -> None:  # fmt: skip
        if str(message).startswith(DROPPED):
            self._is_dropped = True
        else:
            self._show(message, category, filename, lineno, file, line)
