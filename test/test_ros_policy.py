# SPDX-License-Identifier: Apache-2.0
"""The SROS2 policy names what the node does, no less and hardly more."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from fault_report import Measured
from ros_live import live
from ros_scene import Scene

from rpgd_ros.io.rig import read_rig
from rpgd_ros.ros.client import NODE
from rpgd_ros.ros.node import NODE_NAME
from rpgd_ros.ros.policy import NODE_NAME as POLICY_NODE
from rpgd_ros.ros.policy import policy_xml

CONFIG = Path(__file__).parents[1] / 'config'
# Allowed for what is used in some set-ups only: a simulated clock, TF, topics of intrinsics.
SOMETIMES_HEARD = {'/clock', '/parameter_events', '/tf_static'}
SOMETIMES_PUBLISHED = {'/tf_static'}


def names(policy: str, kind: str, right: str) -> set[str]:
    """Return the absolute names that a policy allows."""
    root = ET.fromstring(policy)  # noqa: S314 (our own)
    texts = [e.text or '' for block in root.iter(kind) if block.get(right) for e in block]
    return {
        t.replace('~', f'/{POLICY_NODE}', 1) if t[0] == '~' else '/' + t.lstrip('/') for t in texts
    }


def test_file_in_config_is_that_of_the_code() -> None:
    """Of the example rig, ready to be changed."""
    rig = read_rig(CONFIG / 'rigs' / 'example_rig.yaml')
    assert (CONFIG / 'sros2_policy.xml').read_text() == policy_xml(rig)
    assert POLICY_NODE == NODE_NAME


@pytest.mark.threat('S7')
def test_policy_names_the_endpoints_of_the_node(walk: Scene, measured: Measured) -> None:
    """All that a running node has, asked of the graph."""
    policy = policy_xml(read_rig(walk.rig))
    with live(walk.rig) as node:
        node.play(walk)
        graph = node.peer.node
        heard = {n for n, _ in graph.get_subscriber_names_and_types_by_node(NODE, '/')}
        published = {n for n, _ in graph.get_publisher_names_and_types_by_node(NODE, '/')}
        served = {n for n, _ in graph.get_service_names_and_types_by_node(NODE, '/')}
    may_hear = names(policy, 'topics', 'subscribe')
    assert heard <= may_hear
    assert {n for n in may_hear - heard if 'camera_info' not in n} <= SOMETIMES_HEARD
    assert names(policy, 'topics', 'publish') - SOMETIMES_PUBLISHED == published - {'/tf_static'}
    assert names(policy, 'services', 'reply') == served
    measured('endpoints named', n=len(heard) + len(published) + len(served))
