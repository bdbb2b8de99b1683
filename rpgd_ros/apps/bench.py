# SPDX-License-Identifier: Apache-2.0
"""Measures accuracy, robustness, speed and honesty of the solver, from this package alone."""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import sys
from collections.abc import Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, get_args

from rich.console import Console
from rich.progress import track

from rpgd_ros.apps import (
    bench_growth,
    bench_honesty,
    bench_published,
    bench_reading,
    bench_solver,
)
from rpgd_ros.apps.bench_problems import THRESHOLDS_PX
from rpgd_ros.apps.bench_run import Table, Track, prepare
from rpgd_ros.apps.stopping import EXIT_STOPPED, Stopped, stop_on_signals
from rpgd_ros.core import InputError, Reason
from rpgd_ros.io.atomic import write_atomic
from rpgd_ros.simulation.presets import OutlierKind
from rpgd_ros.skeletons import CONVENTIONS

EXIT_DONE, EXIT_BAD_INPUT = 0, 2
USUAL = ('published', 'solver', 'honesty')
TABLES = (*USUAL, 'growth', 'reading')
KINDS = get_args(OutlierKind)
PACKAGES = ('numpy', 'opencv-python-headless', 'opencv-python', 'poselib', 'scipy')

DESCRIPTION = """\
Measure the solver on simulated people whose transform is known, and print tables in markdown:

  published  the published method on twins of its datasets, beside its published figures
  solver     the default solver beside PoseLib and OpenCV + SciPy: right runs, error against the
             Cramer-Rao bound, time; without and with outliers
  honesty    whether the reported covariance says how far off the pose is
  growth     time, accuracy and memory from 10^4 to 10^6 frames, in one sequence and in many
  reading    reading and decoding a bag beside a bare read of its bytes by rosbags
"""
EPILOG = """\
examples, with `bench` for `python -m rpgd_ros.apps.bench`, or make bench ARGS='...':
  bench                                        # published, solver, honesty: eight minutes
  bench solver --seeds 20 --kinds mixed --ratios 0.5 0.7
  bench solver --data kinect --frames 300 --solvers rpgd_ros poselib-sub-trunc
  bench solver --data human36m --frames 30000 --seeds 3 --ratios
  bench growth --frames 10000 100000 300000    # all: an hour and 6 GB
  bench reading
  bench published --data aistpp --output published.md --json published.json
Peers are optional: pip install -e '.[bench]'; one that is missing is left out, and said.
Times are processor times; compare them within one run only. Progress goes to stderr.
exit codes: 0 measured, 2 bad input, 130 stopped
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    arguments = _parser().parse_args(argv)
    try:
        with stop_on_signals():
            _run(arguments, Console(stderr=True))
    except InputError as error:
        print(f'bench: {error.message}', file=sys.stderr)
        return EXIT_BAD_INPUT
    except Stopped:
        print('bench: stopped', file=sys.stderr)
        return EXIT_STOPPED
    return EXIT_DONE


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='bench',
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add(
        'tables',
        nargs='*',
        metavar='TABLE',
        help=f'{", ".join(TABLES)} (default {", ".join(USUAL)})',
    )
    text = 'problems of each kind (default 40; solver 6; growth 1)'
    add('--seeds', type=_whole, metavar='N', help=text)
    text = 'the first of them; other seeds are other problems (default 0)'
    add('--first-seed', type=int, default=0, metavar='N', help=text)
    text = 'frames of each camera; several for all but published (default 300 and 3000; published'
    text += ' 300; growth 10^4, 10^5 and 10^6)'
    add('--frames', type=_whole, nargs='+', metavar='N', help=text)
    text = 'datasets to twin (default: those the publication measured; published: kinect, too)'
    add('--data', nargs='+', choices=list(THRESHOLDS_PX), help=text)
    text = 'honesty: conventions of the joints (default h36m17 h36m32)'
    add('--joints', nargs='+', choices=list(CONVENTIONS), default=bench_honesty.JOINTS, help=text)
    text = 'solver: kinds of outliers (default all)'
    add('--kinds', nargs='*', choices=KINDS, default=KINDS, help=text)
    text = 'solver: shares of outliers, 0 to 1 (default 0.7); none: without outliers only'
    add('--ratios', type=float, nargs='*', metavar='SHARE', default=(0.7,), help=text)
    text = 'solver: who takes part (default all but published, which takes seconds each)'
    add('--solvers', nargs='+', choices=bench_solver.SOLVERS, help=text)
    text = 'solver: longest time for one answer (default 60)'
    add('--limit', type=float, default=60.0, metavar='SECONDS', help=text)
    text = 'published, honesty: processes at once (default: the number of processors)'
    add('--jobs', type=_whole, default=os.cpu_count() or 1, metavar='N', help=text)
    add('--output', type=Path, metavar='FILE', help='write the tables there, too')
    add('--json', type=Path, metavar='FILE', help='write every single figure there')
    return parser


def _whole(text: str) -> int:
    number = int(text)
    if number < 1:
        msg = f'{text} is not 1 or more'
        raise argparse.ArgumentTypeError(msg)
    return number


def _run(arguments: argparse.Namespace, console: Console) -> None:
    names = arguments.tables or USUAL
    _check(arguments, names)
    prepare()

    def show(items: Iterable[Any], what: str, count: int) -> Iterable[Any]:
        return track(items, what, total=count, console=console)

    parts, figures = [f'{_conditions()}\n'], {}
    print(parts[0], flush=True)
    for name in dict.fromkeys(names):
        table = _measure(name, arguments, show)
        parts.append(f'## {table.name}\n\n{table.text}')
        figures[name] = [_without_nan(row) for row in table.rows]
        print(parts[-1], flush=True)
    if arguments.output:
        write_atomic(arguments.output, '\n'.join(parts))
    if arguments.json:
        write_atomic(arguments.json, json.dumps({'conditions': _conditions(), **figures}))


def _check(arguments: argparse.Namespace, names: Sequence[str]) -> None:
    """Find out now what would otherwise end the run after ten minutes."""
    unknown = [name for name in names if name not in TABLES]
    if unknown:
        msg = f'unknown table {unknown[0][:80]!r}; known: {", ".join(TABLES)}'
        raise InputError(Reason.BAD_INPUT, msg)
    if arguments.first_seed < 0:
        msg = f'--first-seed must be 0 or more, got {arguments.first_seed}'
        raise InputError(Reason.BAD_INPUT, msg)
    for ratio in arguments.ratios:
        if not 0.0 < ratio <= 1.0:
            msg = f'--ratios must be above 0 and at most 1, got {ratio}'
            raise InputError(Reason.BAD_INPUT, msg)
    if not arguments.limit > 0.0:
        msg = f'--limit must be above 0 s, got {arguments.limit}'
        raise InputError(Reason.BAD_INPUT, msg)
    for path in (arguments.output, arguments.json):
        if path and not path.parent.is_dir():
            msg = f'{path.parent} is no folder: create it first'
            raise InputError(Reason.NOT_WRITABLE, msg)


def _measure(name: str, arguments: argparse.Namespace, show: Track) -> Table:
    n_seeds = arguments.seeds or {'solver': 6, 'growth': 1}.get(name, 40)
    seeds = range(arguments.first_seed, arguments.first_seed + n_seeds)
    frames = arguments.frames
    if name == 'published':
        return bench_published.measure(
            arguments.data or bench_published.DATA,
            seeds,
            frames=frames[0] if frames else bench_published.FRAMES,
            jobs=arguments.jobs,
            track=show,
        )
    if name == 'honesty':
        return bench_honesty.measure(
            arguments.joints,
            seeds,
            frames=frames or bench_honesty.FRAMES,
            jobs=arguments.jobs,
            track=show,
        )
    if name == 'growth':
        return bench_growth.measure(seeds, frames=frames or bench_growth.FRAMES, track=show)
    if name == 'reading':
        return bench_reading.measure(track=show)
    return bench_solver.measure(
        arguments.data or bench_solver.DATA,
        seeds,
        frames=frames or bench_solver.FRAMES,
        kinds=arguments.kinds,
        ratios=arguments.ratios,
        solvers=arguments.solvers or bench_solver.SOLVERS[:-1],
        limit_s=arguments.limit,
        track=show,
    )


def _conditions() -> str:
    """Say on what it was measured."""
    parts = [f'Python {platform.python_version()}']
    for package in PACKAGES:
        try:
            parts.append(f'{package} {version(package)}')
        except PackageNotFoundError:
            continue
    return f'{", ".join(parts)}; {os.cpu_count()} processors, {platform.machine()}.'


def _without_nan(row: dict[str, Any]) -> dict[str, Any]:
    """JSON knows no NaN."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in row.items()
    }


if __name__ == '__main__':
    sys.exit(main())
