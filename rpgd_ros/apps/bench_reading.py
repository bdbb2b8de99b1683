# SPDX-License-Identifier: Apache-2.0
"""Reading a bag, decode included, beside a bare read of its bytes by the rosbags library."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

from rosbags.rosbag2 import Reader

from rpgd_ros.apps.bench_run import Table, Track, apart, figure, markdown
from rpgd_ros.io.bag import absolute_name
from rpgd_ros.io.recording import open_recording
from rpgd_ros.io.rig import Rig, read_rig
from rpgd_ros.messages import decode_joints
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
bare: rosbags iterates over the raw messages of these topics, and does nothing with them. decoded:
they are checked and become arrays. stored: they are also sorted into a session, ready to be
paired. Processor time, microseconds per message, best of {repeats} turns, each in a process of its
own; wanted: decoded <= {most:g} x bare.
"""


def measure(
    *,
    track: Track,
    storages: Sequence[Storage] = STORAGES,
    seconds: float = SECONDS,
    repeats: int = REPEATS,
) -> Table:
    """Read one recording in three ways by turns, in each storage."""
    rows = []
    with TemporaryDirectory(prefix='rpgd_ros_bench_') as name:
        folder = Path(name)
        for storage in storages:
            (folder / storage).mkdir()
            recording = simulate(build_scene(preset('studio'), 0, seconds=seconds))
            write_recording(recording, folder / storage, storage=storage)
        turns = [storage for storage in storages for _ in range(repeats)]
        for storage in track(turns, 'reading', len(turns)):
            for how in (bare, decoded, stored):
                seconds_taken, n_messages = apart(timed, how, folder / storage, limit_s=LIMIT_S)
                rows.append({
                    'storage': storage, 'how': how.__name__, 's': seconds_taken,
                    'messages': n_messages,
                })  # fmt: skip
    text = CAPTION.format(seconds=seconds, repeats=repeats, most=MOST)
    header = (
        'storage', 'messages', 'bare', 'decoded', 'stored', 'decoded / bare', 'stored / bare', ''
    )  # fmt: skip
    return Table('reading', f'{text}\n{markdown(header, _lines(rows))}\n', rows)


def timed(how: Callable[[Path, Rig], int], folder: Path) -> tuple[float, int]:
    """Return the processor time of reading a recording, and how many messages it had.

    The first reading loads what is loaded once, and the file into the system's memory.
    """
    rig = read_rig(folder / RIG)
    how(folder / BAG, rig)
    began = time.process_time()
    n_messages = how(folder / BAG, rig)
    return time.process_time() - began, n_messages


def bare(bag: Path, rig: Rig) -> int:
    """Iterate over the raw messages that a calibration needs."""
    topics = {absolute_name(source) for source in (*rig.mocap_topics, *_keypoints(rig))}
    count = 0
    with Reader(bag) as reader:
        wanted = [connection for connection in reader.connections if connection.topic in topics]
        for _ in reader.messages(wanted):
            count += 1
    return count


def decoded(bag: Path, rig: Rig) -> int:
    """Read them, and decode them into arrays."""
    mocap = ((topic, len(rig.mocap.joints)) for topic in rig.mocap_topics)
    keypoints = ((c.keypoints_topic, len(c.keypoint_joints)) for c in rig.cameras)
    wanted: dict[str, tuple[int, Literal[2, 3]]] = {topic: (n, 3) for topic, n in mocap}
    wanted |= {topic: (n, 2) for topic, n in keypoints}
    count = 0
    with open_recording(bag, rig) as recording:
        for batch in recording.batches():
            n_joints, n_values = wanted[batch.topic]
            found = decode_joints(
                batch.msgtype, batch.payloads, n_joints=n_joints, n_values=n_values
            )
            count += len(found.batch.stamp_ns) if found.batch else 0
    return count


def stored(bag: Path, rig: Rig) -> int:
    """Read, decode, and keep them in a session, ready to be paired."""
    session = Session(rig)
    with open_recording(bag, rig) as recording:
        replay(recording, session, progress=lambda _stage, _share: None, tell=lambda _text: None)
    return sum(session.counts(stream)['kept'] for stream in session.streams)


def _keypoints(rig: Rig) -> list[str]:
    return [camera.keypoints_topic for camera in rig.cameras]


def _lines(rows: Sequence[dict[str, Any]]) -> Iterator[list[str]]:
    for storage in dict.fromkeys(row['storage'] for row in rows):
        part = [row for row in rows if row['storage'] == storage]
        best = {
            how: min(row['s'] for row in part if row['how'] == how)
            for how in ('bare', 'decoded', 'stored')
        }
        n_messages = part[0]['messages']
        ratio = best['decoded'] / best['bare']
        yield [
            storage, str(n_messages), *(figure(1e6 * best[h] / n_messages) for h in best),
            figure(ratio), figure(best['stored'] / best['bare']),
            'holds' if ratio <= MOST else 'does NOT hold',
        ]  # fmt: skip
