# SPDX-License-Identifier: Apache-2.0
"""Names in the layouts of RViz and Foxglove, against what the real node has over DDS."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from ros_live import live
from ros_scene import make_scene

from rpgd_ros.ros.client import NODE

CONFIG = Path(__file__).resolve().parents[1] / 'config'


@pytest.fixture(scope='module')
def endpoints(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Return topics and services that the running node offers, by absolute name."""
    scene = make_scene(tmp_path_factory.mktemp('layouts'), seconds=1.0)
    with live(scene.rig) as node:
        node.play(scene)
        peer = node.peer.node

        def offered() -> set[str]:
            topics = peer.get_publisher_names_and_types_by_node(NODE, '/')
            services = peer.get_service_names_and_types_by_node(NODE, '/')
            return {name for name, _ in (*topics, *services)}

        node.wait_until('no services', lambda: f'/{NODE}/set_enabled' in offered())
        return offered()


def strings(tree: object) -> Iterator[str]:
    """Yield every text in nested lists and mappings, keys too."""
    if isinstance(tree, dict):
        yield from (key for key in tree if isinstance(key, str))
        yield from (text for value in tree.values() for text in strings(value))
    elif isinstance(tree, list):
        yield from (text for value in tree for text in strings(value))
    elif isinstance(tree, str):
        yield tree


@pytest.mark.parametrize('file', ['rpgd_ros.rviz', 'foxglove.json'])
def test_layout_shows_what_the_node_has(endpoints: set[str], file: str) -> None:
    """A misspelt topic is an empty panel."""
    text = (CONFIG / file).read_text()
    tree = json.loads(text) if file.endswith('.json') else yaml.safe_load(text)
    # Less the field of the message that is shown.
    shown = {t.split('.')[0] for t in strings(tree) if t.startswith(f'/{NODE}/')}
    assert len(shown) >= 3
    assert shown <= endpoints


def test_foxglove_layout_refers_to_its_own_panels() -> None:
    """A panel that is not laid out is never seen, one without a configuration is empty."""
    tree = json.loads((CONFIG / 'foxglove.json').read_text())
    assert {t for t in strings(tree['layout']) if '!' in t} == set(tree['configById'])
