# SPDX-License-Identifier: Apache-2.0
"""Accepted results: on the output topics, in the result file, and back from it."""

from __future__ import annotations

import math
import time
from pathlib import Path

from rclpy.node import Node

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.result import Calibration
from rpgd_ros.io.atomic import remove_leftovers
from rpgd_ros.io.result_file import read_result, write_result
from rpgd_ros.ros.transforms import Published, TransformOutput
from rpgd_ros.ros.worker import Worker

DEFAULT_FOLDER = Path('~/.ros/rpgd')
DEFAULT_MOCAP_FRAME = 'mocap'  # where neither rig file nor messages name one

Frames = tuple[str, str]


class Results:
    """The published pose and where it is kept.

    Attributes:
        path: Of the result file.
        accepted: The newest calibration of this process, or None.

    """

    def __init__(
        self, node: Node, output: TransformOutput, world_frame: str, result_file: str
    ) -> None:
        """Publish nothing yet.

        Args:
            node: The node.
            output: Where poses go.
            world_frame: Parent frame.
            result_file: Path of the result file; '' = the default for this node's name.

        """
        default = DEFAULT_FOLDER / f'{node.get_name()}.yaml'
        self.path = (Path(result_file) if result_file else default).expanduser()
        self.accepted: Calibration | None = None
        self._node = node
        self._output = output
        self._world_frame = world_frame
        self._frames: Frames = (world_frame, DEFAULT_MOCAP_FRAME)
        self._published: Published | None = None
        self._found_s = math.nan  # of the wall clock: the file outlives the process

    @property
    def pose(self) -> RigidTransform | None:
        """The published pose, or None."""
        return None if self._published is None else self._published.world_T_mocap

    @property
    def age_s(self) -> float:
        """Time since the published pose was found, NaN where none is published."""
        return time.time() - self._found_s

    def frames(self, mocap_frame: str) -> Frames:
        """Return parent and child frame, given the MoCap frame as far as it is known."""
        return self._world_frame, mocap_frame or DEFAULT_MOCAP_FRAME

    def accept(self, calibration: Calibration, frames: Frames) -> None:
        """Publish an accepted calibration."""
        self.accepted, self._frames = calibration, frames
        self._publish(
            frames, calibration.world_T_mocap, calibration.covariance, found_s=time.time()
        )

    def write(self, frames: Frames, worker: Worker, calibration: Calibration) -> None:
        """Write the result file; for the worker's thread.

        Raises:
            InputError: NOT_WRITABLE.

        """
        with worker.uncut():
            _make_folder(self.path.parent)
            write_result(
                self.path,
                calibration,
                world_frame=frames[0],
                mocap_frame=frames[1],
                stamp_ns=time.time_ns(),
            )

    def write_again(self, worker: Worker) -> None:
        """Write the newest accepted calibration again; for the worker's thread.

        Raises:
            InputError: NO_DATA, nothing was accepted since the start; NOT_WRITABLE.

        """
        if self.accepted is None:
            msg = 'nothing to save: no calibration was accepted since the node started'
            raise InputError(Reason.NO_DATA, msg)
        self.write(self._frames, worker, self.accepted)

    def load(self) -> None:
        """Publish what the result file holds.

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
        frames = (stored.world_frame, stored.mocap_frame)
        self._publish(
            frames, stored.world_T_mocap, stored.covariance, found_s=stored.stamp_ns * 1e-9
        )
        self._output.publish_error(stored.mpjpe_px)

    def load_at_start(self) -> None:
        """Publish what the result file holds, if there is one; say so where it is a bad one."""
        remove_leftovers(self.path)
        if not self.path.exists():
            return
        try:
            self.load()
        except InputError as error:
            message = f'nothing is published from the result file: {error.message}'
            self._node.get_logger().warning(message)
        else:
            message = f'published the transform of {self.path}'
            self._node.get_logger().info(message)

    def publish_error(self, error_px: float) -> None:
        """Publish the mean error of the published pose over the newest data, pixels."""
        self._output.publish_error(error_px)

    def _publish(
        self, frames: Frames, world_T_mocap: RigidTransform, covariance: Array, *, found_s: float
    ) -> None:
        self._published = Published(
            world_frame=frames[0],
            mocap_frame=frames[1],
            world_T_mocap=world_T_mocap,
            covariance=covariance,
            stamp_ns=self._node.get_clock().now().nanoseconds,
        )
        self._found_s = found_s
        self._output.publish(self._published)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f'{folder} cannot be made: {error.strerror or error}'
        raise InputError(Reason.NOT_WRITABLE, msg) from error
