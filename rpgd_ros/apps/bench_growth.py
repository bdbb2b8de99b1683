# SPDX-License-Identifier: Apache-2.0
"""Time and accuracy against the number of frames: in one long sequence, and in many short ones."""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rpgd_ros.apps.bench_problems import Case, build, cramer_rao, judge
from rpgd_ros.apps.bench_run import Table, Track, apart, figure, markdown
from rpgd_ros.core import CalibrationConfig, Camera, Observations, View, calibrate
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, BoolArray, IntArray
from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.simulation import (
    Preset,
    Scene,
    SimulatedRecording,
    Truth,
    Twin,
    build_scene,
    preset,
    simulate,
)
from rpgd_ros.skeletons import joint_names

FRAMES = (10_000, 100_000, 1_000_000)
SHORT = 1000  # frames of a short sequence
CHUNK = 10_000  # frames that are simulated at once: 0.2 GB of work, whatever the length
JOINTS = 'h36m17'  # a million frames of four cameras: 2 GB
DATA = 'human36m'
LIMIT_S = 4 * 3600.0
SEEDS_APART = 1000  # from chunk to chunk: no chunk of one seed is that of another
WARM_UP = Case(DATA, 300, 0, joints=JOINTS)

CAPTION = """\
{data} rig and noise, {joints}, {seeds} seeds, CalibrationConfig(). long: one sequence; short: as
many of {short} frames as make up the same number, one after the other in one process. s: processor
time of all solves, one thread; us / frame: the same by frame; growth: time by that of the line
above, and in brackets frames by frames. error and x bound: RMS displacement of the body's points
over all sequences, and that by the RMS Cramer-Rao bound. MB: resident memory at its peak, data
included. The last passes work on at most {budget} correspondences, spread evenly ({share} frames
of this rig): beyond them time grows only with what is looked at, and the error stays while the
bound falls.
"""


def measure(
    seeds: Sequence[int],
    *,
    frames: Sequence[int],
    track: Track,
    shapes: Sequence[str] = ('long', 'short'),
) -> Table:
    """Solve each number of frames in both ways, each in a process of its own."""
    todo = [(shape, n, seed) for shape in shapes for n in sorted(frames) for seed in seeds]
    solve = {'long': solve_long, 'short': solve_short}
    done = (apart(solve[shape], n, seed, limit_s=LIMIT_S) for shape, n, seed in todo)
    rows = list(track(done, 'growth', len(todo)))
    budget = CalibrationConfig().refine.max_correspondences
    per_frame = len(preset(DATA).rig.mounts) * len(joint_names(JOINTS))
    text = CAPTION.format(
        budget=budget,
        share=budget // per_frame,
        data=DATA,
        joints=JOINTS,
        seeds=len(seeds),
        short=SHORT,
    )
    header = ('', 'sequences', 'frames', 's', 'us / frame', 'growth', 'mm', 'x bound', 'MB')
    return Table('growth', f'{text}\n{markdown(header, _lines(rows))}\n', rows)


def solve_long(frames: int, seed: int) -> dict[str, Any]:
    """Solve one sequence, however long."""
    _warm_up()
    problem = long_problem(frames, seed)
    return _row('long', frames, seed, [_solved(problem)])


def solve_short(frames: int, seed: int) -> dict[str, Any]:
    """Solve as many short sequences as have that many frames."""
    _warm_up()
    count = max(1, frames // SHORT)
    first = seed * count
    figures = [_solved(build(Case(DATA, SHORT, first + k, joints=JOINTS))) for k in range(count)]
    return _row('short', count * SHORT, seed, figures)


def long_problem(frames: int, seed: int) -> Twin:
    """Simulate a sequence in chunks: the same rig and transform, another walk in each.

    Walks begin anew at each chunk, as they do between the takes of a day; time goes on.
    """
    data: _Data | None = None
    for number, scene in enumerate(_scenes(frames, seed)):
        recording = simulate(scene)
        if data is None:
            data = _Data.empty(frames, recording)
        data.fill(number * CHUNK, recording, shift_ns=number * _chunk_ns())
    if data is None:
        msg = f'--frames must be 1 or more, got {frames}'
        raise InputError(Reason.BAD_INPUT, msg)
    views = tuple(View(data.stamp_ns, data.x_mocap, uv) for uv in data.uv)
    truth = replace(data.truth, inliers=tuple(data.inlier))
    return Twin(data.cameras, Observations(views), truth)


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """The arrays of a long sequence, made once and filled chunk by chunk.

    All cameras see the same instants: skeletons (T, J, 3) are one array for all. Keypoints are
    (V, T, J, 2), masks of inliers (V, T, J).
    """

    cameras: tuple[Camera, ...]
    truth: Truth
    stamp_ns: IntArray
    x_mocap: Array
    uv: Array
    inlier: BoolArray

    @classmethod
    def empty(cls, frames: int, recording: SimulatedRecording) -> _Data:
        shape = (frames, recording.mocap.x_mocap.shape[1])
        n = len(recording.cameras)
        return cls(
            recording.cameras, recording.truth, np.empty(frames, np.int64),
            np.empty((*shape, 3)), np.empty((n, *shape, 2)), np.empty((n, *shape), bool),
        )  # fmt: skip

    def fill(self, start: int, recording: SimulatedRecording, *, shift_ns: int) -> None:
        there = slice(start, min(start + CHUNK, len(self.stamp_ns)))
        n = there.stop - start
        self.stamp_ns[there] = recording.mocap.stamp_ns[:n] + shift_ns
        self.x_mocap[there] = recording.mocap.x_mocap[:n]
        for v, stream in enumerate(recording.streams):
            self.uv[v, there] = stream.uv[:n]
            self.inlier[v, there] = recording.truth.inliers[v][:n]


def _settings() -> Preset:
    return replace(preset(DATA), mocap_joints=JOINTS, keypoint_joints=JOINTS)


def _chunk_ns() -> int:
    return round(CHUNK / _settings().camera_hz * NS_PER_S)


def _scenes(frames: int, seed: int) -> Iterator[Scene]:
    """Yield the scenes of the chunks: the walks differ, rig and transform are the first one's."""
    settings, first = _settings(), None
    for number in range(-(-frames // CHUNK)):
        scene = build_scene(
            settings, seed + SEEDS_APART * number, seconds=CHUNK / settings.camera_hz
        )
        first = first or scene
        yield replace(scene, cameras=first.cameras, world_T_mocap=first.world_T_mocap)


def _warm_up() -> None:
    problem = build(WARM_UP)
    calibrate(problem.cameras, problem.observations, config=CalibrationConfig())


def _solved(problem: Twin) -> tuple[float, float, float]:
    """Return processor time, s, error and bound, m."""
    began = time.process_time()
    found = calibrate(problem.cameras, problem.observations, config=CalibrationConfig())
    seconds = time.process_time() - began
    error = judge(problem, found.world_T_mocap)
    return seconds, error.points_m, cramer_rao(problem).points_m


def _row(
    shape: str, frames: int, seed: int, figures: Sequence[tuple[float, float, float]]
) -> dict[str, Any]:
    seconds, error, bound = np.array(figures).T
    return {
        'shape': shape,
        'sequences': len(figures),
        'frames': frames,
        'seed': seed,
        'seconds': float(seconds.sum()),
        'mm': 1e3 * float(np.sqrt((error**2).mean())),
        'bound_mm': 1e3 * float(np.sqrt((bound**2).mean())),
        'peak_mb': _peak_mb(),
    }


def _peak_mb() -> float:
    """Return the largest resident memory of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _lines(rows: Sequence[dict[str, Any]]) -> Iterator[list[str]]:
    cells: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for row in rows:
        cells.setdefault((row['shape'], row['frames']), []).append(row)
    before: tuple[str, int, float] = ('', 0, 0.0)
    for (shape, frames), part in cells.items():
        seconds = float(np.median([row['seconds'] for row in part]))
        mm, bound = (np.sqrt(np.mean([row[k] ** 2 for row in part])) for k in ('mm', 'bound_mm'))
        growth = '-'
        if shape == before[0]:
            growth = f'{seconds / before[2]:.2f} ({frames / before[1]:g})'
        before = (shape, frames, seconds)
        yield [
            shape, str(part[0]['sequences']), str(frames), figure(seconds),
            figure(1e6 * seconds / frames), growth, figure(float(mm)), figure(float(mm / bound)),
            f'{max(row["peak_mb"] for row in part):.0f}',
        ]  # fmt: skip
