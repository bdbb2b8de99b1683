# SPDX-License-Identifier: Apache-2.0
"""Reproduces the publication's table from the published datasets."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Generator, Sequence
from contextlib import closing
from fnmatch import fnmatchcase
from pathlib import Path
from threading import Event
from typing import get_args

from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress

from rpgd_ros.apps.evaluate_cluster import each_on_cluster
from rpgd_ros.apps.evaluate_plots import plot_rows
from rpgd_ros.apps.evaluate_pool import each_somewhere
from rpgd_ros.apps.evaluate_sequence import METHODS, Row, Task, empty_row, evaluate, finished
from rpgd_ros.apps.evaluate_tables import csv_text, json_text, print_results, solved
from rpgd_ros.apps.progress import bar_columns
from rpgd_ros.apps.stopping import EXIT_STOPPED, Stopped, stop_on_signals
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.datasets import Dataset, DatasetName, open_dataset
from rpgd_ros.datasets.files import is_folder
from rpgd_ros.io.atomic import remove_leftovers, write_atomic
from rpgd_ros.report.sequences import check_library

EXIT_DONE, EXIT_PARTIAL, EXIT_BAD_INPUT, EXIT_BUG = 0, 1, 2, 70
MAX_COMPLAINTS = 10

DESCRIPTION = """\
Calibrate every sequence of a published dataset by the published method and by the default solver,
and print the publication's table with the published figures beside ours.
"""
EPILOG = """\
folders, in the datasets' own layouts:
  aistpp         annotations of AIST++: keypoints2d/ keypoints3d/ cameras/ ignore_list.txt
  human36m       S*/MyPoseFeatures/D2_Positions and D3_Positions (.cdf), and metadata.xml;
                 or data_3d_h36m.npz, data_2d_h36m_gt.npz, and metadata.xml
  mpi_inf_3dhp   S*/Seq*/annot.mat and camera.calibration
  .cdf and .mat files need libraries: pip install 'rpgd_ros[datasets]'

The datasets give skeletons in the world frame, where the answer would be the identity: each
sequence is first moved by a transform that its name draws.

A finished sequence leaves a small file in the folder of --results and is not done again as long
as program, settings and data stay the same: stop at any time, and start again.

examples:
  evaluate aist_plusplus_final --dataset aistpp --select published --csv aistpp.csv
  evaluate mpi_inf_3dhp --dataset mpi_inf_3dhp --plots sequences.html
  evaluate h36m --dataset human36m --sequences 'S9/*' 'S11/*'
  evaluate /data/aistpp --dataset aistpp --results /data/results --scheduler tcp://head:8786
exit codes:
  0   every sequence was evaluated
  1   some sequences could not be: they are named
  2   bad input: nothing was evaluated
  130 stopped; what is finished is kept
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    arguments = _parser().parse_args(argv)
    try:
        with stop_on_signals() as stop:
            return _run(arguments, Console(), Console(stderr=True), stop)
    except InputError as error:
        print(f'evaluate: {error.message}', file=sys.stderr)
        return EXIT_BAD_INPUT
    except Stopped:
        print('evaluate: stopped; the same command goes on from here', file=sys.stderr)
        return EXIT_STOPPED
    except Exception:
        Console(stderr=True).print_exception()
        print('evaluate: this should not happen, please report it', file=sys.stderr)
        return EXIT_BUG


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='evaluate',
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add('folder', type=Path, metavar='DATASET_DIR', help='folder in the layout of the dataset')
    text = 'whose layout it is'
    add('--dataset', required=True, choices=get_args(DatasetName), help=text)
    text = (
        "all sequences, or the publication's: AIST++ without residuals above 300 px, Human3.6M "
        'S1 S5 S6 S7 S8 S9 S11; of MPI-INF-3DHP it used 14 and does not name them: all '
        '(default all)'
    )
    add('--select', choices=('all', 'published'), default='all', help=text)
    text = (
        f'which of {", ".join(METHODS)} to run (default all; ransac and rpgd are the published '
        'method without and with its refinement, and take nearly all of the time)'
    )
    add('--methods', nargs='+', choices=METHODS, default=METHODS, metavar='METHOD', help=text)
    text = 'only these sequences; * and ? stand for any characters'
    add('--sequences', nargs='+', default=[], metavar='NAME', help=text)
    add('--csv', type=Path, metavar='FILE', help='write one line per sequence')
    text = (
        'write plots as one page: MPJPE, distance from the given pose and time of every sequence '
        "(needs pip install 'rpgd_ros[report]')"
    )
    add('--plots', type=Path, metavar='FILE.html', help=text)
    text = 'print the rows of the CSV as JSON instead of tables, for programs'
    add('--json', action='store_true', help=text)
    text = (
        "write each accepted sequence's joints in the camera frames (.npz) and reprojected "
        'labels (COCO .json)'
    )
    add('--export', type=Path, metavar='DIR', help=text)
    text = 'where finished sequences are kept (default evaluation_<dataset>)'
    add('--results', type=Path, metavar='DIR', help=text)
    text = 'processes at once (default: as many as there are processors)'
    text = 'have the workers of this Dask cluster do it, which see the same folders'
    add('--scheduler', metavar='ADDRESS', help=text)
    add('--jobs', type=int, default=os.cpu_count() or 1, metavar='N', help=text)
    return parser


def _run(arguments: argparse.Namespace, out: Console, err: Console, stop: Event) -> int:
    if arguments.export and 'default' not in arguments.methods:
        msg = '--export writes the pose of the default solver: leave it among the --methods'
        raise InputError(Reason.BAD_INPUT, msg)
    if arguments.jobs < 1:
        msg = f'--jobs must be 1 or more, got {arguments.jobs}'
        raise InputError(Reason.BAD_INPUT, msg)
    if arguments.plots:
        check_library()
    files = (arguments.csv, arguments.results, arguments.export, arguments.plots)
    for path in filter(None, files):
        if not is_folder(path.absolute().parent):
            msg = f'{path.parent} is no folder: create it first'
            raise InputError(Reason.NOT_WRITABLE, msg)
    is_published = arguments.select == 'published'
    dataset = open_dataset(arguments.dataset, arguments.folder, is_published=is_published)
    names = _chosen(dataset.names, arguments.sequences, arguments.folder)
    results = _made(arguments.results or Path(f'evaluation_{arguments.dataset}'))
    export = _made(arguments.export) if arguments.export else None
    # Workers of a cluster have working folders of their own.
    folder, methods = (
        arguments.folder.absolute(),
        tuple(m for m in METHODS if m in arguments.methods),
    )
    tasks = [
        Task(arguments.dataset, folder, name, is_published, results, export, methods)
        for name in names
    ]
    rows = _evaluate_all(tasks, dataset, arguments.jobs, arguments.scheduler, err, stop)
    if arguments.json:
        print(json_text(arguments.dataset, rows))
    else:
        print_results(out, arguments.dataset, rows, tasks[0].methods)
    if arguments.csv:
        write_atomic(arguments.csv, csv_text(rows))
    if arguments.plots:
        plot_rows(arguments.plots, arguments.dataset, rows, tasks[0].methods)
    return _conclude(rows, err)


def _chosen(names: Sequence[str], patterns: Sequence[str], folder: Path) -> list[str]:
    """Return the names that were asked for, in the dataset's order."""
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            msg = f'no sequence {pattern[:80]!r} among the {len(names)} in {folder}'
            raise InputError(Reason.BAD_INPUT, msg)
    chosen = [n for n in names if not patterns or any(fnmatchcase(n, p) for p in patterns)]
    if not chosen:
        msg = f'{folder} holds no sequence; see --help for the layout'
        raise InputError(Reason.BAD_INPUT, msg)
    return chosen


def _made(path: Path) -> Path:
    """Return the absolute path of a folder, made where it was not there."""
    try:
        path.mkdir(exist_ok=True)
    except OSError as error:
        msg = f'{path} cannot be made: {error.strerror or error}'
        raise InputError(Reason.NOT_WRITABLE, msg) from error
    return path.absolute()


def _done_by(
    tasks: Sequence[Task], jobs: int, scheduler: str | None
) -> Generator[tuple[Task, Row | None], None, None]:
    """Return the rows as they come, from processes here or from a cluster."""
    if scheduler and tasks:
        return each_on_cluster(evaluate, tasks, address=scheduler)
    return each_somewhere(evaluate, tasks, jobs=min(jobs, max(len(tasks), 1)))


def _evaluate_all(
    tasks: Sequence[Task],
    dataset: Dataset,
    jobs: int,
    scheduler: str | None,
    err: Console,
    stop: Event,
) -> list[Row]:
    """Return the rows of all sequences in their order; finished ones are not done again."""
    rows: dict[str, Row] = {}
    for task in tasks:
        remove_leftovers(task.file)
        row = finished(task, dataset)
        if row is not None:
            rows[task.name] = row
    columns = (*bar_columns(), MofNCompleteColumn())
    with Progress(*columns, console=err, transient=True) as progress:
        bar = progress.add_task(
            'sequences', total=len(tasks), completed=len(rows), things=(1.0, 'sequences')
        )
        left = [task for task in tasks if task.name not in rows]
        with closing(_done_by(left, jobs, scheduler)) as results:
            for task, row in results:
                died = empty_row(task.name) | {'error': 'its process died again and again'}
                rows[task.name] = died if row is None else row
                progress.advance(bar)
                if stop.is_set():
                    raise Stopped
    return [rows[task.name] for task in tasks]


def _conclude(rows: Sequence[Row], err: Console) -> int:
    """Name what could not be evaluated, and return the exit code."""
    left_out = [row for row in rows if row['left_out']]
    failed = [row for row in rows if row['error']]
    sentences = []
    if left_out:
        first = f'{left_out[0]["sequence"]}: {left_out[0]["left_out"]}'
        sentences.append(f'{len(left_out)} of {len(rows)} sequences are not selected; {first}')
    sentences += [f'{row["sequence"]}: {row["error"]}' for row in failed[:MAX_COMPLAINTS]]
    if len(failed) > MAX_COMPLAINTS:
        sentences.append(f'and {len(failed) - MAX_COMPLAINTS} more, see --csv')
    for sentence in sentences:
        err.print(sentence, markup=False, highlight=False, soft_wrap=True)
    if failed:
        return EXIT_PARTIAL if solved(rows) else EXIT_BAD_INPUT
    return EXIT_DONE


if __name__ == '__main__':
    sys.exit(main())
