# SPDX-License-Identifier: Apache-2.0
"""Sends an answer again whose client the middleware had not found yet.

A client's call may arrive before the endpoint at which it awaits the answer has been discovered.
The middleware waits 100 ms for that and then drops the answer: one that was ready at once would
never come, and its caller would wait for ever.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TextIO

from rclpy.service import Service

# How rclpy tells of a dropped answer: by a warning, and by nothing else.
DROPPED = 'failed to send response'
# Announcements that were lost come again every 3 s; who was not found after four of them has gone.
KEPT_S = 13.0
# Each trial may take those 100 ms, so they become rare: each wait is twice the one before.
FIRST_WAIT_S = 0.2
REST_S = 0.3  # after a trial in vain, for everything else that the node has to do
MAX_KEPT = 100


@dataclass
class Reply:
    """An answer that has not been sent.

    Attributes:
        service: Full name of the service.
        send: Sends it, or warns.
        since_s: When it was tried first, by the steady clock.
        wait_s: From the last trial to the next.
        due_s: When that is.

    """

    service: str
    send: Callable[[], None]
    since_s: float
    wait_s: float
    due_s: float


class Replies:
    """The answers of a node's services that could not be sent at once.

    Attributes:
        unsent: Those, at most `MAX_KEPT`.

    """

    def __init__(self) -> None:
        """Begin to hear the warnings of this process."""
        self.unsent: list[Reply] = []
        self._given_up: list[str] = []
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
                self._keep(service.service_name, send_one)

        service.send_response = send  # type: ignore[method-assign]
        return service

    def send_due(self) -> list[str]:
        """Try one answer again that is due, if any.

        Returns:
            Full names of the services of which answers were given up since the last time.

        """
        now_s = time.monotonic()
        for reply in [reply for reply in self.unsent if now_s - reply.since_s > KEPT_S]:
            self._give_up(reply)
        due = [reply for reply in self.unsent if reply.due_s <= now_s]
        if due and now_s >= self._rests_until_s:
            # The newest callers first: who was looked for in vain for long has likely gone.
            self._try_again(max(due, key=lambda reply: reply.since_s))
        given_up, self._given_up = self._given_up, []
        return given_up

    def _keep(self, service: str, send: Callable[[], None]) -> None:
        now_s = time.monotonic()
        self.unsent.append(Reply(service, send, now_s, FIRST_WAIT_S, now_s + FIRST_WAIT_S))
        if len(self.unsent) > MAX_KEPT:
            self._give_up(self.unsent[0])

    def _try_again(self, reply: Reply) -> None:
        if self._is_sent(reply.send):
            self.unsent.remove(reply)
            return
        now_s = time.monotonic()
        self._rests_until_s = now_s + REST_S
        reply.wait_s *= 2.0
        reply.due_s = now_s + reply.wait_s

    def _give_up(self, reply: Reply) -> None:
        self.unsent.remove(reply)
        self._given_up.append(reply.service)

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
