# SPDX-License-Identifier: Apache-2.0
"""One run of `calibrate_bag`: reads a recording, solves, and keeps all that outputs may need."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from threading import Event

from rich.console import Console

from rpgd_ros.apps.progress import one_bar
from rpgd_ros.apps.snapshot_case import moved_m, observations_of, offsets_s
from rpgd_ros.core.errors import CalibrationError, InputError, Reason
from rpgd_ros.core.observations import Observations
from rpgd_ros.core.result import Calibration
from rpgd_ros.io.recording import Recording, open_recording
from rpgd_ros.io.result_file import StoredLevel, result_text
from rpgd_ros.io.rig import Rig
from rpgd_ros.pairing import BufferConfig
from rpgd_ros.report import StreamCount
from rpgd_ros.session import Session, SessionConfig, Snapshot, solve
from rpgd_ros.session.monitor import appraise
from rpgd_ros.session.replay import replay

# A recording is finite: all of it is kept, up to a day.
WHOLE_RECORDING_S = 86_400.0
UNNAMED_MOCAP_FRAME = 'mocap'  # where neither the rig file nor the messages name one


@dataclass(frozen=True, eq=False)
class BagRun:
    """What a run gave.

    Attributes:
        bag: The recording.
        rig: The cameras that were used.
        session: All messages.
        problem: What is missing of a damaged bag, '' = nothing.
        stamp_ns: When it ended, since 1970.
        snapshot: What the solve was given; None where nothing came together.
        calibration: What was found, refused or not; None where that is nothing.
        refusal: Why nobody should use it; None = accepted.

    """

    bag: Path
    rig: Rig
    session: Session
    problem: str
    stamp_ns: int
    snapshot: Snapshot | None = None
    calibration: Calibration | None = None
    refusal: CalibrationError | None = None

    @property
    def frames(self) -> tuple[str, str]:
        """World and MoCap frame."""
        return self.rig.world_frame, self.session.mocap_frame or UNNAMED_MOCAP_FRAME

    @cached_property
    def observations(self) -> Observations | None:
        """The pairs, at the clock offsets that were found."""
        if self.snapshot is None:
            return None
        return observations_of(self.snapshot, self.calibration)

    @cached_property
    def stored_levels(self) -> dict[str, StoredLevel]:
        """How each camera fits what was found: what a later recording is compared with."""
        if self.calibration is None or self.snapshot is None:
            return {}
        return appraise(self.snapshot, self.calibration).stored_levels

    @cached_property
    def result_text(self) -> str:
        """The result file of what was found; '' where nothing was, or nobody should use it."""
        if self.calibration is None or self.refusal is not None:
            return ''
        world_frame, mocap_frame = self.frames
        return result_text(
            self.calibration,
            world_frame=world_frame,
            mocap_frame=mocap_frame,
            stamp_ns=self.stamp_ns,
            optical_frames=self.session.optical_frames(),
            levels=self.stored_levels,
        )

    @property
    def offsets_s(self) -> tuple[float, ...]:
        """How late the video of each camera is stamped, found or known, seconds."""
        return offsets_s(self.snapshot, self.calibration) if self.snapshot else ()

    @property
    def moved_m(self) -> float:
        """Distance that the body covered, as the gates count it, metres; NaN where unknown."""
        return moved_m(self.snapshot) if self.snapshot else float('nan')

    @property
    def streams(self) -> tuple[StreamCount, ...]:
        """What became of the messages of each stream."""
        pairs = self.session.pair_counts()
        found = []
        for stream, topic in self.session.sources().items():
            counts = dict(self.session.counts(stream))
            received, kept = counts.pop('received'), counts.pop('kept', 0)
            dropped = {reason: n for reason, n in counts.items() if n}
            paired = pairs[stream].paired if stream in pairs else None
            found.append(StreamCount(stream, topic, received, kept, paired, dropped))
        return tuple(found)


def read_bag(
    path: Path, rig: Rig, err: Console, stop: Event, settings: SessionConfig | None = None
) -> BagRun:
    """Read what a rig needs of a recording; settings None = the defaults.

    Raises:
        InputError: The bag cannot be used.

    """

    def warn(said: str) -> None:
        tell(err, f'warning: {said}')

    with open_recording(path, rig) as recording:
        counted = {'reading': (recording.n_messages, 'messages')}
        for warning in recording.warnings:
            warn(warning)
        session = Session(rig, _config(recording, settings or SessionConfig()))
        with one_bar(err, stop, counted) as progress:
            replay(recording, session, progress=progress, tell=warn)
        problem = recording.source.problem
    if problem:
        tell(err, f'partial data: {problem}')
    return BagRun(path, rig, session, problem, time.time_ns())


def solve_bag(run: BagRun, progress: Callable[[str, float], None]) -> BagRun:
    """Solve what was read; a refusal is kept in what is returned, not raised."""
    try:
        snapshot = run.session.snapshot()
    except CalibrationError as refusal:
        return replace(run, refusal=refusal)
    refused: CalibrationError | None = None
    found: Calibration | None = None
    try:
        found = solve(snapshot, progress=progress)
    except CalibrationError as refusal:
        refused, found = refusal, refusal.calibration
    if found is not None and run.problem:
        warnings = (*found.warnings, f'found from partial data: {run.problem}')
        found = replace(found, warnings=warnings)
    if found is not None and refused is None:
        snapshot = snapshot.settled(found.camera_poses)
    return replace(
        run, snapshot=snapshot, calibration=found, refusal=refused, stamp_ns=time.time_ns()
    )


def chosen(rig: Rig, names: Sequence[str]) -> Rig:
    """Return the rig with the cameras that were asked for.

    Raises:
        InputError: UNKNOWN_CAMERA.

    """
    known = [camera.name for camera in rig.cameras]
    unknown = [name for name in names if name not in known]
    if unknown:
        msg = f'no camera {unknown[0][:80]!r} in the rig file; it has {", ".join(known)}'
        raise InputError(Reason.UNKNOWN_CAMERA, msg)
    if not names:
        return rig
    return replace(rig, cameras=tuple(c for c in rig.cameras if c.name in names))


def tell(console: Console, sentence: str) -> None:
    """Print a sentence with foreign words in it as it is."""
    console.print(sentence, markup=False, highlight=False, soft_wrap=True)


def _config(recording: Recording, settings: SessionConfig) -> SessionConfig:
    n_frames = max(recording.n_messages, BufferConfig().max_frames)
    buffer = BufferConfig(max_frames=n_frames, max_age_s=WHOLE_RECORDING_S)
    return replace(settings, buffer=buffer)
