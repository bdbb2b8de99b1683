# SPDX-License-Identifier: Apache-2.0
"""Foreign text does nothing on a terminal or a page, and printing in vain is known."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TextIO

import pytest
import report_cases
from hypothesis import given
from hypothesis import strategies as st
from rich.markup import escape

from rpgd_ros.apps import calibrate_bag
from rpgd_ros.apps.bag_run import tell
from rpgd_ros.apps.tables import new_table
from rpgd_ros.apps.terminal import EXIT_CANNOT_PRINT, terminals
from rpgd_ros.io.bag import BagWriter, open_bag
from rpgd_ros.report.plain import plain

EVIL = 'a\x1b[31m\x07\u202e\u2028\x9b1m\udcff\r'
SHOWN = r'a\x1b[31m\x07\u202e\u2028\x9b1m\udcff\r'


@pytest.fixture(scope='module')
def studio(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a walk; return its folder."""
    folder = tmp_path_factory.mktemp('studio')
    report_cases.good(folder)
    return folder


@given(st.text())
def test_what_is_plain_can_be_seen_and_printed(text: str) -> None:
    """But for ends of lines and spaces; and again changes nothing."""
    shown = plain(text)
    assert all(c.isprintable() or c.isspace() for c in shown)
    assert shown.encode().decode() == shown
    assert plain(shown) == shown


@pytest.mark.parametrize('text', ['', 'Käthe', '関節 左肘', 'a\u00a0b', 'one\ntwo\tthree', '+- ±'])
def test_text_of_people_stays_as_it_is(text: str) -> None:
    """In whatever language."""
    assert plain(text) == text


def test_sentences_and_tables_show_what_cannot_be_seen(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """And no pictures for what stands between colons."""
    out, err = terminals()
    table = new_table('name')
    table.add_row(escape(EVIL))
    out.print(table)
    tell(err, f'{EVIL} :smile:')
    captured = capsys.readouterr()
    assert captured.out.splitlines()[1].strip() == SHOWN
    assert captured.err == f'{SHOWN} :smile:\n'


def test_names_in_a_recording_reach_neither_terminal_nor_page(
    studio: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The name of the MoCap frame comes from the messages, that of the bag from anybody."""
    pytest.importorskip('plotly')
    bag, page = tmp_path / 'bag\u202e\udcff', tmp_path / 'report.html'
    with open_bag(studio / 'bag') as source, BagWriter(tmp_path / 'bag') as writer:
        for topic, at, payload in source.stream(source.topics):
            evil = payload.replace(b'mocap\0', b'\x1b[31m\0', 1)
            writer.write(topic, source.topics[topic].msgtype, at, evil)
    (tmp_path / 'bag').rename(bag)
    words = [bag, '--rig', studio / 'rig.yaml', '--report', page, '--output', tmp_path / 'r.yaml']
    assert calibrate_bag.main([str(word) for word in words]) == 0
    captured = capsys.readouterr()
    assert r'world <- \x1b[31m' in captured.out
    text = page.read_text()
    assert r'bag\u202e\udcff' in text
    for shown in (captured.out, captured.err, text):
        assert not {'\x1b', '\u202e'} & set(shown)


def program(
    studio: Path,
    *words: str,
    stdout: int | TextIO = subprocess.PIPE,
    environment: dict[str, str] | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run the program on a walk in a process of its own."""
    line = [sys.executable, '-m', 'rpgd_ros.apps.calibrate_bag', str(studio / 'bag'), *words]
    line += ['--rig', str(studio / 'rig.yaml')]
    return subprocess.run(
        line,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, **(environment or {})},
    )


@pytest.mark.parametrize('option', [(), ('--json',)])
def test_a_pipe_that_nobody_reads_has_an_exit_code_of_its_own(
    studio: Path, tmp_path: Path, option: tuple[str, ...]
) -> None:
    """Which is neither a refusal nor a bug; what is there is said."""
    reader, writer = os.pipe()
    os.close(reader)
    output = tmp_path / 'result.yaml'
    ended = program(studio, '--output', str(output), *option, stdout=writer)
    os.close(writer)
    left = f'written before: {output}' if output.exists() else 'nothing was written'
    said = f'calibrate_bag: cannot print any more: Broken pipe; {left}'
    assert (ended.returncode, ended.stderr.strip()) == (EXIT_CANNOT_PRINT, said)


@pytest.mark.skipif(not Path('/dev/full').exists(), reason='needs a disk that is full')
def test_a_full_disk_has_that_exit_code_too(studio: Path) -> None:
    """As where the output goes to a file."""
    for option in ((), ('--json',)):
        with Path('/dev/full').open('w') as full:
            ended = program(studio, *option, stdout=full)
        assert ended.returncode == EXIT_CANNOT_PRINT
        assert 'No space left on device; nothing was written' in ended.stderr


def test_a_closed_output_is_no_matter(studio: Path) -> None:
    """Who closes it does not want to read."""
    line = f'exec {sys.executable} -m rpgd_ros.apps.calibrate_bag "$0" --rig "$1" >&-'
    paths = [str(studio / 'bag'), str(studio / 'rig.yaml')]
    ended = subprocess.run(['/bin/sh', '-c', line, *paths], timeout=60, check=False)
    assert ended.returncode == 0


def test_a_terminal_that_knows_no_umlauts_gets_escapes(studio: Path, tmp_path: Path) -> None:
    """The result is written, its name is shown as well as it can be."""
    page = tmp_path / 'ä.yaml'
    environment = {'PYTHONIOENCODING': 'ascii'}
    ended = program(studio, '--output', str(page), environment=environment)
    assert ended.returncode == 0
    assert r'\xe4.yaml' in ended.stdout
    assert page.is_file()
    ended = program(studio, '--output', str(page), '--json', environment=environment)
    assert json.loads(ended.stdout)['files'] == {'output': str(page)}
