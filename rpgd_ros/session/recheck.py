# SPDX-License-Identifier: Apache-2.0
"""Whether an accepted transform still fits: a later recording against it, without a solve.

Each camera is compared with how it fitted the recording that the transform came from, by the
figures that the watch over the live node goes by, but over the whole recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.core.thin import thin
from rpgd_ros.io.result_file import StoredResult
from rpgd_ros.session.levels import Level, Running, Window, stored_levels, windows
from rpgd_ros.session.monitor import APPRAISED_POINTS
from rpgd_ros.session.snapshot import Snapshot
from rpgd_ros.session.watch import common_complaint, complaint_of

LASTING = 2  # windows up to the end that a camera must be off: one alone comes by chance


@dataclass(frozen=True, slots=True)
class CameraCheck:
    """How one camera fits.

    Attributes:
        name: Its name.
        error_px: Median error, pixels; None where it has seen too little.
        accepted_px: That of the recording which the transform came from; None where that is not
            known.
        limit_px: Error that is too much, pixels; None where none is accepted.
        shift_px: How far the whole body is shifted in its image since then, pixels.
        shift_limit_px: Shift that is too much, pixels.
        fits: Whether it fits; None where it cannot be judged: the result does not know it.
        since_s: From when on it does not, seconds after the begin of the recording; None = all
            the time, or it does.
        complaint: Sentence; '' where it fits.

    """

    name: str
    error_px: float | None = None
    accepted_px: float | None = None
    limit_px: float | None = None
    shift_px: float | None = None
    shift_limit_px: float | None = None
    fits: bool | None = None
    since_s: float | None = None
    complaint: str = ''


@dataclass(frozen=True, slots=True)
class Recheck:
    """What a recording says of a transform.

    Attributes:
        cameras: One by one.
        complaint: What does not fit, in one sentence; '' where everything does.

    """

    cameras: tuple[CameraCheck, ...]
    complaint: str

    @property
    def fits(self) -> bool:
        """Whether all cameras that the result knows still fit."""
        return not self.complaint


def recheck(snapshot: Snapshot, stored: StoredResult, cameras: Sequence[str]) -> Recheck:
    """Compare a recording with a transform that was accepted before.

    Args:
        snapshot: The recording.
        stored: The transform, and how cameras fitted it.
        cameras: Names of those that are asked for, of the snapshot or not.

    """
    sights = _sights(snapshot, stored)
    levels = stored_levels(stored)
    begins = [int(s.view.known_stamp_ns[0]) for s in sights.values()]
    begin_ns = min(begins, default=0)
    checked = tuple(
        _check(name, sights.get(name), levels.get(name), stored, begin_ns) for name in cameras
    )
    return Recheck(checked, _complaint(checked))


def _sights(snapshot: Snapshot, stored: StoredResult) -> dict[str, Sight]:
    """Pair the recording at the clock offsets of the result; by camera, where it sees somebody."""
    worst_s = snapshot.config.time.max_sigma_s  # beyond it, an offset is not applied
    offsets = {
        n: late for n, (late, sigma_s) in stored.time_offset_s.items() if sigma_s <= worst_s
    }
    settled = snapshot.settled(stored.camera_poses)
    tracks = tuple(
        replace(track, time_offset_s=offsets.get(camera.name, track.time_offset_s))
        for camera, track in zip(settled.cameras, settled.keypoints, strict=True)
    )
    views = replace(settled, keypoints=tracks).observations.views
    seen = [
        Sight(camera, view)
        for camera, view in zip(settled.cameras, views, strict=True)
        if view.n_frames and camera.camera_T_world is not None
    ]
    return {s.camera.name: s for s in thin(seen, APPRAISED_POINTS)}


def _check(
    name: str, sight: Sight | None, level: Level | None, stored: StoredResult, begin_ns: int
) -> CameraCheck:
    seen = [] if sight is None else windows(sight, stored.world_T_mocap)
    if level is None:
        return CameraCheck(name, _median(seen).error_px if seen else None)
    known = CameraCheck(
        name, None, level.error_px, level.limit_px, None, level.shift_limit_px, fits=False
    )
    if sight is None or not seen:
        text = (
            f'camera {name} has seen too little of the person with MoCap: is it on, and does it '
            'look into the room?'
        )
        return replace(known, complaint=text)
    whole = _median(seen)
    is_over = np.array([level.strain(w.running) > 1.0 for w in seen])
    n_last = int(np.argmin(is_over[::-1])) if not is_over.all() else len(is_over)
    known = replace(
        known,
        error_px=whole.error_px,
        shift_px=float(np.linalg.norm(whole.shift_px - level.shift_px)),
    )
    is_lasting = n_last >= LASTING and n_last < len(seen)
    if level.strain(whole) <= 1.0 and not is_lasting:
        return replace(known, fits=True)
    now = _median(seen[-n_last:]) if is_lasting else whole
    since_s = (seen[-n_last].begin_ns - begin_ns) / NS_PER_S if is_lasting else None
    text = complaint_of(sight.camera, level, now)
    if since_s is not None:
        text = f'{text} So it is since about {since_s:.0f} s'
    return replace(known, since_s=since_s, complaint=text)


def _median(seen: Sequence[Window]) -> Running:
    return Running(
        float(np.median([w.running.error_px for w in seen])),
        np.median([w.running.shift_px for w in seen], axis=0),
    )


def _complaint(checked: Sequence[CameraCheck]) -> str:
    """One sentence on all cameras that do not fit."""
    known = [c for c in checked if c.fits is not None]
    off = {c.name: c for c in known if not c.fits}
    judged = [c for c in known if c.error_px is not None]
    moved = [c.name for c in judged if not c.fits]
    if len(moved) > 1 and len(moved) > len(judged) / 2:
        blind = [c.complaint for c in off.values() if c.error_px is None]
        return '; '.join([f'{common_complaint(moved)} Calibrate anew', *blind])
    sentences = [c.complaint for c in off.values()]
    if len(moved) == len(judged) == 1:
        sentences.append(
            'one camera alone does not tell its own move from a MoCap that was calibrated again, '
            'another clock or another person'
        )
    return '; '.join(sentences)


def camera_tree(check: CameraCheck) -> Mapping[str, object]:
    """Return a camera's figures by key, for programs."""
    return {name: getattr(check, name) for name in CameraCheck.__slots__ if name != 'name'}
