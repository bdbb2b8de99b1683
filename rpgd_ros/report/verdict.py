# SPDX-License-Identifier: Apache-2.0
"""The first line of a report: whether to use the transform, why, and where to look."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

from rpgd_ros.core.agreement import Disagreement
from rpgd_ros.core.camera_pose import is_mocap_world
from rpgd_ros.core.diagnose import MIN_SWAPPED_PAIRS, UNSURE
from rpgd_ros.core.errors import Reason
from rpgd_ros.core.result import Calibration
from rpgd_ros.report.blocks import Link, number, percent
from rpgd_ros.report.measure import Measured, swapped_names

# Hardly anything that a solve then says of clocks and lenses is so: it fitted another thing.
OF_NOTHING = frozenset({
    Reason.TOO_FEW_INLIERS, Reason.SWAPPED_LABELS, Reason.MIRRORED_AXES, Reason.WRONG_UNIT,
})  # fmt: skip
# Share of agreeing keypoints: detectors of the right person have 0.6 to 0.95.
FEW = 0.3
MOST_PAIRS = 3  # named on top of the page
Kind = Literal['accepted', 'warned', 'refused']

HEADLINES = {
    Reason.NO_DATA: 'skeletons and keypoints never came together',
    Reason.TOO_FEW_POINTS: 'there are hardly any keypoints with a skeleton',
    Reason.TOO_FEW_FRAMES: 'the recording is too short',
    Reason.TOO_FEW_INLIERS: 'cameras and MoCap do not show the same person',
    Reason.DEGENERATE_MOTION: 'the person stood still',
    Reason.DEGENERATE_GEOMETRY: 'all joints lie on one line or point',
    Reason.AMBIGUOUS: 'two different transforms explain the recording',
    Reason.UNCERTAIN: 'the recording does not tell the transform well enough',
    Reason.WRONG_UNIT: 'the skeleton has not the size of a person',
    Reason.MIRRORED_AXES: 'the MoCap frame is left-handed',
    Reason.SWAPPED_LABELS: 'left and right are swapped',
    Reason.NO_EXTRINSICS: 'cameras have no place in the world',
    Reason.MISSING_INTRINSICS: 'cameras have no intrinsics',
    Reason.BAD_RIG: 'the rig file does not fit the recording',
    Reason.JUMP: 'the transform is far from the one before',
    Reason.CANCELLED: 'the run was ended before it was done',
}


OF_GATES = frozenset({
    Reason.DEGENERATE_MOTION, Reason.TOO_FEW_INLIERS, Reason.TOO_FEW_FRAMES, Reason.UNCERTAIN,
})  # fmt: skip


class Gate(NamedTuple):
    """One condition of an accepted calibration.

    Attributes:
        name: What is asked.
        found: What was found.
        needed: What was needed.
        is_passed: Whether that is so.

    """

    name: str
    found: str
    needed: str
    is_passed: bool


class Verdict(NamedTuple):
    """What a reader wants to know first.

    Attributes:
        kind: accepted, warned (accepted, but look), or refused.
        headline: One line.
        message: What was found, what was needed, what to do.
        places: What to look at, each with the part of the page that shows it.
        gates: The conditions.

    """

    kind: Kind
    headline: str
    message: str
    places: tuple[Link, ...]
    gates: tuple[Gate, ...]


def judge(measured: Measured) -> Verdict:
    """Put the outcome of a run into words."""
    case = measured.case
    gates = tuple(_gates(measured))
    places = tuple(_places(measured))
    if case.refusal is not None:
        reason = _told_reason(measured, case.refusal.reason)
        headline = f'Refused: {HEADLINES.get(reason, reason.replace("_", " "))}'
        message = _sentence(case.refusal.message)
        if reason is not case.refusal.reason and case.calibration is not None:
            share = percent(case.calibration.inlier_ratio)
            message = f'Only {share} of the keypoints agree with any transform. {message}'
        return Verdict('refused', headline, message, places, gates)
    if case.calibration is None:
        return Verdict('refused', 'Refused: no transform was found', '', places, gates)
    doubts = list(_doubts(measured, case.calibration))
    sigma_deg, sigma_m = case.calibration.worst_sigma
    known = (
        f'The transform is known to {number(sigma_deg, 3)}° and {number(1000 * sigma_m, 1, "mm")} '
        'at the body (one standard deviation).'
    )
    if doubts:
        return Verdict('warned', f'Accepted, but {doubts[0]}', known, places, gates)
    if case.warnings:
        n = len(case.warnings)
        headline = f'Accepted, with {n} warning{"s" if n > 1 else ""}'
        return Verdict('warned', headline, known, places, gates)
    if is_mocap_world(case.calibration.camera_poses, case.calibration.covariance):
        n = len(case.calibration.camera_poses)
        headline = f'Accepted: {n} cameras placed in the MoCap frame, which is the world'
        return Verdict('accepted', headline, '', places, gates)
    headline = f'Accepted: known to {number(sigma_deg, 3)}° and {number(1000 * sigma_m, 1, "mm")}'
    how = (
        f'One standard deviation, at the body. {percent(case.calibration.inlier_ratio)} of '
        f'{case.calibration.correspondences} keypoints in {len(measured.looks)} cameras agree.'
    )
    return Verdict('accepted', headline, how, places, gates)


def _lost(measured: Measured, name: str, share: float) -> str:
    """Say what a camera does whose keypoints are elsewhere in many frames."""
    look = next(look for look in measured.looks if look.camera.name == name)
    if look.shift_px:
        shift = number(look.shift_px, 0, 'px')
        return f'{name} sees everything {shift} beside its place: it may have been moved'
    return f'{name} follows somebody or something else in {percent(share)} of its frames'


def _told_reason(measured: Measured, reason: Reason) -> Reason:
    """Return what lies behind a reason: a pose that hardly anything fits is never well known."""
    c = measured.case.calibration
    if reason in UNSURE and c is not None and c.inlier_ratio < FEW:
        return Reason.TOO_FEW_INLIERS
    return reason


def is_of_nothing(measured: Measured) -> bool:
    """Whether the best pose is none: what was found beside it does not count."""
    refusal = measured.case.refusal
    return refusal is not None and _told_reason(measured, refusal.reason) in OF_NOTHING


def camera_key(measured: Measured, name: str) -> str:
    """Return the key of a camera's section."""
    names = [look.camera.name for look in measured.looks]
    return f'camera-{names.index(name)}' if name in names else 'cameras'


def said_of(disagreement: Disagreement) -> str:
    """Return what a camera says against the others, set for a page."""
    return disagreement.sentence().replace('+-', '±')


def _doubts(measured: Measured, c: Calibration) -> Iterator[str]:
    """Yield what is wrong with an accepted calibration, as the rest of a line."""
    n_swapped = len(swapped_names(measured))
    if n_swapped >= MIN_SWAPPED_PAIRS:
        yield f'left and right are swapped in {n_swapped} pairs of joints'
    for d in c.disagreements:
        when = '' if d.since_s is None else f' at {number(d.since_s, 1, "s")}'
        by = f'by {number(d.rotation_deg)}° and {number(1000 * d.shift_m, 0, "mm")}{when}'
        if d.rival:
            yield f'{d.camera} and {d.rival} contradict each other: one of them was moved'
        elif c.config.rig.on_bumped_camera == 'name':
            yield f'{d.camera} was moved {by}'
        else:
            yield f'without {d.camera}: it was moved {by}'
    if c.drift is not None:
        yield f'the MoCap frame drifts by {number(c.drift.mm_per_min, 0, "mm")} a minute'
    for name, share in measured.lost.items():
        if name not in measured.moved:
            yield _lost(measured, name, share)


def _places(measured: Measured) -> Iterator[Link]:
    """Yield where the page shows what is wrong."""
    case = measured.case
    reason = _told_reason(measured, case.refusal.reason) if case.refusal else None
    if not measured.looks:
        yield Link('What came in, and what became of it', 'streams')
        return
    if reason in {Reason.DEGENERATE_MOTION, Reason.UNCERTAIN, Reason.DEGENERATE_GEOMETRY}:
        walked = number(case.moved_m, 2, 'm')
        yield Link(f'Where the person walked: within {walked}', 'room')
    pairs = swapped_names(measured)
    if reason is Reason.SWAPPED_LABELS or len(pairs) >= MIN_SWAPPED_PAIRS:
        for a, b in pairs[:MOST_PAIRS]:
            yield Link(f'{a} lies where {b} should be, and the other way round', 'joints')
        if len(pairs) > MOST_PAIRS:
            yield Link(f'So do {len(pairs) - MOST_PAIRS} more pairs', 'joints')
    c = case.calibration
    for d in c.disagreements if c else ():
        yield Link(said_of(d), camera_key(measured, d.camera))
    if c is not None and c.drift is not None:
        yield Link('How fast the MoCap frame drifts', 'found')
    for name, share in measured.lost.items():
        if name in measured.moved:
            continue
        warned = [w for w in case.warnings if w.startswith(f'camera {name} follows')]
        text = warned[0] if warned else _lost(measured, name, share)
        yield Link(text, camera_key(measured, name))
    if c is not None and reason is Reason.TOO_FEW_INLIERS:
        yield Link('When which camera agreed', 'time')
        for name, fit in c.per_camera.items():
            text = f'{name}: {percent(fit.inlier_ratio)} of its keypoints agree'
            yield Link(text, camera_key(measured, name))
    if reason in {Reason.NO_DATA, Reason.TOO_FEW_POINTS, Reason.WRONG_UNIT}:
        yield Link('What came in, and what became of it', 'streams')


def _gates(measured: Measured) -> Iterator[Gate]:
    refusal = measured.case.refusal
    if refusal is not None and refusal.reason not in OF_GATES:
        headline = HEADLINES.get(refusal.reason, refusal.reason.replace('_', ' '))
        yield Gate(headline[:1].upper() + headline[1:], 'yes', 'no', is_passed=False)
    c = measured.case.calibration
    if c is None:
        return
    limits = c.config.accept
    moved = measured.case.moved_m
    sigma_deg, sigma_m = c.worst_sigma
    yield Gate(
        'The person walked',
        number(moved, 2, 'm'),
        f'at least {number(limits.min_motion_m, 2, "m")}',
        moved >= limits.min_motion_m,
    )
    yield Gate(
        'Keypoints agree with the transform',
        f'{percent(c.inlier_ratio)} within {number(c.threshold_px, 1, "px")}',
        f'at least {percent(limits.min_inlier_ratio)}',
        c.inlier_ratio >= limits.min_inlier_ratio,
    )
    yield Gate(
        'How many',
        f'{c.inliers} in {c.frames} frames',
        f'at least {limits.min_pairs} in {limits.min_frames} frames',
        c.inliers >= limits.min_pairs and c.frames >= limits.min_frames,
    )
    yield Gate(
        'Rotation is known',
        f'to {number(sigma_deg, 3)}°',
        f'to {number(limits.max_sigma_deg)}° or better',
        sigma_deg <= limits.max_sigma_deg,
    )
    yield Gate(
        'Position is known',
        f'to {number(1000 * sigma_m, 1, "mm")}',
        f'to {number(1000 * limits.max_sigma_m, 0, "mm")} or better',
        sigma_m <= limits.max_sigma_m,
    )


def _sentence(message: str) -> str:
    """Return a message of a program as a sentence."""
    text = message[:1].upper() + message[1:]
    return text if text.endswith('.') else f'{text}.'
