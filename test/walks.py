# SPDX-License-Identifier: Apache-2.0
"""Simulated walks as streams of a session, and cameras that are bumped in the middle of one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import Array, so3_exp
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.observations import NS_PER_S, Observations, View
from rpgd_ros.messages import CAMERA_INFO
from rpgd_ros.session import Session
from rpgd_ros.session.recent import Pairs
from rpgd_ros.simulation import Faults, SimulatedRecording, build_scene, preset, simulate
from rpgd_ros.simulation.export import messages_of
from rpgd_ros.simulation.motion import MotionName

TICK_S = 0.5


def walk(
    seed: int,
    *,
    name: str = 'studio',
    seconds: float = 30.0,
    motion: MotionName = 'walk',
    faults: Faults | None = None,
) -> SimulatedRecording:
    """Simulate a person before the cameras of a preset."""
    return simulate(build_scene(preset(name), seed, seconds=seconds, motion=motion, faults=faults))


def play(recording: SimulatedRecording, session: Session) -> Iterator[float]:
    """Feed a session in the order of arrival; yield the seconds passed, each half a second."""
    streams = session.topics()
    waiting: dict[tuple[str, str], list[tuple[bytes, int]]] = {}
    start_ns = tick_ns = 0

    def hand_on() -> None:
        for (stream, msgtype), part in waiting.items():
            session.add(stream, msgtype, [p for p, _ in part], [t for _, t in part])
        waiting.clear()

    for message in messages_of(recording):
        if message.msgtype == CAMERA_INFO:
            continue
        start_ns = start_ns or message.receive_ns
        tick_ns = tick_ns or start_ns
        key = (streams[message.topic], message.msgtype)
        waiting.setdefault(key, []).append((message.payload, message.receive_ns))
        if message.receive_ns - tick_ns > TICK_S * NS_PER_S:
            hand_on()
            tick_ns = message.receive_ns
            yield (tick_ns - start_ns) / NS_PER_S
    hand_on()
    yield recording.preset.camera_hz and (tick_ns - start_ns) / NS_PER_S


def part_of(view: View, begin_s: float, end_s: float, *, start_ns: int) -> View:
    """Return the frames of a stretch of time, in seconds since a stamp."""
    assert view.stamp_ns is not None
    kept = (view.stamp_ns >= start_ns + begin_s * NS_PER_S) & (
        view.stamp_ns < start_ns + end_s * NS_PER_S
    )
    scores = None if view.confidence is None else view.confidence[kept]
    return View(view.stamp_ns[kept], view.x_mocap[kept], view.uv[kept], scores)


class Reel:
    """What the cameras of a recording saw, cut into stretches of time."""

    def __init__(self, recording: SimulatedRecording) -> None:
        """Pair skeletons and keypoints once."""
        self.cameras = recording.cameras
        self.observations: Observations = recording.observations()
        self.views = list(self.observations.views)
        stamps = [view.stamp_ns for view in self.views if view.stamp_ns is not None]
        self.start_ns = int(min(s[0] for s in stamps))

    def sights(self, begin_s: float, end_s: float) -> list[Sight]:
        """Return what the cameras saw in a stretch of time."""
        cut = [part_of(v, begin_s, end_s, start_ns=self.start_ns) for v in self.views]
        return [Sight(c, v) for c, v in zip(self.cameras, cut, strict=True) if v.n_frames]

    def pairs(self, begin_s: float, end_s: float) -> list[Pairs]:
        """Return the same as a session hands it out."""
        return [Pairs(s.camera, s.camera.name, s.view) for s in self.sights(begin_s, end_s)]

    def ticks(self, begin_s: float, end_s: float) -> Iterator[tuple[float, list[Pairs]]]:
        """Yield the end of each half second and what was seen in it."""
        for end in np.arange(begin_s + TICK_S, end_s + 1e-9, TICK_S).tolist():
            yield end, self.pairs(end - TICK_S, end)

    def bump(self, number: int, turn_deg: Array, *, at_s: float) -> None:
        """Turn a camera about its own axes from a time on; nobody is told."""
        view = self.views[number]
        assert view.stamp_ns is not None
        after = view.stamp_ns >= self.start_ns + at_s * NS_PER_S
        uv = view.uv.copy()
        uv[after] = seen_after(self.cameras[number], uv[after], turn_deg)
        self.views[number] = replace(view, uv=uv)


def seen_after(camera: Camera, uv: Array, turn_deg: Array | Sequence[float]) -> Array:
    """Return where keypoints (..., 2) are seen after a turn by a rotation vector."""
    flat = uv.reshape(-1, 2)
    rays = np.column_stack([camera.normalise(flat), np.ones(len(flat))])
    turned = so3_exp(np.radians(np.asarray(turn_deg, np.float64)))
    moved: Array = camera.project_camera(rays @ turned.T).reshape(uv.shape)
    return moved
