# SPDX-License-Identifier: Apache-2.0
"""What the node says of itself: /diagnostics for programs, one sentence for people."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from rpgd_ros.core.camera_pose import is_mocap_world
from rpgd_ros.core.result import Calibration
from rpgd_ros.messages import NO_HEADER
from rpgd_ros.pairing import PairCounts
from rpgd_ros.ros.inputs import Health
from rpgd_ros.ros.intake import NOT_COLLECTING
from rpgd_ros.ros.job import Outcome, figures
from rpgd_ros.session import MOCAP, Session
from rpgd_ros.session.guidance import Guidance
from rpgd_ros.session.monitor import Monitor
from rpgd_ros.session.watch import CameraState

OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR

WHO = 'rpgd_calibrator'


def who(namespace: str) -> str:
    """Return whose entries they are: all rigs, each in its namespace, share one /diagnostics."""
    return f'{namespace}/{WHO}'.lstrip('/')


def sign(statuses: Sequence[DiagnosticStatus], namespace: str) -> Sequence[DiagnosticStatus]:
    """Say in each entry whose it is; returns them."""
    for entry in statuses:
        entry.hardware_id = who(namespace)
        entry.name = f'{entry.hardware_id}: {entry.name}'
    return statuses


def status(
    name: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticStatus:
    """Return one entry of /diagnostics.

    Args:
        name: What is spoken of; `sign` puts before it of whom.
        level: OK, WARN or ERROR.
        message: Sentence.
        values: Figures by key.

    """
    return DiagnosticStatus(
        name=name,
        level=level,
        message=message,
        values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
    )


def input_statuses(
    session: Session,
    inputs: Mapping[str, Health],
    monitor: Monitor,
    *,
    is_collecting: bool = True,
) -> list[DiagnosticStatus]:
    """Return the entries of the MoCap system and of every camera.

    Args:
        session: Where the messages went.
        inputs: State of each subscription by stream.
        monitor: What the cameras have seen, and how they fit the published pose.
        is_collecting: Whether messages are stored.

    """
    pairs = session.pair_counts()
    states = monitor.watch.states()
    return [
        _input_status(
            name,
            health,
            session.counts(name),
            pairs.get(name),
            {} if name == MOCAP else _camera_figures(name, monitor, states.get(name)),
            states[name].complaint if name in states else '',
            is_collecting=is_collecting,
        )
        for name, health in inputs.items()
    ]


def _camera_figures(name: str, monitor: Monitor, state: CameraState | None) -> dict[str, object]:
    values: dict[str, object] = {'coverage': monitor.coverage.image(name).share}
    if name in monitor.recent.offsets_s:
        values['time_offset_ms'] = monitor.recent.offsets_s[name] * 1e3
    if state is not None:
        values |= {'error_px': state.error_px, 'accepted_px': state.level_px}
    return values


def _input_status(
    name: str,
    health: Health,
    counts: Mapping[str, int],
    pairs: PairCounts | None,
    figures_of_camera: Mapping[str, object],
    complaint: str,
    *,
    is_collecting: bool,
) -> DiagnosticStatus:
    values: dict[str, object] = {
        'received': health.n_received,
        'rate_hz': health.rate_hz,
        'last_stamp_age_s': health.age_s,
        'msg_type': health.msg_type,
        'qos': health.qos,
        **{key: n for key, n in counts.items() if key != 'received'},
    }
    if pairs is not None:
        values |= {'pairs': pairs.paired, 'no_match': pairs.no_match}
    values |= figures_of_camera
    level, message = OK, 'receiving' if is_collecting else NOT_COLLECTING
    if health.problem:
        # What nobody sends may still come; what cannot be read will not get better by waiting.
        level, message = (ERROR if health.is_hopeless else WARN), health.problem
    elif complaint:
        level, message = WARN, complaint
    elif counts.get(NO_HEADER):
        level, message = WARN, 'messages have no header: stamped with the time of their sending'
    return status(name if name == MOCAP else f'camera {name}', level, message, values)


def calibration_status(
    last: Outcome | None,
    accepted: Calibration | None,
    *,
    age_s: float,
    n_errors: int,
    guidance: Guidance | None = None,
    complaint: str = '',
) -> DiagnosticStatus:
    """Return the entry of the calibration.

    Args:
        last: How the last run ended, None before the first.
        accepted: The calibration of this process that is published, if any.
        age_s: Time since the published pose was found, NaN where none is published.
        n_errors: Exceptions that nobody foresaw.
        guidance: How far the recording is.
        complaint: On cameras that no longer fit the published pose, '' = none.

    """
    values: dict[str, object] = {
        'last_result': 'none yet' if last is None else str(last.reason),
        'solve_ms': math.nan if last is None else last.seconds * 1e3,
        'age_s': age_s,
        'recent_px': math.nan if last is None else last.recent_px,
        'internal_errors': n_errors,
    }
    if accepted is not None:
        values |= figures(accepted)
    if guidance is not None:
        values |= {**guidance.figures(), 'advice': guidance.sentence}
    level, message = _verdict(last, is_published=not math.isnan(age_s))
    if complaint:
        level, message = max(level, WARN), f'{complaint}; {message}'
    if n_errors:
        level, message = max(level, WARN), f'{n_errors} internal errors, see the log; {message}'
    return status('calibration', level, message, values)


def _verdict(last: Outcome | None, *, is_published: bool) -> tuple[bytes, str]:
    if not is_published:
        return ERROR, 'no calibration yet' if last is None else f'no calibration: {last.message}'
    if last is None:
        return OK, 'published from the result file'
    if last.calibration is None:
        return WARN, f'the published pose stays, the last run was refused: {last.message}'
    complaints = ' '.join(filter(None, [last.message, *last.calibration.warnings]))
    return (WARN, complaints) if complaints else (OK, 'calibrated')


def sentence(
    inputs: Sequence[Health],
    last: Outcome | None,
    accepted: Calibration | None,
    *,
    running: str,
    guidance: Guidance,
    complaint: str,
    age_s: float,
    is_collecting: bool = True,
) -> str:
    """Say to the person in the room what is missing and what to do.

    Args:
        inputs: State of each subscription.
        last: How the last run ended, None before the first.
        accepted: The calibration of this process that is published, if any.
        running: What a running solve does, '' without one.
        guidance: How far the recording is.
        complaint: On cameras that no longer fit the published pose, '' = none.
        age_s: Time since the published pose was found, NaN where none is published.
        is_collecting: Whether messages are stored.

    """
    paused = '' if is_collecting else f' {NOT_COLLECTING.capitalize()}.'
    published = '' if math.isnan(age_s) else f' The transform of {age_s:.0f} s ago is published.'
    problems = [health.problem for health in inputs if health.problem]
    if complaint:  # stays while automatic runs come and go
        return f'Attention: {complaint}.{published}{paused}'
    if running:
        return f'Calibrating: {running}.{paused}'
    if paused:
        return f'{paused.lstrip()}{published}'
    if last is not None and last.is_accepted and accepted is not None:
        return f'Calibrated {age_s:.0f} s ago: {in_short(accepted)}.'
    if problems:
        return f'Waiting: {"; ".join(problems)}.{published}'
    if last is not None:
        return f'Not calibrated: {last.message}. {guidance.sentence}.{published}'
    if guidance.motion_m < guidance.needed_motion_m:
        return f'{guidance.sentence}.{published}'
    return f'{guidance.sentence}. Call ~/calibrate, or wait for the next run.{published}'


def in_short(calibration: Calibration) -> str:
    """Return the figures of a calibration that a person wants to hear."""
    poses = calibration.camera_poses
    if is_mocap_world(poses, calibration.covariance):
        worst = max(poses, key=lambda name: poses[name].sigma_position_m)
        return (
            f'{len(poses)} cameras placed in the MoCap frame, {calibration.median_px:.1f} px '
            f'(median), {worst} the least certain: {poses[worst].sigma_rotation_deg:.2f} deg and '
            f'{poses[worst].sigma_position_m * 1e3:.1f} mm'
        )
    return (
        f'{calibration.median_px:.1f} px (median), uncertain by '
        f'{calibration.sigma_rotation_deg:.2f} deg and {calibration.sigma_position_m * 1e3:.1f} mm'
    )


def _text(value: object) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)
