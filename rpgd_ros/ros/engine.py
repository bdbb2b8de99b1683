# SPDX-License-Identifier: Apache-2.0
"""Runs jobs on a session, one at a time, and publishes what comes out of them."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial
from typing import Any, ParamSpec, TypeVar

from rclpy.node import Node

from rpgd_ros.core.errors import RpgdError
from rpgd_ros.core.result import Calibration
from rpgd_ros.io.result_file import StoredResult
from rpgd_ros.ros.health import in_short
from rpgd_ros.ros.inputs import LOG_SECONDS
from rpgd_ros.ros.job import ACCEPTED, BUSY, SAVING, STOPPING, Outcome, answer, run
from rpgd_ros.ros.results import Results
from rpgd_ros.ros.worker import Worker, attempt, attempt_to_end
from rpgd_ros.session import Session, Snapshot
from rpgd_ros.session.jump import refuse_jump
from rpgd_ros.session.levels import stored_levels
from rpgd_ros.session.monitor import Monitor

T = TypeVar('T')
P = ParamSpec('P')
Serve = Callable[[Any], Awaitable[tuple[bool, str]]]


class Engine:
    """The calibrating part of the node. Everything but the jobs runs in the executor's thread.

    Attributes:
        session: Where the messages went.
        results: What is published.
        monitor: What runs beside the calibrations.
        last: How the last run ended, None before the first since the start or a load.
        running: What it does.
        n_errors: Exceptions that nobody foresaw, each logged.

    """

    def __init__(
        self,
        node: Node,
        session: Session,
        results: Results,
        *,
        monitor: Monitor,
        flush: Callable[[], None],
    ) -> None:
        """Start idle.

        Args:
            node: The node; its executor is where jobs are awaited.
            session: Where the messages go.
            results: Publishes and keeps poses.
            monitor: Guides and watches.
            flush: Hands on to the session what has arrived.

        """
        self.session = session
        self.results = results
        self.monitor = monitor
        self.last: Outcome | None = None
        self.running = ''
        self.n_errors = 0
        self._at_work: Outcome | None = None  # what is answered while a job runs
        self._node = node
        self._flush = flush
        self._worker = Worker()

    @property
    def is_busy(self) -> bool:
        """Whether a job is running."""
        return self._at_work is not None

    async def calibrate(self, *, is_automatic: bool) -> Outcome:
        """Take a snapshot, solve and save in the worker, publish; refused while a job runs.

        Args:
            is_automatic: Whether nobody asked for it: then the published transform may not jump.

        """
        unready = self._unready()
        if unready is not None:
            return unready
        snapshot = attempt(self._snapshot)
        recording = self.monitor.recording
        if isinstance(snapshot, Exception):
            outcome = self._refusal(snapshot)
        else:
            frames = self.results.frames(self.session.mocap_frame, self.session.optical_frames())
            job = partial(
                run,
                snapshot,
                frames,
                self.results.pose,
                published_cameras=self.results.camera_poses,
                check=self._gate(snapshot) if is_automatic else None,
                save=partial(self.results.write, frames, self._worker, data=snapshot),
                progress=self._on_progress,
                should_stop=self._worker.should_stop,
            )
            ended = await self._in_worker(job, meanwhile=BUSY)
            outcome = self._refusal(ended) if isinstance(ended, Exception) else ended
        data = None
        if outcome.is_accepted and isinstance(snapshot, Snapshot):
            # A copy has none of the pairs that the solve has made: they take most memory.
            data = replace(snapshot.alone())
        if outcome.appraisal is not None:
            self.monitor.conclude(
                outcome.appraisal,
                is_accepted=outcome.is_accepted,
                is_automatic=is_automatic,
                recording=recording,
            )
        self._conclude(outcome, data)
        return outcome

    async def save(self) -> tuple[bool, str]:
        """Write the newest accepted calibration again.

        Returns:
            Whether it was written, and what to answer.

        """
        unready = self._unready()
        if unready is not None:
            return False, answer(unready)
        job = partial(self.results.write_again, self._worker)
        ended = await self._in_worker(job, meanwhile=SAVING)
        return self._told(ended, f'saved to {self.results.path}')

    async def revert(self) -> tuple[bool, str]:
        """Publish and save the accepted calibration before the published one.

        Returns:
            Whether that could be done, and what to answer.

        """
        unready = self._unready()
        if unready is not None:
            return False, answer(unready)
        ended = attempt(self.results.step_back)
        if isinstance(ended, Exception):
            return self._told(ended, '')
        back, found = ended.appraisal, ended.calibration
        # What was said of the run that is taken back is not true of this one.
        self.last = Outcome(
            ACCEPTED, '', ended.frames, calibration=found, recent_px=found.mpjpe_px, appraisal=back
        )
        self.results.publish_error(found.mpjpe_px)
        if back is not None:
            self.monitor.keep_watch(
                back.pose, back.levels, offsets_s=back.offsets_s, poses=back.poses
            )
        is_saved, message = await self.save()
        return is_saved, 'the previous calibration is published and saved' if is_saved else message

    async def load(self) -> tuple[bool, str]:
        """Publish what the result file holds.

        Returns:
            Whether that could be done, and what to answer.

        """
        unready = self._unready()
        if unready is not None:
            return False, answer(unready)
        ended = attempt(self.results.load)
        if isinstance(ended, StoredResult):
            self.last = None  # it speaks of a pose that is no longer published
            self.watch_stored(ended)
        return self._told(ended, f'published from {self.results.path}')

    def watch_stored(self, stored: StoredResult) -> None:
        """Keep watch over a pose from a result file."""
        self.monitor.keep_watch(
            stored.world_T_mocap,
            stored_levels(stored),
            offsets_s={name: offset_s for name, (offset_s, _) in stored.time_offset_s.items()},
            poses={name: found.camera_T_world for name, found in stored.camera_poses.items()},
        )

    def guarded(self, callback: Callable[P, None]) -> Callable[P, None]:
        """Keep the node alive whatever a callback raises: log it, count it and go on."""

        def call(*args: P.args, **keywords: P.kwargs) -> None:
            raised = attempt(partial(callback, *args, **keywords))
            if isinstance(raised, Exception):
                self._refusal(raised)

        return call

    def guarded_to_end(
        self, callback: Callable[[], Awaitable[None]]
    ) -> Callable[[], Awaitable[None]]:
        """Guard a callback that awaits something; see `guarded`."""

        async def call() -> None:
            raised = await attempt_to_end(callback())
            if isinstance(raised, Exception):
                self._refusal(raised)

        return call

    def service(self, serve: Serve) -> Callable[[Any, Any], Awaitable[Any]]:
        """Make a callback of a service of what says, given a request, success and message.

        Whatever that raises is logged, counted and answered, and the node lives on.
        """

        async def call(request: Any, response: Any) -> Any:
            ended = await attempt_to_end(serve(request))
            if isinstance(ended, Exception):
                ended = False, answer(self._refusal(ended))
            response.success, response.message = ended
            return response

        return call

    def request_stop(self) -> None:
        """Ask a running job to end; no other one is begun."""
        self._worker.request_stop()

    def join(self) -> None:
        """Wait for a file that is being written."""
        self._worker.join()

    def _unready(self) -> Outcome | None:
        """Return why nothing can be begun now, None where something can."""
        return STOPPING if self._worker.should_stop() else self._at_work

    async def _in_worker(self, job: Callable[[], T], *, meanwhile: Outcome) -> T | Exception:
        self._at_work = meanwhile
        try:
            ended: T | Exception = await self._worker.start(job, self._node.executor)
        finally:
            self._at_work, self.running = None, ''
        return ended

    def _snapshot(self) -> Snapshot:
        self._flush()
        return self.session.snapshot()

    def _on_progress(self, stage: str, fraction: float) -> None:
        self.running = f'{stage} {fraction:.0%}'

    def _told(self, ended: object, done: str) -> tuple[bool, str]:
        if isinstance(ended, Exception):
            return False, answer(self._refusal(ended))
        return True, done

    def _refusal(self, error: Exception) -> Outcome:
        """Return what is to be said of an exception; log those that nobody foresaw."""
        if isinstance(error, RpgdError):
            return Outcome(error.reason, error.message)
        self.n_errors += 1
        message = f'internal error, please report it: {type(error).__name__}: {error}'
        self._node.get_logger().error(message, throttle_duration_sec=LOG_SECONDS)
        return Outcome('internal_error', message)

    def _gate(self, snapshot: Snapshot) -> Callable[[Calibration], None] | None:
        """Return what refuses a jump of the published pose, None without one."""
        pose, covariance = self.results.pose, self.results.covariance
        if pose is None or covariance is None:
            return None
        return partial(
            refuse_jump, published=pose, covariance=covariance, gates=snapshot.config.accept
        )

    def _conclude(self, outcome: Outcome, data: Snapshot | None) -> None:
        before, self.last = self.last, outcome
        log = self._node.get_logger()
        if outcome.calibration is not None:
            self.results.accept(
                outcome.calibration, outcome.frames, appraisal=outcome.appraisal, data=data
            )
            message = f'calibrated: {in_short(outcome.calibration)}'
            log.info(message)
            if outcome.message:
                log.error(outcome.message)
        elif before is None or before.reason != outcome.reason:
            message = f'not calibrated ({outcome.reason}): {outcome.message}'
            log.warning(message)
        if not math.isnan(outcome.recent_px):
            self.results.publish_error(outcome.recent_px)
