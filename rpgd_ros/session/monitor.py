# SPDX-License-Identifier: Apache-2.0
"""What runs beside the calibrations: guidance before one is accepted, watch over it afterwards."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from rpgd_ros.core.config import AcceptConfig
from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.result import Calibration
from rpgd_ros.core.thin import thin
from rpgd_ros.io.result_file import StoredLevel
from rpgd_ros.session.collect import MOCAP, Session
from rpgd_ros.session.coverage import Coverage
from rpgd_ros.session.expect import Expectation, Expected
from rpgd_ros.session.guidance import Guidance
from rpgd_ros.session.levels import Level, agreed, levels
from rpgd_ros.session.recent import Pairs, Recent
from rpgd_ros.session.snapshot import Snapshot
from rpgd_ros.session.watch import Watch

# Keypoints of a recording that a run is appraised with: 0.1 s beside a solve of seconds.
APPRAISED_POINTS = 200_000


@dataclass(frozen=True, slots=True, eq=False)
class Appraisal:
    """What the data of a run say of the pose that it found.

    Attributes:
        pose: world_T_mocap.
        levels: How the cameras fit it.
        offsets_s: How late each video is stamped, where that was estimated.
        poses: camera_T_world of the optical frames of the cameras that it placed.
        expectation: What it is known to, to be continued.

    """

    pose: RigidTransform
    levels: Mapping[str, Level]
    offsets_s: Mapping[str, float]
    poses: Mapping[str, RigidTransform]
    expectation: Expectation

    @property
    def stored_levels(self) -> dict[str, StoredLevel]:
        """What the result file says of the levels."""
        return {name: level.stored for name, level in self.levels.items()}


def appraise(snapshot: Snapshot, calibration: Calibration) -> Appraisal:
    """Look at the data of a run once more; for the thread of the solve."""
    offsets_s = {name: offset for name, (offset, _) in calibration.time_offset_s.items()}
    settled = snapshot.settled(calibration.camera_poses)
    tracks = tuple(
        replace(track, time_offset_s=offsets_s.get(camera.name, track.time_offset_s))
        for camera, track in zip(settled.cameras, settled.keypoints, strict=True)
    )
    views = replace(settled, keypoints=tracks).observations.views
    pairs = zip(settled.cameras, views, strict=True)
    sights = [Sight(camera, view) for camera, view in pairs if view.n_frames]
    poses = {name: found.camera_T_world for name, found in calibration.camera_poses.items()}
    few = thin(sights, APPRAISED_POINTS)
    pose = calibration.world_T_mocap
    expectation = Expectation(pose, calibration.centroid_mocap)
    n_frames, n_few = (sum(s.view.n_frames for s in part) for part in (sights, few))
    expectation.add_sights(few, weight=n_frames / max(n_few, 1))
    expectation.settle(*calibration.worst_sigma)
    moved = [d.camera for d in calibration.disagreements if d.rival is None]
    return Appraisal(pose, agreed(levels(few, pose), moved), offsets_s, poses, expectation)


class Monitor:
    """Running figures of a session. Belongs to its thread.

    Attributes:
        recent: Where the new pairs come from.
        coverage: What has been seen.
        watch: Over the accepted pose.

    """

    def __init__(self, session: Session, *, max_age_s: float) -> None:
        """Start without a pose.

        Args:
            session: Where the messages are.
            max_age_s: Of the session's buffer.

        """
        self.recent = Recent(session)
        self.coverage = Coverage(max_age_s)
        self.watch = Watch()
        self._session = session
        self._expectation: Expectation | None = None
        self._n_epochs = session.n_epochs
        self._n_cleared = 0
        self._n_looks = 0

    @property
    def recording(self) -> int:
        """Number of the recording: another one after a reset, and after a jump of the clock."""
        return self._session.n_epochs + self._n_cleared

    def resize(self, *, max_age_s: float) -> None:
        """Follow a change of the session's buffer."""
        self.coverage.resize(max_age_s)

    def look(self, *, at_all: bool = True) -> list[Pairs]:
        """Take what came since the last time, and return it.

        Args:
            at_all: At all cameras, else at the next one in turn: one camera takes milliseconds,
                for which no message is taken from the middleware.

        """
        if self._n_epochs != self._session.n_epochs:
            self._n_epochs = self._session.n_epochs
            self._start_over()
        names = [name for name in self._session.streams if name != MOCAP]
        self._n_looks += 1
        pairs = self.recent.take(names if at_all else [names[self._n_looks % len(names)]])
        self.coverage.add(pairs)
        self.watch.add(pairs)
        if self._expectation is not None:
            self._expectation.add(pairs)
        return pairs

    def clear(self) -> None:
        """Forget the recording, as the session does; the pose and its watch stay."""
        self._n_cleared += 1
        self._start_over()

    def conclude(
        self,
        appraisal: Appraisal,
        *,
        is_accepted: bool,
        is_automatic: bool,
        recording: int | None = None,
    ) -> None:
        """Go on from the end of a run.

        Args:
            appraisal: Of the pose that it found.
            is_accepted: Whether that pose is published; the watch is kept over no other.
            is_automatic: Whether nobody asked for the run.
            recording: The `recording` that it was found from; None = the present one.

        """
        is_over = recording not in {None, self.recording}  # and what is known of it forgotten
        expectation = appraisal.expectation
        self._expectation = expectation.emptied() if is_over else expectation
        if is_accepted:
            self.keep_watch(
                appraisal.pose,
                appraisal.levels,
                offsets_s=appraisal.offsets_s,
                poses=appraisal.poses,
                is_automatic=is_automatic,
            )

    def keep_watch(
        self,
        pose: RigidTransform,
        levels: Mapping[str, Level],
        *,
        offsets_s: Mapping[str, float],
        poses: Mapping[str, RigidTransform],
        is_automatic: bool = False,
    ) -> None:
        """Watch a pose from now on; arguments as for `Watch.accept` and `Recent`."""
        self.recent.offsets_s, self.recent.pose = dict(offsets_s), pose
        self.recent.poses = dict(poses)
        self.watch.accept(pose, levels, is_automatic=is_automatic)

    def guidance(self, gates: AcceptConfig, needed_motion_m: float) -> Guidance:
        """Say how far the recording is on its way.

        Args:
            gates: What a calibration must pass.
            needed_motion_m: How far the body must have moved before one is tried, metres.

        """
        cameras = (name for name in self._session.streams if name != MOCAP)
        return Guidance(
            seconds=self.coverage.seconds,
            motion_m=self._session.motion_m(),
            needed_motion_m=max(needed_motion_m, gates.min_motion_m),
            images=tuple(self.coverage.image(name) for name in cameras),
            room=self.coverage.room(),
            expected=Expected() if self._expectation is None else self._expectation.expected(),
            gates=gates,
        )

    def _start_over(self) -> None:
        self.coverage.clear()
        self.watch.restart()
        if self._expectation is not None:
            self._expectation = self._expectation.emptied()
