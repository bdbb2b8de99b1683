# SPDX-License-Identifier: Apache-2.0
"""The evaluate program: its table, its rows, going on after a stop, and what it refuses."""

from __future__ import annotations

import csv
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from dataset_trees import plan

from rpgd_ros.apps import evaluate, evaluate_sequence
from rpgd_ros.apps.evaluate_pool import each_somewhere
from rpgd_ros.datasets import open_dataset
from rpgd_ros.simulation.dataset_writers import write_twin

TIMES = ('read_ms', 'ransac_ms', 'rpgd_ms', 'default_ms')


class Done:
    """A finished evaluation, made once: folders, output, rows."""

    def __init__(self, folder: Path) -> None:
        """Evaluate a small twin of AIST++ with one process."""
        self.tree, self.results, self.csv = (folder / n for n in ('tree', 'results', 'rows.csv'))
        self.tree.mkdir()
        write_twin(plan('aistpp', sequences=2, seconds=1.0), self.tree)
        self.code = evaluate.main([*self.line(), '--csv', str(self.csv), '--jobs', '1'])

    def line(self) -> list[str]:
        """Return the arguments that name the folders."""
        return [str(self.tree), '--dataset', 'aistpp', '--results', str(self.results)]

    @property
    def rows(self) -> list[dict[str, str]]:
        """Return the lines of the CSV file."""
        return read_csv(self.csv)


def read_csv(path: Path) -> list[dict[str, str]]:
    """Return the lines of a CSV file by column."""
    with path.open(newline='') as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope='module')
def done(tmp_path_factory: pytest.TempPathFactory) -> Done:
    """Evaluate once."""
    return Done(tmp_path_factory.mktemp('evaluate'))


@pytest.fixture
def copied(done: Done, tmp_path: Path) -> list[str]:
    """Return arguments for a copy of tree and results that a test may change."""
    shutil.copytree(done.tree, tmp_path / 'tree')  # keeps the times of the files
    shutil.copytree(done.results, tmp_path / 'results')
    results = str(tmp_path / 'results')
    return [str(tmp_path / 'tree'), '--dataset', 'aistpp', '--results', results, '--jobs', '1']


def never(*_arguments: object) -> Any:
    """Stand for work that must not be done."""
    pytest.fail('a finished sequence was done again')


def test_rows_hold_truth_methods_and_distances(done: Done) -> None:
    """The default solver is at the optimum, the published method near it, RANSAC alone farther."""
    assert done.code == 0
    assert len(done.rows) == 2
    for row in done.rows:
        gt = float(row['gt_px'])
        assert gt == pytest.approx(8.2837, abs=0.01)
        assert float(row['default_px']) < 1.0005 * gt
        assert float(row['rpgd_px']) < 1.1 * gt
        assert float(row['ransac_px']) > float(row['default_px'])
        assert float(row['default_mm']) < 3.0 * float(row['default_sigma_mm']) < 10.0
        assert float(row['default_deg']) < float(row['rpgd_deg']) + 0.1
        assert (row['cameras'], row['frames'], row['joints']) == ('9', '60', '17')
        assert min(float(row[name]) for name in TIMES) > 0.0


def test_table_has_the_published_figures_beside_ours(
    done: Done, copied: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """One line per method and per sequence; kept results print the same table."""
    assert evaluate.main(copied) == 0
    out = capsys.readouterr().out
    assert 'aistpp: 2 sequences, 120 frames' in out
    for method, figures in (
        ('GT', ['8.2837', '8.2837']),
        ('RANSAC-P3P', ['11.9826', '1.447']),
        ('RPGD', ['8.3916', '1.013', '2.3']),
        ('default', []),
    ):
        (line,) = [x for x in out.splitlines() if x.startswith(f'| {method} ')]
        assert all(f'| {figure} ' in line for figure in figures)
    assert all(row['sequence'] in out for row in done.rows)
    assert 'no lower bound' in out


def test_json_holds_the_rows_of_the_csv(
    copied: list[str], done: Done, capsys: pytest.CaptureFixture[str]
) -> None:
    """And is all that is printed."""
    capsys.readouterr()
    assert evaluate.main([*copied, '--json']) == 0
    tree = json.loads(capsys.readouterr().out)
    assert (tree['schema'], len(tree['rows'])) == (1, len(done.rows))
    for told, row in zip(tree['rows'], done.rows, strict=True):
        assert list(told) == list(row)
        assert told['sequence'] == row['sequence']
        assert told['default_px'] == pytest.approx(float(row['default_px']))


def test_finished_sequences_are_not_done_again(
    copied: list[str], done: Done, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Results come from their files, to the last digit."""
    monkeypatch.setattr(evaluate, 'evaluate', never)
    assert evaluate.main([*copied, '--csv', str(tmp_path / 'again.csv')]) == 0
    assert read_csv(tmp_path / 'again.csv') == done.rows


@pytest.mark.parametrize('what', ['data', 'result', 'other result', 'version', 'selection'])
def test_changed_data_and_damaged_results_are_done_again(
    what: str, copied: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A result counts as long as all that it was made from is the same."""
    again = []

    def note(task: evaluate_sequence.Task) -> evaluate_sequence.Row:
        again.append(task.name)
        return evaluate_sequence.empty_row(task.name) | {'left_out': 'noted'}

    monkeypatch.setattr(evaluate, 'evaluate', note)
    first = min((tmp_path / 'results').iterdir())
    if what == 'data':
        os.utime(tmp_path / 'tree/keypoints2d' / f'{first.stem}.pkl', ns=(0, 0))
    elif what == 'result':
        first.write_text(first.read_text()[:100])
    elif what == 'other result':
        kept = json.loads(first.read_text())
        first.write_text(json.dumps(kept | {'row': {'sequence': 'x'}}))
    elif what == 'version':
        monkeypatch.setattr(evaluate_sequence, '__version__', '99')
    else:
        copied = [*copied, '--select', 'published']
    assert evaluate.main(copied) == 0
    assert len(again) == (2 if what in {'version', 'selection'} else 1)
    assert first.stem in again


WRONG = [
    {'default_px': None}, {'default_px': 'x'}, {'rpgd_ms': []}, {'frames': [1]}, {'frames': 1.5},
    {'frames': True}, {'joints': 10**400}, {'gt_px': 10**400}, {'sequence': None},
    {'sequence': 'another'}, {'error': 1}, {'left_out': '\ud800'},
]  # fmt: skip


@pytest.mark.parametrize('wrong', WRONG, ids=lambda wrong: f'{wrong}'[:30])
def test_kept_result_with_values_of_other_kinds_is_done_again(
    wrong: dict[str, Any], copied: list[str], tmp_path: Path
) -> None:
    """Somebody's editor, or a damaged disk: neither ends in a traceback."""
    first = min((tmp_path / 'results').iterdir())
    kept = json.loads(first.read_text())
    folder, results = Path(copied[0]).absolute(), tmp_path / 'results'
    task = evaluate_sequence.Task('aistpp', folder, kept['row']['sequence'], False, results)  # noqa: FBT003
    dataset = open_dataset('aistpp', folder)
    assert evaluate_sequence.finished(task, dataset) is not None
    first.write_text(json.dumps(kept | {'row': kept['row'] | wrong}))
    assert evaluate_sequence.finished(task, dataset) is None


def test_names_too_long_for_the_system_are_named(
    copied: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a setting, of the dataset, of the place for results: bad input each, and no traceback."""
    long = 'x' * 300
    (tmp_path / 'tree/cameras/mapping.txt').write_text(
        ''.join(f'{p.stem} {long}\n' for p in (tmp_path / 'tree/keypoints2d').iterdir())
    )
    for line in (
        copied,
        [long, *copied[1:]],
        [*copied, '--csv', f'{long}/rows.csv'],
        [*copied, '--results', long],
    ):
        assert evaluate.main(line) == 2
        err = capsys.readouterr().err
        assert long in err
        assert 'Traceback' not in err


def test_processes_find_the_same_as_one(done: Done, tmp_path: Path) -> None:
    """Bit for bit, but for the times."""
    results, rows = tmp_path / 'results', tmp_path / 'rows.csv'
    line = [str(done.tree), '--dataset', 'aistpp', '--results', str(results)]
    assert evaluate.main([*line, '--jobs', '2', '--csv', str(rows)]) == 0
    for ours, theirs in zip(read_csv(rows), done.rows, strict=True):
        assert ours.keys() == theirs.keys()
        assert all(ours[key] == theirs[key] for key in ours if key not in TIMES)
    assert {p.name for p in results.iterdir()} == {p.name for p in done.results.iterdir()}


def test_unreadable_sequence_is_named_and_the_others_are_done(
    copied: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1, and 2 where none is left; the failure is not kept for good."""
    first, second = sorted((tmp_path / 'tree/keypoints3d').iterdir())
    first.write_bytes(pickle.dumps(print))
    assert evaluate.main([*copied, '--csv', str(tmp_path / 'rows.csv')]) == 1
    out, err = capsys.readouterr()
    assert f'{first.stem}: ' in err
    assert 'no pickle of plain arrays' in err
    assert 'aistpp: 1 sequences' in out
    assert 'no pickle' in read_csv(tmp_path / 'rows.csv')[0]['error']
    second.unlink()
    assert evaluate.main(copied) == 2


def test_selection_of_the_publication_leaves_out_and_says_so(
    copied: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In one of the two the simulated detector failed by more than 300 px."""
    csv_file = tmp_path / 'rows.csv'
    assert evaluate.main([*copied, '--select', 'published', '--csv', str(csv_file)]) == 0
    out, err = capsys.readouterr()
    assert '1 of 2 sequences are not selected' in err
    assert 'aistpp: 1 sequences' in out
    left_out, kept = read_csv(csv_file)
    assert left_out['left_out'] == 'a residual of 560 px'
    assert left_out['rpgd_px'] == ''
    assert (kept['left_out'], kept['frames']) == ('', '60')


def test_default_solver_alone_gives_its_figures_alone(
    copied: list[str], done: Done, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same figures as beside the others; the others' columns are empty."""
    line = [*copied, '--methods', 'default', '--csv', str(tmp_path / 'rows.csv')]
    assert evaluate.main(line) == 0
    out = capsys.readouterr().out
    assert 'RANSAC-P3P' not in out
    assert '| default ' in out
    for alone, beside in zip(read_csv(tmp_path / 'rows.csv'), done.rows, strict=True):
        assert alone['default_mm'] == beside['default_mm']
        assert alone['rpgd_px'] == ''


def test_labels_are_exported_even_of_finished_sequences(
    copied: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One .npz and one .json each; then they are finished with their labels, too."""
    line = [*copied, '--sequences', '*ch01', '--export', str(tmp_path / 'labels')]
    assert evaluate.main(line) == 0
    name = 'gBR_sBM_cAll_d04_mBR0_ch01'
    assert {p.name for p in (tmp_path / 'labels').iterdir()} == {f'{name}.npz', f'{name}.json'}
    monkeypatch.setattr(evaluate, 'evaluate', never)
    assert evaluate.main(line) == 0


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        (['--methods', 'rpgd', '--export', 'x'], '--export writes the pose of the default'),
        (['--jobs', '0'], '--jobs must be 1 or more'),
        (['--sequences', 'gXX*'], "no sequence 'gXX*' among the 2"),
        (['--csv', 'nowhere/rows.csv'], 'nowhere is no folder'),
        (['--dataset', 'human36m'], 'holds no sequence'),
    ],
)
def test_bad_arguments_are_refused(
    options: list[str], message: str, copied: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, one line."""
    assert evaluate.main([*copied, *options]) == 2
    assert message in capsys.readouterr().err


def test_chosen_sequences_alone_are_evaluated(
    copied: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By name or pattern."""
    monkeypatch.setattr(evaluate, 'evaluate', never)
    assert evaluate.main([*copied, '--sequences', '*ch02']) == 0
    assert 'aistpp: 1 sequences' in capsys.readouterr().out


def double(path: Path) -> str:
    """Note that the work was begun; die if told so, once or always."""
    with path.open('a') as file:
        file.write('begun\n')
    begun = len(path.read_text().splitlines())
    if path.name.startswith('always') or (path.name.startswith('once') and begun == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name * 2


def test_death_of_a_process_costs_nothing_but_its_own_task(tmp_path: Path) -> None:
    """Killed once, a task is done again; killed again, it is named; all others are done."""
    tasks = [tmp_path / name for name in ('a', 'b', 'once', 'c', 'always', 'd', 'e')]
    found = {task.name: result for task, result in each_somewhere(double, tasks, jobs=2)}
    assert found == {t.name: t.name * 2 for t in tasks} | {'always': None}


@pytest.mark.parametrize('stop', [signal.SIGINT, signal.SIGTERM])
def test_stopped_run_keeps_what_is_finished(stop: signal.Signals, tmp_path: Path) -> None:
    """Exit code 130, no half-written file, and the next run has less to do."""
    tree, results = tmp_path / 'tree', tmp_path / 'results'
    tree.mkdir()
    write_twin(plan('aistpp', sequences=6, seconds=0.5), tree)
    command = [sys.executable, '-m', 'rpgd_ros.apps.evaluate', str(tree), '--dataset', 'aistpp']
    command += ['--results', str(results), '--jobs', '2']
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, cwd=Path(__file__).parent.parent, text=True
    )
    deadline = time.monotonic() + 60.0
    while not list(results.glob('*.json')) and process.poll() is None:
        assert time.monotonic() < deadline, 'nothing was finished'
        time.sleep(0.01)
    process.send_signal(stop)
    _, complaint = process.communicate(timeout=60.0)
    assert process.returncode == 130
    assert 'goes on from here' in complaint
    assert 'Traceback' not in complaint
    kept = list(results.iterdir())
    assert 1 <= len(kept) < 6
    assert all(json.loads(path.read_text())['row']['frames'] == 30 for path in kept)


def test_processes_end_with_a_parent_that_was_killed(tmp_path: Path) -> None:
    """Nothing goes on in the dark."""
    program = tmp_path / 'parent.py'
    program.write_text(
        'import os, pathlib, sys\n'
        f'sys.path[:0] = [{str(Path(__file__).parent)!r}, {str(Path(__file__).parents[1])!r}]\n'
        'from rpgd_ros.apps.evaluate_pool import each_somewhere\n'
        'from test_apps_evaluate import linger\n'
        "if __name__ == '__main__':\n"
        f'    places = [pathlib.Path({str(tmp_path)!r}) / name for name in "ab"]\n'
        '    list(each_somewhere(linger, places, jobs=2))\n'
    )
    parent = subprocess.Popen([sys.executable, str(program)])
    pids = [int(wait_for(tmp_path / name)) for name in 'ab']
    parent.kill()
    parent.wait(timeout=10.0)
    deadline = time.monotonic() + 20.0
    while any(Path(f'/proc/{pid}').exists() and not is_zombie(pid) for pid in pids):
        assert time.monotonic() < deadline, 'a process outlived its parent'
        time.sleep(0.02)


def linger(path: Path) -> None:
    """Tell the process and stay."""
    path.with_suffix('.tmp').write_text(str(os.getpid()))
    path.with_suffix('.tmp').rename(path)
    signal.pause()


def wait_for(path: Path) -> str:
    """Return the text of a file as soon as it is there."""
    deadline = time.monotonic() + 30.0
    while not path.exists():
        assert time.monotonic() < deadline, f'{path} did not come'
        time.sleep(0.02)
    return path.read_text()


def is_zombie(pid: int) -> bool:
    """Whether a process has ended and nobody has fetched its exit code."""
    try:
        return ') Z ' in Path(f'/proc/{pid}/stat').read_text()
    except FileNotFoundError:
        return True
