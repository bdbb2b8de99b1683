# SPDX-License-Identifier: Apache-2.0
"""Names in files that users copy, against the endpoints that the real node has over DDS."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import pytest
import yaml
from ros_live import live
from ros_scene import make_scene

from rpgd_ros.ros.client import NODE

CONFIG = Path(__file__).resolve().parents[1] / 'config'
# Of tf2_msgs, which the wheels do not have.
NOT_ALWAYS = {'/tf', '/tf_static'}
# Pictures for RViz and Foxglove, and the cameras of a rig without extrinsics.
OVERLAYS = {
    f'/{NODE}/{name}' for name in ('markers', 'skeleton_world', '*/reprojection', '*/pose')
}


class Endpoints(NamedTuple):
    """What a node has, by absolute name."""

    publishes: set[str]
    subscribes: set[str]
    serves: set[str]


@pytest.fixture(scope='module')
def endpoints(tmp_path_factory: pytest.TempPathFactory) -> Endpoints:
    """Start the node with everything open: /clock, CameraInfo, all publishers known."""
    scene = make_scene(tmp_path_factory.mktemp('policy'), seconds=1.0)
    tree = yaml.safe_load(scene.rig.read_text())
    for camera in tree['cameras']:
        camera['camera_info_topic'] = f'{camera["name"]}/camera_info'
        for key in ('size', 'matrix', 'distortion_model', 'distortion'):
            del camera[key]
    scene.rig.write_text(yaml.safe_dump(tree))
    with live(scene.rig, 'use_sim_time:=true', 'tf_mode:=static') as node:
        node.play(scene)
        peer = node.peer.node
        node.wait_until('no services', lambda: len(serves(peer)) >= len(policy('reply')))
        return Endpoints(
            {name for name, _ in peer.get_publisher_names_and_types_by_node(NODE, '/')},
            {name for name, _ in peer.get_subscriber_names_and_types_by_node(NODE, '/')},
            serves(peer),
        )


def serves(peer: object) -> set[str]:
    """Return the services of the calibrator."""
    found = peer.get_service_names_and_types_by_node(NODE, '/')  # type: ignore[attr-defined]
    return {name for name, _ in found}


def policy(rule: str, node: str = NODE) -> set[str]:
    """Return the absolute names, wildcards allowed, for which a node has a rule of the policy."""
    root = ET.parse(CONFIG / 'sros2_policy.xml').getroot()  # noqa: S314 - our own file
    profile = root.find(f".//profile[@node='{node}']")
    assert profile is not None
    names = (entry.text for group in profile for entry in group if group.get(rule) == 'ALLOW')
    return {absolute(name, node) for name in names if name}


def absolute(name: str, node: str) -> str:
    """Resolve a name as SROS2 does."""
    return name.replace('~', f'/{node}', 1) if name[0] == '~' else f'/{name.lstrip("/")}'


def allowed(names: Iterable[str], patterns: Iterable[str]) -> set[str]:
    """Return the names that some pattern covers."""
    patterns = list(patterns)
    return {name for name in names if any(fnmatch(name, pattern) for pattern in patterns)}


@pytest.mark.parametrize(
    ('rule', 'kind'), [('publish', 0), ('subscribe', 1), ('reply', 2)], ids=['pub', 'sub', 'srv']
)
def test_policy_allows_every_endpoint_of_the_node_and_no_other(
    endpoints: Endpoints, rule: str, kind: int
) -> None:
    """Enforced, a missing name keeps the node from starting; a spare one is a hole."""
    names = endpoints[kind]
    assert names
    patterns = policy(rule)
    assert names - allowed(names, patterns) == set()
    unused = {p for p in patterns if not any(fnmatch(name, p) for name in names)}
    assert unused <= NOT_ALWAYS | OVERLAYS


def test_operator_may_call_every_service_and_hear_every_topic_of_the_node(
    endpoints: Endpoints,
) -> None:
    """But publishes nothing that the calibrator listens to."""
    assert allowed(endpoints.serves, policy('request', 'rpgd_operator')) == endpoints.serves
    heard = {name for name in endpoints.publishes if NODE in name or name == '/diagnostics'}
    assert allowed(heard, policy('subscribe', 'rpgd_operator')) == heard
    told = policy('publish', 'rpgd_operator')
    assert not allowed(endpoints.subscribes, told)


def strings(tree: object) -> Iterator[str]:
    """Yield every text in nested lists and mappings, keys too."""
    if isinstance(tree, dict):
        yield from (key for key in tree if isinstance(key, str))
        yield from (text for value in tree.values() for text in strings(value))
    elif isinstance(tree, list):
        yield from (text for value in tree for text in strings(value))
    elif isinstance(tree, str):
        yield tree


def names_in(tree: object) -> set[str]:
    """Return the topics and services of this node in a layout, less the field that is shown."""
    absolute_names = {text for text in strings(tree) if text.startswith(f'/{NODE}/')}
    return {name.split('.')[0] for name in absolute_names}


@pytest.mark.parametrize('file', ['rpgd_ros.rviz', 'foxglove.json'])
def test_layout_shows_what_the_node_has(endpoints: Endpoints, file: str) -> None:
    """A misspelt topic is an empty panel."""
    text = (CONFIG / file).read_text()
    tree = json.loads(text) if file.endswith('.json') else yaml.safe_load(text)
    shown = names_in(tree)
    assert shown
    assert shown <= endpoints.publishes | endpoints.serves | OVERLAYS


def test_foxglove_layout_refers_to_its_own_panels() -> None:
    """A panel that is not laid out would never be seen, one without a configuration is empty."""
    tree = json.loads((CONFIG / 'foxglove.json').read_text())
    assert {t for t in strings(tree['layout']) if '!' in t} == set(tree['configById'])
