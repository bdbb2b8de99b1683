# SPDX-License-Identifier: Apache-2.0
"""Accepted results: on the output topics, in the result file, and back from it."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from rclpy.node import Node

from rpgd_ros.core.camera_pose import CameraPose
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.result import Calibration
from rpgd_ros.io.atomic import make_folder, remove_leftovers
from rpgd_ros.io.backups import utc
from rpgd_ros.io.frames import Frames
from rpgd_ros.io.result_file import StoredResult, read_result, write_result
from rpgd_ros.ros.transforms import Published, TransformOutput
from rpgd_ros.ros.worker import Worker
from rpgd_ros.session import Snapshot
from rpgd_ros.session.monitor import Appraisal
from rpgd_ros.session.snapshot_file import exchanged

DEFAULT_FOLDER = Path('~/.ros/rpgd')
DEFAULT_MOCAP_FRAME = 'mocap'  # where neither rig file nor messages name one

WITH_DATA = 2  # of them, the newest, keep what they came from: it is what takes memory
MAX_HISTORY = 10  # accepted calibrations of this process that ~/revert can go back through
NS_PER_S = 1_000_000_000


# Writes a page about a result: file, calibration, what it was found from, frames, when. Returns
# why there is none, '' = written. Handed in by the program, so that no node needs plots.
ReportWriter = Callable[[Path, Calibration, Snapshot, Frames, int], str]


class Accepted(NamedTuple):
    """One accepted calibration.

    Attributes:
        calibration: What was found.
        frames: Their names.
        found_ns: When, by the wall clock.
        appraisal: What its data say of it.
        data: What it was found from; None where that is no longer kept.

    """

    calibration: Calibration
    frames: Frames
    found_ns: int
    appraisal: Appraisal | None = None
    data: Snapshot | None = None


class Results:
    """The published pose and where it is kept.

    Attributes:
        path: Of the result file.
        report: Writes a page beside it when asked to save; None = nothing.

    """

    report: ReportWriter | None = None

    def __init__(
        self, node: Node, output: TransformOutput, world_frame: str, result_file: str
    ) -> None:
        """Publish nothing yet.

        Args:
            node: The node.
            output: Where poses go.
            world_frame: Parent frame.
            result_file: Path of the result file; '' = the default for this node.

        """
        # Several rigs run nodes of one name, each in its namespace, and must not share a file.
        default = DEFAULT_FOLDER / f'{node.get_fully_qualified_name().lstrip("/")}.yaml'
        self.path = (Path(result_file) if result_file else default).expanduser()
        self._node = node
        self._output = output
        self._world_frame = world_frame
        self._history: deque[Accepted] = deque(maxlen=MAX_HISTORY)
        self._published: Published | None = None
        self._is_loaded = False  # what is published comes from the file
        self._found_s = math.nan  # of the wall clock: the file outlives the process

    @property
    def accepted(self) -> Calibration | None:
        """The calibration of this process that is published, None where there is none."""
        is_ours = self._history and not self._is_loaded
        return self._history[-1].calibration if is_ours else None

    @property
    def pose(self) -> RigidTransform | None:
        """The published pose, or None."""
        return None if self._published is None else self._published.world_T_mocap

    @property
    def published(self) -> Published | None:
        """What stands on the output topics, or None."""
        return self._published

    @property
    def covariance(self) -> Array | None:
        """Covariance of the published pose, as `Calibration.covariance`; None without one."""
        return None if self._published is None else self._published.covariance

    @property
    def age_s(self) -> float:
        """Time since the published pose was found, NaN where none is published.

        0 where the clock was set back, or the file is of a clock that is ahead.
        """
        return max(time.time() - self._found_s, 0.0)  # NaN stays

    @property
    def camera_poses(self) -> Mapping[str, CameraPose]:
        """Published poses of the cameras that were placed, by camera."""
        return {} if self._published is None else self._published.cameras

    def frames(self, mocap_frame: str, optical: Mapping[str, str]) -> Frames:
        """Return the names of all frames, given the MoCap frame as far as it is known."""
        return Frames(self._world_frame, mocap_frame or DEFAULT_MOCAP_FRAME, optical)

    def accept(
        self,
        calibration: Calibration,
        frames: Frames,
        *,
        appraisal: Appraisal | None = None,
        data: Snapshot | None = None,
    ) -> None:
        """Publish an accepted calibration, and keep what belongs to it."""
        self._history.append(Accepted(calibration, frames, time.time_ns(), appraisal, data))
        if len(self._history) > WITH_DATA:
            old = self._history[-1 - WITH_DATA]
            self._history[-1 - WITH_DATA] = old._replace(data=None)
        self._publish_newest()

    def step_back(self) -> Accepted:
        """Publish the accepted calibration before the published one, which is forgotten.

        Before one from the file that is the newest accepted one.

        Returns:
            What is published now.

        Raises:
            InputError: NO_DATA. There is none of this process.

        """
        if len(self._history) < (1 if self._is_loaded else 2):
            msg = (
                'nothing to go back to: no calibration was accepted before the published one '
                f'since the node started; older ones are the backups beside {self.path}'
            )
            raise InputError(Reason.NO_DATA, msg)
        if not self._is_loaded:
            self._history.pop()
        self._publish_newest()
        return self._history[-1]

    def write(
        self,
        frames: Frames,
        worker: Worker,
        calibration: Calibration,
        appraisal: Appraisal | None,
        *,
        found_ns: int | None = None,
        data: Snapshot | None = None,
    ) -> None:
        """Write the result file, and beside it what it came from; for the worker's thread.

        Args:
            frames: Their names.
            worker: Keeps the process alive meanwhile.
            calibration: What was found.
            appraisal: What its data say of it.
            found_ns: When; None = now.
            data: What it was found from. Without it a file of other data is removed.

        Raises:
            InputError: NOT_WRITABLE. Both files are those of before.

        """
        beside = self.path.with_suffix('.npz')
        with worker.uncut():
            make_folder(self.path.parent)
            with exchanged(beside, data):
                write_result(
                    self.path,
                    calibration,
                    world_frame=frames.world,
                    mocap_frame=frames.mocap,
                    stamp_ns=found_ns or time.time_ns(),
                    optical_frames=frames.optical,
                    levels=appraisal.stored_levels if appraisal else {},
                )

    def write_again(self, worker: Worker) -> None:
        """Write the published calibration again; for the worker's thread.

        Raises:
            InputError: NO_DATA, nothing was accepted since the start, or since what is published
                was loaded; NOT_WRITABLE.

        """
        if self.accepted is None:
            since = f'{self.path} was loaded' if self._is_loaded else 'the node started'
            msg = f'nothing to save: no calibration was accepted since {since}'
            raise InputError(Reason.NO_DATA, msg)
        newest = self._history[-1]
        found, appraisal = newest.calibration, newest.appraisal
        self.write(
            newest.frames, worker, found, appraisal, found_ns=newest.found_ns, data=newest.data
        )
        if self.report is not None and newest.data is not None:
            page = self.path.with_suffix('.html')
            why_not = self.report(
                page, newest.calibration, newest.data, newest.frames, newest.found_ns
            )
            said = f'no report: {why_not}' if why_not else f'the report is in {page}'
            self._node.get_logger().info(said)

    def load(self) -> StoredResult:
        """Publish what the result file holds.

        Returns:
            What it holds.

        Raises:
            InputError: BAD_RESULT_FILE: there is none, it cannot be read, or its frames are not
                those of this rig.

        """
        stored = read_result(self.path)
        if stored.world_frame != self._world_frame:
            msg = (
                f'{self.path} is of world frame {stored.world_frame!r}, this rig has '
                f'{self._world_frame!r}: calibrate anew, or set result_file'
            )
            raise InputError(Reason.BAD_RESULT_FILE, msg)
        frames = Frames(stored.world_frame, stored.mocap_frame, stored.optical_frames)
        self._is_loaded = True
        self._publish(frames, stored, found_ns=stored.stamp_ns)
        self._output.publish_error(stored.mpjpe_px)
        return stored

    def load_at_start(self) -> StoredResult | None:
        """Publish what the result file holds, if there is one; say so where it is a bad one.

        Returns:
            What it holds, None where nothing is published.

        """
        remove_leftovers(self.path)
        if not self.path.exists():
            return None
        try:
            stored = self.load()
        except InputError as error:
            message = f'nothing is published from the result file: {error.message}'
            self._node.get_logger().warning(message)
            return None
        found = utc(round(self._found_s * NS_PER_S))
        message = f'published the transform of {self.path}, found {found}'
        self._node.get_logger().info(message)
        return stored

    def publish_error(self, error_px: float) -> None:
        """Publish the mean error of the published pose over the newest data, pixels."""
        self._output.publish_error(error_px)

    def _publish_newest(self) -> None:
        newest, self._is_loaded = self._history[-1], False
        self._publish(newest.frames, newest.calibration, found_ns=newest.found_ns)

    def _publish(
        self, frames: Frames, found: Calibration | StoredResult, *, found_ns: int
    ) -> None:
        self._published = Published(
            world_frame=frames.world,
            mocap_frame=frames.mocap,
            world_T_mocap=found.world_T_mocap,
            covariance=found.covariance,
            stamp_ns=self._node.get_clock().now().nanoseconds,
            cameras=found.camera_poses,
            optical_frames={name: frames.optical_frame(name) for name in found.camera_poses},
        )
        self._found_s = found_ns / NS_PER_S
        self._output.publish(self._published)
