# SPDX-License-Identifier: Apache-2.0
"""What the node says of itself, and what it answers, without a running node."""

from __future__ import annotations

import json
import math
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from ros_scene import make_scene
from scenes import mpjpe_px

from rpgd_ros.core import Calibration, InputError, Observations, Reason, RigidTransform
from rpgd_ros.core.config import AcceptConfig
from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.io.frames import Frames
from rpgd_ros.io.rig import read_rig
from rpgd_ros.ros import health
from rpgd_ros.ros.inputs import Health
from rpgd_ros.ros.job import ACCEPTED, BUSY, Outcome, answer, recent_error_px, run
from rpgd_ros.ros.worker import Worker, attempt
from rpgd_ros.session import Session, Snapshot, solve
from rpgd_ros.session.coverage import ImageCoverage, RoomCoverage
from rpgd_ros.session.expect import Expected
from rpgd_ros.session.guidance import Guidance
from rpgd_ros.session.monitor import Appraisal

FRAMES = Frames('studio', 'vicon')
FINE = Health(
    problem='',
    is_hopeless=False,
    msg_type='sensor_msgs/msg/PointCloud2',
    qos='RELIABLE',
    n_received=100,
    rate_hz=50.0,
    age_s=0.1,
)


@pytest.fixture(scope='module')
def snapshot(tmp_path_factory: pytest.TempPathFactory) -> Snapshot:
    """Return eight seconds of a walk before four cameras."""
    walk = make_scene(tmp_path_factory.mktemp('walk'))
    session = Session(read_rig(walk.rig))
    for topic, stream in session.topics().items():
        payloads = [payload for name, _, payload in walk.messages if name == topic]
        session.add(stream, walk.topics[topic], payloads, [0] * len(payloads))
    return session.snapshot()


@pytest.fixture(scope='module')
def calibration(snapshot: Snapshot) -> Calibration:
    """Return an accepted calibration."""
    return solve(snapshot)


def end(
    snapshot: Snapshot,
    save: Callable[[Calibration, Appraisal], None],
    *,
    published: RigidTransform | None = None,
    should_stop: Callable[[], bool] = bool,
) -> Outcome:
    """Run the job of the worker."""
    return run(
        snapshot,
        FRAMES,
        published,
        save=save,
        progress=lambda _stage, _fraction: None,
        should_stop=should_stop,
    )


def strict(snapshot: Snapshot) -> Snapshot:
    """Return a snapshot that cannot be accepted."""
    return replace(snapshot, config=snapshot.config.with_stage('accept', min_pairs=10**9))


def drop(_calibration: Calibration, _appraisal: Appraisal) -> None:
    """Save nothing."""


def test_answer_of_an_accepted_run_is_one_line_with_every_digit(calibration: Calibration) -> None:
    """A program reads back the very floats that are published."""
    line = answer(Outcome(ACCEPTED, '', FRAMES, 0.5, calibration, 2.0))
    assert '\n' not in line
    read = json.loads(line)
    assert read['xyz'] == calibration.world_T_mocap.translation.tolist()
    assert read['quat_xyzw'] == calibration.world_T_mocap.quat_xyzw.tolist()
    assert (read['world_frame'], read['mocap_frame']) == FRAMES[:2]
    assert read['inliers'] == calibration.inliers


def test_answer_holds_no_nan(calibration: Calibration) -> None:
    """JSON has none: a camera that saw nothing has a null error."""
    name, fit = next(iter(calibration.per_camera.items()))
    blind = {**calibration.per_camera, name: replace(fit, mpjpe_px=math.nan)}
    line = answer(Outcome(ACCEPTED, '', FRAMES, 0.5, replace(calibration, per_camera=blind)))
    assert 'NaN' not in line
    assert json.loads(line)['cameras'][name]['mpjpe_px'] is None


def test_answer_of_a_refused_run_is_reason_and_message() -> None:
    """Nothing else that could be taken for a pose."""
    assert json.loads(answer(BUSY)) == {'reason': 'busy', 'message': BUSY.message}


def test_result_that_cannot_be_saved_is_accepted_all_the_same(snapshot: Snapshot) -> None:
    """The disk is full: the transform is published, and the answer says what is wrong."""

    def save(_found: Calibration, _appraisal: Appraisal) -> None:
        raise InputError(Reason.NOT_WRITABLE, 'No space left on device')

    outcome = end(snapshot, save)
    assert outcome.is_accepted
    assert 'No space left on device' in outcome.message


def test_refused_run_measures_the_pose_that_stays(
    snapshot: Snapshot, calibration: Calibration
) -> None:
    """Drift shows on ~/reprojection_error although every new run is refused."""
    pose = calibration.world_T_mocap
    outcome = end(strict(snapshot), drop, published=pose)
    assert not outcome.is_accepted
    # The walk is shorter than the window of the newest data.
    expected = mpjpe_px(snapshot.cameras, snapshot.observations, pose)
    assert outcome.recent_px == pytest.approx(expected)
    assert math.isnan(end(strict(snapshot), drop).recent_px)


def test_error_of_the_published_pose_is_of_the_newest_data(
    snapshot: Snapshot, calibration: Calibration
) -> None:
    """A camera bumped a minute ago is not hidden behind the good hours before."""
    views = tuple(
        replace(
            view,
            stamp_ns=np.arange(view.n_frames, dtype=np.int64) * NS_PER_S,
            uv=view.uv + 100.0 * (np.arange(view.n_frames) >= view.n_frames - 10)[:, None, None],
        )
        for view in snapshot.observations.views
    )
    moved = replace(snapshot)
    moved.__dict__['observations'] = Observations(views)  # where the cached property keeps them
    assert recent_error_px(moved, calibration.world_T_mocap) > 90.0


def test_run_that_is_stopped_saves_nothing(snapshot: Snapshot) -> None:
    """Not even when the stop comes after the last step of the solve."""
    saved: list[Calibration] = []
    outcome = end(snapshot, lambda found, _: saved.append(found), should_stop=lambda: True)
    assert outcome.reason == Reason.CANCELLED
    assert not saved


def test_run_that_is_stopped_before_its_save_writes_nothing(snapshot: Snapshot) -> None:
    """The process may be gone before the file is whole: `join` found no writer."""
    worker = Worker()

    def save(_found: Calibration, _appraisal: Appraisal) -> None:
        worker.request_stop()
        worker.join()
        with worker.uncut():
            pytest.fail('went on to write')

    outcome = end(snapshot, save, should_stop=worker.should_stop)
    assert outcome.reason == Reason.CANCELLED
    assert outcome.calibration is None


def guidance(**changes: Any) -> Guidance:
    """Return what is to be said after 41 s of walking, before anybody knows how exact it is."""
    nothing_seen = np.zeros((9, 16), np.bool_)
    usual: dict[str, Any] = {
        'seconds': 41.0,
        'motion_m': 2.0,
        'needed_motion_m': 1.0,
        'images': (ImageCoverage('cam0', ~nothing_seen, 900),),
        'room': RoomCoverage(2.0, (3.0, 1.0)),
        'expected': Expected(),
        'gates': AcceptConfig(),
    }
    return Guidance(**{**usual, **changes})


def test_sentence_tells_what_to_do_next(calibration: Calibration) -> None:
    """From nothing connected to calibrated, in the order in which a person meets them."""

    def told(inputs: list[Health], last: Outcome | None, **state: Any) -> str:
        usual = {'running': '', 'guidance': guidance(), 'complaint': '', 'age_s': math.nan}
        found = last.calibration if last else None
        return health.sentence(inputs, last, found, **{**usual, **state})

    silent = FINE._replace(problem='nobody publishes /cam0/keypoints')
    refused = Outcome(Reason.UNCERTAIN, 'sigma 3.0 deg, need 1.0')
    accepted = Outcome(ACCEPTED, '', FRAMES, 0.1, calibration, 2.0)
    assert told([FINE, silent], None) == 'Waiting: nobody publishes /cam0/keypoints.'
    still = guidance(motion_m=0.2)
    assert (
        told([FINE], None, guidance=still)
        == 'Walk through the room: moved 0.2 of 1.0 m; 41 of 60 s.'
    )
    assert 'Call ~/calibrate' in told([FINE], None)
    assert told([FINE], None, running='start 40%') == 'Calibrating: start 40%.'
    assert told([FINE], refused).startswith('Not calibrated: sigma 3.0 deg, need 1.0. ')
    assert '41 of 60 s' in told([FINE], refused)
    assert told([FINE], refused, age_s=60.0).endswith('The transform of 60 s ago is published.')
    assert told([FINE], accepted, age_s=5.0).startswith('Calibrated 5 s ago: ')
    bumped = told([FINE], accepted, age_s=5.0, complaint='camera cam2 is off by 9.0 px')
    assert bumped.startswith('Attention: camera cam2 is off by 9.0 px.')
    paused = told([silent], accepted, age_s=5.0, is_collecting=False)
    assert paused.startswith('Not collecting: call ~/set_enabled to go on. The transform of 5 s')
    beside_a_run = told([FINE], accepted, running='start 40%', complaint='camera cam2 is off')
    assert beside_a_run.startswith('Attention: ')


def test_complaint_of_the_watch_is_a_warning(calibration: Calibration) -> None:
    """Beside an accepted run, and before everything else that is said of it."""
    last = Outcome(ACCEPTED, '', FRAMES, 0.1, replace(calibration, warnings=()), 2.0)
    entry = health.calibration_status(
        last, last.calibration, age_s=1.0, n_errors=0, guidance=guidance(), complaint='cam2 moved'
    )
    assert entry.level == health.WARN
    assert entry.message.startswith('cam2 moved')
    values = {pair.key: pair.value for pair in entry.values}
    assert values['recorded_s'] == '41'
    assert values['wanted_s'] == '60'
    assert {'coverage', 'progress', 'expected_sigma_rotation_deg', 'advice'} <= set(values)


@pytest.mark.parametrize(
    ('last', 'age_s', 'n_errors', 'level'),
    [
        (None, math.nan, 0, health.ERROR),
        (None, 60.0, 0, health.OK),
        (None, 60.0, 2, health.WARN),
        (Outcome(Reason.UNCERTAIN, 'sigma'), math.nan, 0, health.ERROR),
        (Outcome(Reason.UNCERTAIN, 'sigma'), 60.0, 0, health.WARN),
    ],
)
def test_level_of_the_calibration_follows_what_is_published(
    last: Outcome | None, age_s: float, n_errors: int, level: bytes
) -> None:
    """No pose is an error; a refusal beside a published pose is a warning."""
    entry = health.calibration_status(last, None, age_s=age_s, n_errors=n_errors)
    assert entry.level == level
    assert entry.message


def test_warnings_of_a_calibration_reach_the_diagnostics(calibration: Calibration) -> None:
    """The camera that disagrees is named where operators look."""
    suspicious = replace(calibration, warnings=('camera cam2 disagrees with the others',))
    last = Outcome(ACCEPTED, '', FRAMES, 0.1, suspicious, 2.0)
    entry = health.calibration_status(last, suspicious, age_s=1.0, n_errors=0)
    assert (entry.level, entry.message) == (health.WARN, suspicious.warnings[0])
    assert {'mpjpe_px', 'sigma_rotation_deg', 'solve_ms'} <= {pair.key for pair in entry.values}


def test_process_waits_for_a_file_that_is_being_written() -> None:
    """The solve may be left behind, the save may not."""
    worker = Worker()
    begun, may_end, is_written = threading.Event(), threading.Event(), threading.Event()

    def write() -> None:
        with worker.uncut():
            begun.set()
            may_end.wait(10.0)
            is_written.set()

    worker.start(write, None)
    assert begun.wait(10.0)
    threading.Timer(0.5, may_end.set).start()
    worker.request_stop()
    worker.join()
    assert is_written.is_set()


def test_job_that_ends_its_thread_is_an_error_of_its_own() -> None:
    """A library may call sys.exit: a node that waited for an answer would be busy for ever."""
    is_done = threading.Event()
    ended = Worker().start(sys.exit, None)
    ended.add_done_callback(lambda _: is_done.set())
    assert is_done.wait(10.0)
    assert isinstance(ended.result(), RuntimeError)


def test_attempt_returns_what_was_raised() -> None:
    """The node lives on whatever a job raises."""
    assert attempt(lambda: 3) == 3
    assert isinstance(attempt(lambda: 1 // 0), ZeroDivisionError)
