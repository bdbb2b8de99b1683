# SPDX-License-Identifier: Apache-2.0
"""The offline program: the right transform, or the right sentence and exit code."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import yaml
from bags import Message, mcap_bytes, write_bag

from rpgd_ros.apps import calibrate_bag
from rpgd_ros.apps.stopping import EXIT_STOPPED
from rpgd_ros.io.bag import BagWriter, open_bag
from rpgd_ros.io.result_file import read_result
from rpgd_ros.io.rig import read_rig, write_rig
from rpgd_ros.messages import POINT_CLOUD2, encode_point_cloud2
from rpgd_ros.simulation import build_scene, preset, simulate
from rpgd_ros.simulation.export import write_recording


class Walk(NamedTuple):
    """A simulated recording on disk."""

    bag: Path
    rig: Path
    truth: Path


class Outcome(NamedTuple):
    """What a run gave."""

    code: int
    out: str
    err: str


Run = Callable[..., Outcome]
Edit = Callable[[Message], Message | None]


@pytest.fixture(scope='module')
def walk(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """Write a walk of 12 s before four cameras."""
    folder = tmp_path_factory.mktemp('walk')
    write_recording(simulate(build_scene(preset('studio'), 0, seconds=12.0)), folder)
    return Walk(folder / 'bag', folder / 'rig.yaml', folder / 'truth.yaml')


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Return a function that runs the program."""

    def run(*arguments: object) -> Outcome:
        code = calibrate_bag.main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        assert 'Traceback' not in captured.err
        return Outcome(code, captured.out, ' '.join(captured.err.split()))

    return run


def messages_of(bag: Path) -> list[Message]:
    """Read a bag whole."""
    with open_bag(bag) as opened:
        types = {topic: info.msgtype for topic, info in opened.topics.items()}
        return [Message(t, types[t], at, payload) for t, at, payload in opened.stream(types)]


def edited(bag: Path, target: Path, edit: Edit) -> Path:
    """Copy a bag message by message, changed or left out."""
    with BagWriter(target) as writer:
        for message in map(edit, messages_of(bag)):
            if message is not None:
                writer.write(*message)
    return target


def test_the_transform_is_found_and_printed(walk: Walk, run: Run) -> None:
    """Within a millimetre and a hundredth of a degree or two of the truth, in under a second."""
    outcome = run(walk.bag, '--rig', walk.rig)
    assert outcome.code == calibrate_bag.EXIT_ACCEPTED
    truth = yaml.safe_load(walk.truth.read_text())['world_T_mocap']
    for name, expected in (('xyz', truth['xyz']), ('quat_xyzw', truth['quat_xyzw'])):
        label = {'xyz': r't \(x y z\)', 'quat_xyzw': r'q \(x y z w\)'}[name]
        numbers = re.search(rf'{label} +([-\d. ]+)', outcome.out)
        assert numbers is not None
        np.testing.assert_allclose([float(n) for n in numbers[1].split()], expected, atol=2e-3)
    for camera in ('cam0', 'cam1', 'cam2', 'cam3'):
        assert len(re.findall(rf'^{camera} ', outcome.out, re.MULTILINE)) >= 2
    assert 'world <- mocap' in outcome.out


def test_cameras_can_be_left_out(walk: Walk, run: Run) -> None:
    """The others carry the calibration."""
    outcome = run(walk.bag, '--rig', walk.rig, '--cameras', 'cam0', 'cam2')
    assert outcome.code == calibrate_bag.EXIT_ACCEPTED
    assert 'cam1' not in outcome.out


def test_an_unknown_camera_is_bad_input(walk: Walk, run: Run) -> None:
    """Said before the bag is opened, with the names there are."""
    outcome = run('nowhere', '--rig', walk.rig, '--cameras', 'cam7')
    assert outcome.code == calibrate_bag.EXIT_BAD_INPUT
    assert "unknown_camera): no camera 'cam7' in the rig file; it has cam0, cam1" in outcome.err


def test_a_standing_person_is_refused_with_the_reason(tmp_path: Path, run: Run) -> None:
    """The pixels fit, the transform would not."""
    scene = build_scene(preset('studio'), 0, seconds=8.0, motion='still')
    write_recording(simulate(scene), tmp_path)
    outcome = run(tmp_path / 'bag', '--rig', tmp_path / 'rig.yaml')
    assert outcome.code == calibrate_bag.EXIT_REFUSED
    assert 'refused (degenerate_motion)' in outcome.err
    assert 'transform' not in outcome.out


def test_a_cut_bag_is_used_as_far_as_it_goes(walk: Walk, tmp_path: Path, run: Run) -> None:
    """Exit code 3, how much of how much was used, and a warning in the result."""
    bag = tmp_path / 'bag'
    write_bag(bag, messages_of(walk.bag), storage='sqlite3')
    (file,) = bag.glob('*.db3')
    file.write_bytes(file.read_bytes()[: int(0.6 * file.stat().st_size)])
    output = tmp_path / 'result.yaml'
    outcome = run(bag, '--rig', walk.rig, '--output', output)
    assert outcome.code == calibrate_bag.EXIT_PARTIAL
    found = re.search(r'partial data: (\d+) of (\d+) messages: ', outcome.err)
    assert found is not None
    assert 0.3 < int(found[1]) / int(found[2]) < 0.7
    (warning,) = read_result(output).warnings
    assert warning.startswith('found from partial data')


def test_a_bag_without_metadata_is_partial(walk: Walk, tmp_path: Path, run: Run) -> None:
    """The recorder did not finish; what it wrote is used."""
    bag = tmp_path / 'bag'
    bag.mkdir()
    (bag / 'bag_0.mcap').write_bytes(mcap_bytes(messages_of(walk.bag), per_chunk=100))
    outcome = run(bag, '--rig', walk.rig)
    assert outcome.code == calibrate_bag.EXIT_PARTIAL
    assert 'metadata.yaml is missing' in outcome.err


def test_the_result_is_written_and_reads_back(walk: Walk, tmp_path: Path, run: Run) -> None:
    """The file that the node reads; an older one is kept."""
    output = tmp_path / 'result.yaml'
    output.write_text('older')
    outcome = run(walk.bag, '--rig', walk.rig, '--output', output)
    assert outcome.code == calibrate_bag.EXIT_ACCEPTED
    assert f'written to {output}' in outcome.out.replace('\n', '')
    result = read_result(output)
    truth = yaml.safe_load(walk.truth.read_text())['world_T_mocap']
    np.testing.assert_allclose(result.world_T_mocap.translation, truth['xyz'], atol=2e-3)
    assert (result.world_frame, result.mocap_frame) == ('world', 'mocap')
    assert {path.read_text() for path in tmp_path.iterdir()} >= {'older'}


def test_a_folder_that_is_not_there_is_said_before_the_work(
    walk: Walk, tmp_path: Path, run: Run
) -> None:
    """Nobody wants to hear of it after an hour."""
    outcome = run('nowhere', '--rig', walk.rig, '--output', tmp_path / 'a' / 'result.yaml')
    assert outcome.code == calibrate_bag.EXIT_BAD_INPUT
    assert f'(not_writable): {tmp_path / "a"} is no folder' in outcome.err


def test_a_refusal_writes_nothing(walk: Walk, tmp_path: Path, run: Run) -> None:
    """The result of yesterday stays."""
    output = tmp_path / 'result.yaml'
    output.write_text('older')
    bag = edited(walk.bag, tmp_path / 'bag', nan_everywhere)
    assert run(bag, '--rig', walk.rig, '--output', output).code != 0
    assert output.read_text() == 'older'


def nan_everywhere(message: Message) -> Message | None:
    """Make every keypoint missing."""
    if 'keypoints' not in message.topic:
        return message
    values = np.full((17, 2), np.nan)
    return message._replace(
        payload=encode_point_cloud2(message.receive_ns, 'cam', values), msgtype=POINT_CLOUD2
    )


def one_joint_more(message: Message) -> Message | None:
    """Send skeletons of another convention."""
    if 'skeleton' not in message.topic:
        return message
    values = np.ones((99, 3))
    return message._replace(
        payload=encode_point_cloud2(message.receive_ns, 'mocap', values), msgtype=POINT_CLOUD2
    )


def no_skeleton(message: Message) -> Message | None:
    """Leave the skeletons out."""
    return None if 'skeleton' in message.topic else message


def nothing(_message: Message) -> Message | None:
    """Leave everything out."""
    return None


@pytest.mark.parametrize(
    ('edit', 'reason', 'said'),
    [
        (nan_everywhere, 'no_data', ''),
        (one_joint_more, 'no_data', 'wrong_joints'),
        (no_skeleton, 'missing_topic', "looked for '/mocap/skeleton'"),
        (no_skeleton, 'missing_topic', '/cam0/keypoints (sensor_msgs/msg/PointCloud2'),
        (nothing, 'bad_bag', 'holds no messages at all'),
    ],
)
def test_a_bag_that_cannot_be_used_is_bad_input(
    walk: Walk, tmp_path: Path, run: Run, edit: Edit, reason: str, said: str
) -> None:
    """Each fault has its reason, and a sentence that says what to look at."""
    outcome = run(edited(walk.bag, tmp_path / 'bag', edit), '--rig', walk.rig)
    assert outcome.code == calibrate_bag.EXIT_BAD_INPUT
    assert f'bad input ({reason})' in outcome.err
    assert said in outcome.err


def test_a_missing_rig_file_is_bad_input(walk: Walk, tmp_path: Path, run: Run) -> None:
    """The path is named."""
    outcome = run(walk.bag, '--rig', tmp_path / 'rig.yaml')
    assert outcome.code == calibrate_bag.EXIT_BAD_INPUT
    assert str(tmp_path / 'rig.yaml') in outcome.err


def test_missing_intrinsics_are_bad_input(walk: Walk, tmp_path: Path, run: Run) -> None:
    """Neither the rig file nor the bag has them."""
    rig = read_rig(walk.rig)
    blind = replace(rig.cameras[0], camera=None, camera_info_topic='elsewhere')
    write_rig(tmp_path / 'rig.yaml', replace(rig, cameras=(blind, *rig.cameras[1:])))
    outcome = run(walk.bag, '--rig', tmp_path / 'rig.yaml')
    assert outcome.code == calibrate_bag.EXIT_BAD_INPUT
    assert 'bad input (missing_intrinsics): camera cam0' in outcome.err


def test_intrinsics_of_the_bag_give_the_same_transform(
    walk: Walk, tmp_path: Path, run: Run
) -> None:
    """CameraInfo instead of numbers in the rig file."""
    rig = read_rig(walk.rig)
    cameras = [
        replace(c, camera=None, camera_info_topic=f'{c.name}/camera_info') for c in rig.cameras
    ]
    write_rig(tmp_path / 'rig.yaml', replace(rig, cameras=tuple(cameras)))
    outcomes = [run(walk.bag, '--rig', path) for path in (walk.rig, tmp_path / 'rig.yaml')]
    assert outcomes[0].code == outcomes[1].code == 0
    lines = [re.findall(r'(?:t \(x|q \(x).*', outcome.out) for outcome in outcomes]
    assert lines[0] == lines[1]


def test_ros_is_never_imported(walk: Walk) -> None:
    """It runs where ROS was never installed."""
    code = (
        'import sys; from rpgd_ros.apps.calibrate_bag import main; code = main(sys.argv[1:]); '
        "assert not {'rclpy', 'sensor_msgs'} & set(sys.modules); sys.exit(code)"
    )
    command = [sys.executable, '-c', code, str(walk.bag), '--rig', str(walk.rig)]
    subprocess.run(command, check=True, capture_output=True, timeout=60)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_run_at_once(walk: Walk, tmp_path: Path, number: int) -> None:
    """A bag that never ends, here a pipe, is left on the first signal; nothing is written."""
    pipe = tmp_path / 'walk.mcap'
    os.mkfifo(pipe)
    module = [sys.executable, '-m', 'rpgd_ros.apps.calibrate_bag']
    with (
        subprocess.Popen(
            [*module, str(pipe), '--rig', str(walk.rig)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process,
        pipe.open('wb'),
    ):  # waits until the program reads from the other end
        process.send_signal(number)
        out, err = process.communicate(timeout=20)
    assert process.returncode == EXIT_STOPPED
    assert err == 'calibrate_bag: stopped, nothing was written\n'
    assert out == ''
    assert list(tmp_path.iterdir()) == [pipe]
