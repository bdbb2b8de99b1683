# SPDX-License-Identifier: Apache-2.0
"""A run that ends before all outputs are written says which are."""

from __future__ import annotations

import json
import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import report_cases

from rpgd_ros.apps import calibrate_bag
from rpgd_ros.apps.stopping import EXIT_STOPPED
from rpgd_ros.io.atomic import write_atomic
from rpgd_ros.report import film


@pytest.fixture(scope='module')
def studio(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a walk; return its folder."""
    folder = tmp_path_factory.mktemp('studio')
    report_cases.good(folder)
    return folder


def run(studio: Path, *words: object) -> int:
    """Run the program; return its exit code."""
    all_words = (studio / 'bag', '--rig', studio / 'rig.yaml', *words)
    return calibrate_bag.main([str(word) for word in all_words])


@contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """Let no file become larger, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize('option', [(), ('--json',)])
def test_a_failure_of_a_later_output_does_not_hide_the_earlier_ones(
    studio: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: tuple[str, ...]
) -> None:
    """People and programs are told what there is."""
    result = tmp_path / 'result.yaml'
    words = ('--output', result, '--annotated', tmp_path / 'a.mcap', *option)
    with files_up_to(100_000):
        assert run(studio, *words) == calibrate_bag.EXIT_BAD_INPUT
    assert result.is_file()
    out = capsys.readouterr().out
    if option:
        assert json.loads(out)['files'] == {'output': str(result)}
    else:
        assert f'written to {result}' in out
        assert 'a.mcap' not in out


def test_a_stop_while_outputs_are_written_names_those_that_there_are(
    studio: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also the folder that has a part of its pictures."""

    def interrupted(path: Path, data: bytes) -> None:
        write_atomic(path, data)
        signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr('rpgd_ros.report.film.write_atomic', interrupted)
    result, folder = tmp_path / 'result.yaml', tmp_path / 'pictures'
    assert run(studio, '--output', result, '--overlay', folder) == EXIT_STOPPED
    assert result.is_file()
    assert len(list(folder.iterdir())) == 1
    said = capsys.readouterr().err
    assert f'stopped, written before: {result}; {folder} may hold a part' in said


def test_a_stop_while_the_first_output_is_written_says_that_there_is_none(
    studio: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A film comes whole or not at all."""

    def interrupted(_: film.Painter, __: film.Instant, ___: int = 0) -> None:
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(film.Painter, 'paint', interrupted)
    assert run(studio, '--overlay', tmp_path / 'film.mp4') == EXIT_STOPPED
    assert list(tmp_path.iterdir()) == []
    assert 'stopped, nothing was written' in capsys.readouterr().err
