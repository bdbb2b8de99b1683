# SPDX-License-Identifier: Apache-2.0
"""Reading a bag, decode included, beside a bare read of its bytes by the rosbags library."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rosbags.rosbag2 import Reader

from rpgd_ros.apps.bench_run import Table, Track, apart, figure, markdown
from rpgd_ros.io.recording import open_recording
from rpgd_ros.io.rig import read_rig
from rpgd_ros.session import Session
from rpgd_ros.session.replay import replay
from rpgd_ros.simulation import build_scene, preset, simulate
from rpgd_ros.simulation.export import BAG, RIG, Storage, write_recording

STORAGES: tuple[Storage, ...] = ('mcap', 'sqlite3')
SECONDS = 60.0  # of the studio: 7200 skeletons, 4 x 1800 sets of keypoints
REPEATS = 5
MOST = 3.0
LIMIT_S = 600.0

CAPTION = """\
A recording of {seconds:g} s of the studio preset: one MoCap at 120 Hz, four detectors at 30 Hz.
bare: rosbags iterates over the raw messages of these topics, and does nothing with them. ours: the
same messages checked, decoded and stored in a session, ready to be paired. Processor time, best of
{repeats} turns, each in a process of its own; wanted: ours <= {most:g} x bare.
"""


def measure(
    *,
    track: Track,
    storages: Sequence[Storage] = STORAGES,
    seconds: float = SECONDS,
    repeats: int = REPEATS,
) -> Table:
    """Read one recording in both ways by turns, in each storage."""
    rows = []
    with TemporaryDirectory(prefix='rpgd_ros_bench_') as name:
        folder = Path(name)
        for storage in storages:
            (folder / storage).mkdir()
            recording = simulate(build_scene(preset('studio'), 0, seconds=seconds))
            write_recording(recording, folder / storage, storage=storage)
        turns = [storage for storage in storages for _ in range(repeats)]
        for storage in track(turns, 'reading', len(turns)):
            for how in (bare, ours):
                seconds_taken, n_messages = apart(timed, how, folder / storage, limit_s=LIMIT_S)
                rows.append({
                    'storage': storage, 'how': how.__name__, 's': seconds_taken,
                    'messages': n_messages,
                })  # fmt: skip
    text = CAPTION.format(seconds=seconds, repeats=repeats, most=MOST)
    header = ('storage', 'messages', 'bare us / message', 'ours', 'ours / bare', '')
    return Table('reading', f'{text}\n{markdown(header, _lines(rows))}\n', rows)


def timed(how: Callable[[Path], int], folder: Path) -> tuple[float, int]:
    """Return the processor time of reading a recording, and how many messages it had.

    The first reading loads what is loaded once, and the file into the system's memory.
    """
    how(folder)
    began = time.process_time()
    n_messages = how(folder)
    return time.process_time() - began, n_messages


def bare(folder: Path) -> int:
    """Iterate over the raw messages that a calibration needs."""
    rig = read_rig(folder / RIG)
    topics = {'/' + name.lstrip('/') for name in Session(rig).topics()}
    count = 0
    with Reader(folder / BAG) as reader:
        wanted = [connection for connection in reader.connections if connection.topic in topics]
        for _ in reader.messages(wanted):
            count += 1
    return count


def ours(folder: Path) -> int:
    """Read them into a session."""
    rig = read_rig(folder / RIG)
    session = Session(rig)
    with open_recording(folder / BAG, rig) as recording:
        replay(recording, session, progress=lambda _stage, _share: None, tell=lambda _text: None)
    return sum(session.counts(stream)['kept'] for stream in session.streams)


def _lines(rows: Sequence[dict[str, Any]]) -> Iterator[list[str]]:
    for storage in dict.fromkeys(row['storage'] for row in rows):
        part = [row for row in rows if row['storage'] == storage]
        best = {
            how: min(row['s'] for row in part if row['how'] == how) for how in ('bare', 'ours')
        }
        n_messages = part[0]['messages']
        ratio = best['ours'] / best['bare']
        yield [
            storage, str(n_messages), *(figure(1e6 * best[h] / n_messages) for h in best),
            figure(ratio), 'holds' if ratio <= MOST else 'does NOT hold',
        ]  # fmt: skip
