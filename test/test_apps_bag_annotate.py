# SPDX-License-Identifier: Apache-2.0
"""Odd recordings are annotated as well, or it is said why not."""

from __future__ import annotations

import resource
import sqlite3
from pathlib import Path
from typing import NamedTuple

import pytest
import report_cases
from rosbags.rosbag2 import StoragePlugin, Writer

from rpgd_ros.apps import calibrate_bag
from rpgd_ros.io.bag import BagWriter, open_bag
from rpgd_ros.messages.markers import TRANSFORM_STAMPED


class Walk(NamedTuple):
    """A recording with its rig."""

    bag: Path
    rig: Path


@pytest.fixture(scope='module')
def studio(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """Write a walk."""
    folder = tmp_path_factory.mktemp('studio')
    report_cases.good(folder)
    return Walk(folder / 'bag', folder / 'rig.yaml')


def annotated(walk: Walk, bag: Path, path: Path) -> int:
    """Run the program; return its exit code."""
    return calibrate_bag.main([str(bag), '--rig', str(walk.rig), '--annotated', str(path)])


@pytest.mark.parametrize('later_s', [-1_700_000_000_000, 2**31])
def test_the_clock_of_the_recorder_may_have_been_anywhere(
    studio: Walk, tmp_path: Path, later_s: int
) -> None:
    """The transform has the time of the first skeleton, as its header says."""
    with open_bag(studio.bag) as bag, BagWriter(tmp_path / 'bag') as writer:
        for topic, at, payload in bag.stream(bag.topics):
            receive_ns = max(0, at + later_s * 1_000_000_000)
            writer.write(topic, bag.topics[topic].msgtype, receive_ns, payload)
    path = tmp_path / 'annotated.mcap'
    assert annotated(studio, tmp_path / 'bag', path) == 0
    topic = '/rpgd_calibrator/transform'
    with open_bag(path) as found:
        assert found.topics[topic].msgtype == TRANSFORM_STAMPED
        assert len(list(found.stream([topic]))) == 1


def test_a_recorder_may_have_lived_before_1970(studio: Walk, tmp_path: Path) -> None:
    """Its storage has signed times, that of the copy has not."""
    with open_bag(studio.bag) as bag, BagWriter(tmp_path / 'bag', storage='sqlite3') as writer:
        for topic, at, payload in bag.stream(bag.topics):
            writer.write(topic, bag.topics[topic].msgtype, at, payload)
    (file,) = (tmp_path / 'bag').glob('*.db3')
    with sqlite3.connect(file) as database:
        database.execute('update messages set timestamp = -5 where id < 10')
    database.close()
    assert annotated(studio, file, tmp_path / 'annotated.mcap') == 0


@pytest.mark.parametrize(
    ('msgtype', 'text'), [('a/msg/A', 'a/msg/A x'), ('1/msg/2', 'int32 x'), ('a/msg/B', 'int3 x')]
)
def test_a_topic_whose_type_cannot_be_is_left_out_with_a_word(
    studio: Walk, tmp_path: Path, capsys: pytest.CaptureFixture[str], msgtype: str, text: str
) -> None:
    """One that holds itself, one that is no name, one of nothing."""
    with (
        open_bag(studio.bag) as bag,
        Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        definitions = bag.definitions()
        connections = {
            topic: writer.add_connection(
                topic, info.msgtype, msgdef=definitions[topic], rihs01='RIHS01_0'
            )
            for topic, info in bag.topics.items()
        }
        odd = writer.add_connection('/odd', msgtype, msgdef=text, rihs01='RIHS01_0')
        for n, (topic, at, payload) in enumerate(bag.stream(bag.topics)):
            if not n:
                writer.write(odd, at, b'\x00\x01\x00\x00')
            writer.write(connections[topic], at, payload)
    assert annotated(studio, tmp_path / 'bag', tmp_path / 'annotated.mcap') == 0
    said = capsys.readouterr().err
    assert f"not copied: topic '/odd' has type '{msgtype}', whose definition is not known" in said
    with open_bag(tmp_path / 'annotated.mcap') as found:
        assert '/odd' not in found.topics
        assert '/mocap/skeleton' in found.topics


def test_a_full_disk_is_said_of_the_place_that_was_asked_for(
    studio: Walk, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not of a folder that is gone when somebody reads of it."""
    path = tmp_path / 'annotated.mcap'
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        assert annotated(studio, studio.bag, path) == calibrate_bag.EXIT_BAD_INPUT
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert f'{path} cannot be written: File too large' in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
