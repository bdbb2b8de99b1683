# SPDX-License-Identifier: Apache-2.0
"""The `ros2` commands of the pages name what the node, its launch files and the studio have."""

from __future__ import annotations

import ast
import re

import pytest
from pages import ROOT, Command, all_commands
from rclpy.node import Node
from ros_live import Live, live
from ros_scene import make_scene

from rpgd_ros.ros.client import NODE
from rpgd_ros.ros.parameters import Parameter, parameters

FULL_NAME = f'/{NODE}'
COMMANDS = [c for c in all_commands() if c.program == 'ros2']
VERBS = {
    'bag record', 'bag play', 'launch rpgd_ros', 'node info', 'param describe', 'param dump',
    'param load', 'param set', 'run rpgd_ros', 'service call', 'topic echo', 'topic hz',
    'topic list',
}  # fmt: skip


def of_verb(verb: str) -> list[Command]:
    """Return the commands `ros2 <verb> ...`."""
    return [c for c in COMMANDS if ' '.join(c.words[1:3]) == verb]


def arguments(command: Command) -> list[str]:
    """Return what follows the verb, without options and redirections."""
    words = list(command.words[3:])
    return [w for w in words[: words.index('>') if '>' in words else None] if w[0] != '-']


@pytest.fixture(scope='module')
def graph(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    """Return the types of all topics and services, with the publishers of a walk there."""
    scene = make_scene(tmp_path_factory.mktemp('walk'))
    with live(scene.rig) as node:
        node.advertise(scene.topics)
        return {'topic': topics_of(node), 'service': services_of(node)}


def topics_of(node: Live) -> dict[str, str]:
    """Return the type of each topic, once the node's are there."""
    peer: Node = node.peer.node

    def found() -> dict[str, str]:
        return {name: types[0] for name, types in peer.get_topic_names_and_types()}

    node.wait_until('no topics', lambda: {f'{FULL_NAME}/status', '/diagnostics'} <= found().keys())
    return found()


def services_of(node: Live) -> dict[str, str]:
    """Return the type of each service, once the node's are there."""
    peer: Node = node.peer.node

    def found() -> dict[str, str]:
        return {name: types[0] for name, types in peer.get_service_names_and_types()}

    node.wait_until('no services', lambda: f'{FULL_NAME}/calibrate' in found())
    return found()


def test_every_command_is_of_a_kind_that_is_checked() -> None:
    """What is not looked at here would be a command that nobody tried."""
    assert {' '.join(c.words[1:3]) for c in COMMANDS} <= VERBS
    assert len(COMMANDS) > 25


def test_topics_that_are_listened_to_exist(graph: dict[str, dict[str, str]]) -> None:
    """`topic echo`, `topic hz` and `bag record` name topics of the node or of the studio."""
    for verb in ('topic echo', 'topic hz', 'bag record'):
        for command in of_verb(verb):
            words = arguments(command)
            named = [w for w in words if w.startswith('/')]
            assert named, command.words
            assert set(named) <= graph['topic'].keys(), command.words


def test_latched_topics_are_echoed_without_options_of_qos() -> None:
    """With any of them `topic echo` is best effort, and hears nothing published before."""
    for command in of_verb('topic echo'):
        assert not [w for w in command.words if w.startswith('--qos')], command.words


def test_services_that_are_called_exist_with_their_type(graph: dict[str, dict[str, str]]) -> None:
    """Name and type as the node serves them."""
    for command in of_verb('service call'):
        name, kind = arguments(command)[:2]
        assert graph['service'].get(name) == kind, command.words


def test_node_that_is_asked_about_is_the_node() -> None:
    """`node info` and `param ...` name it."""
    for verb in ('node info', 'param describe', 'param dump', 'param load', 'param set'):
        for command in of_verb(verb):
            assert arguments(command)[0] == FULL_NAME, command.words


def test_parameters_exist_and_the_values_are_in_their_range_unless_the_page_shows_a_refusal() -> (
    None
):
    """`param set` sets a live parameter to what it may be."""
    known: dict[str, Parameter] = {p.name: p for p in parameters(['cam0'])}
    refused = 0
    for verb in ('param describe', 'param set'):
        for command in of_verb(verb):
            _, name, *value = arguments(command)
            assert name in known, command.words
            if value:
                assert known[name].setting.is_live, command.words
                refused += known[name].setting.complaint(float(value[0])) is not None
    assert refused == 1  # docs/live.md shows what a value out of range is answered


def test_programs_and_launch_files_exist_with_their_arguments() -> None:
    """`ros2 run` and `ros2 launch` name what is installed."""
    programs = set(re.findall(r"f'(\w+) = \{NAME\}\.apps", (ROOT / 'setup.py').read_text()))
    names = {p.name for p in parameters(['cam0'])}
    for command in of_verb('run rpgd_ros'):
        program, *rest = arguments(command)
        assert program in programs, command.words
        assert {w.partition(':=')[0] for w in rest if ':=' in w} <= names, command.words
    for command in of_verb('launch rpgd_ros'):
        file, *rest = arguments(command)
        assert {w.partition(':=')[0] for w in rest} <= launch_arguments(file), command.words


def launch_arguments(file: str) -> set[str]:
    """Return the arguments that the tables at the top of a launch file declare."""
    found: set[str] = set()
    for node in ast.parse((ROOT / 'rpgd_ros/launch' / file).read_text()).body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Dict):
            found |= {str(ast.literal_eval(key)) for key in node.value.keys if key is not None}
    return found


def test_home_of_results_is_the_one_of_the_pages() -> None:
    """The tutorial names the files of the node as it names itself."""
    text = (ROOT / 'docs/tutorial.md').read_text()
    assert f'~/.ros/rpgd/{NODE}.yaml' in text
    assert f'~/.ros/rpgd/{NODE}.html' in text
