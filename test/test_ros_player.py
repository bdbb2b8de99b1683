# SPDX-License-Identifier: Apache-2.0
"""The peer of the node: what it does of a call that is not answered in time."""

from __future__ import annotations

import pytest

pytest.importorskip('rclpy')

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from ros_live import WAIT_S
from std_srvs.srv import Trigger

from rpgd_ros.ros.domain import free_domain
from rpgd_ros.ros.player import Peer


def test_call_without_an_answer_is_forgotten_and_a_late_answer_harms_nobody() -> None:
    """Nothing is kept for it, and the next call gets its own answer."""
    with Peer('peer', domain_id=free_domain()) as peer:
        waiting: list[Future] = []

        async def serve(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            if not waiting:
                waiting.append(Future(executor=peer.node.executor))
                await waiting[0]
                response.message = 'late'
            return response

        group = ReentrantCallbackGroup()
        peer.node.create_service(Trigger, 'slow', serve, callback_group=group)
        ready = peer.node.create_client(Trigger, 'slow')
        assert peer.wait_until(ready.service_is_ready, seconds=WAIT_S)
        assert peer.call('slow', seconds=0.5) is None
        assert len(waiting) == 1
        client = peer._clients['slow']  # noqa: SLF001
        assert not client._pending_requests  # noqa: SLF001
        waiting[0].set_result(None)
        answer = peer.call('slow', seconds=WAIT_S)
        assert answer is not None
        assert answer.message == ''
