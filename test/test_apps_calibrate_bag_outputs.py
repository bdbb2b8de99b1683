# SPDX-License-Identifier: Apache-2.0
"""What `calibrate_bag` writes: page, labels, pictures, film, annotated recording, JSON."""

from __future__ import annotations

import importlib.util
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
import report_cases
import yaml
from bags import Message, write_humble_bag
from numpy.typing import NDArray
from report_images import with_images
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from rpgd_ros.apps import calibrate_bag
from rpgd_ros.core import RigidTransform
from rpgd_ros.io.bag import BagWriter, open_bag
from rpgd_ros.messages import decode_joints

needs_libraries = pytest.mark.skipif(
    not all(map(importlib.util.find_spec, ('plotly', 'jinja2'))), reason='needs the extra report'
)


class Outcome(NamedTuple):
    """What a run gave."""

    code: int
    out: str
    err: str


Run = Callable[..., Outcome]


@pytest.fixture(scope='module')
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a walk whose bag has images of two of the four cameras; return its folder."""
    folder = tmp_path_factory.mktemp('walk')
    report_cases.good(folder)
    (folder / 'bag').rename(folder / 'plain')
    with_images(folder / 'plain', folder / 'bag')
    return folder


@pytest.fixture
def run(walk: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Return a function that runs the program on the walk."""

    def run(*arguments: object, bag: Path | None = None) -> Outcome:
        capsys.readouterr()
        words = [bag or walk / 'bag', '--rig', walk / 'rig.yaml', *arguments]
        code = calibrate_bag.main([str(word) for word in words])
        captured = capsys.readouterr()
        assert 'Traceback' not in captured.err
        return Outcome(code, captured.out, ' '.join(captured.err.split()))

    return run


def truth_of(walk: Path) -> RigidTransform:
    """Read what was simulated."""
    tree = yaml.safe_load((walk / 'truth.yaml').read_text())
    return RigidTransform.from_matrix(tree['world_T_mocap']['matrix'])


@needs_libraries
def test_the_page_shows_instants_on_the_images_of_the_bag(run: Run, tmp_path: Path) -> None:
    """Of the two cameras that have some, a typical and the worst one each."""
    page = tmp_path / 'report.html'
    outcome = run('--report', page)
    assert (outcome.code, f'written to {page}' in outcome.out.replace('\n', '')) == (0, True)
    figures = re.findall(r'data-figure="(camera-\d)-instant-\d+">(.*?)</script>', page.read_text())
    pictured = [key for key, text in figures if json.loads(text)['layout'].get('images')]
    assert sorted(pictured) == ['camera-0', 'camera-0', 'camera-1', 'camera-1']


def test_json_is_all_that_is_printed_and_carries_the_result_file(run: Run, tmp_path: Path) -> None:
    """The documented keys; progress and warnings go elsewhere."""
    output = tmp_path / 'result.yaml'
    outcome = run('--json', '--output', output)
    tree = json.loads(outcome.out)
    assert list(tree) == [
        'schema', 'status', 'exit_code', 'reason', 'message', 'files', 'streams', 'result', 'check'
    ]  # fmt: skip
    assert (tree['schema'], tree['status'], tree['exit_code']) == (1, 'accepted', 0)
    assert tree['files'] == {'output': str(output)}
    assert tree['result'] == yaml.safe_load(output.read_text())
    assert [s['stream'] for s in tree['streams']] == ['mocap', 'cam0', 'cam1', 'cam2', 'cam3']


def test_json_of_bad_input_has_the_reason_and_no_result(run: Run) -> None:
    """Still JSON, and the exit code beside it."""
    outcome = run('--json', bag=Path('nowhere'))
    tree = json.loads(outcome.out)
    assert outcome.code == tree['exit_code'] == 2
    assert (tree['status'], tree['reason'], tree['result']) == ('bad_input', 'bad_bag', None)


def test_labels_are_exported_as_evaluate_does(run: Run, walk: Path, tmp_path: Path) -> None:
    """Joints in the cameras' frames, and COCO."""
    assert run('--export', tmp_path / 'labels').code == 0
    with np.load(tmp_path / 'labels' / 'bag.npz') as arrays:
        np.testing.assert_allclose(arrays['world_T_mocap'], truth_of(walk).matrix, atol=5e-3)
        assert arrays['x_camera_3'].shape[2] == 3
    assert json.loads((tmp_path / 'labels' / 'bag.json').read_text())['annotations']


def test_pictures_hold_the_image_and_both_skeletons(run: Run, tmp_path: Path) -> None:
    """At full size; cameras without images have an empty canvas."""
    folder = tmp_path / 'overlay'
    assert run('--overlay', folder).code == 0
    names = sorted(path.name for path in folder.iterdir())
    assert {name.split('_')[0] for name in names} == {'cam0', 'cam1', 'cam2', 'cam3'}
    on_image, on_canvas = (
        cv2.imread(str(folder / next(n for n in names if n.startswith(c))))
        for c in ('cam0', 'cam2')
    )
    assert on_image is not None
    assert on_canvas is not None
    assert on_image.shape == on_canvas.shape == (1080, 1920, 3)
    assert np.median(on_image) > 60 > np.median(on_canvas)
    for image in (on_image, on_canvas):
        b, g, r = (image[..., i].astype(int) for i in range(3))
        assert ((r > 190) & (b < 60) & (abs(g - 150) < 40)).sum() > 300  # the reprojected bones


def test_a_film_shows_all_cameras_at_the_rate_of_the_recording(run: Run, tmp_path: Path) -> None:
    """One frame for each of the camera that has most."""
    path = tmp_path / 'walk.mp4'
    assert run('--overlay', path).code == 0
    film = cv2.VideoCapture(str(path))
    assert 25.0 < film.get(cv2.CAP_PROP_FPS) < 35.0
    assert abs(film.get(cv2.CAP_PROP_FRAME_COUNT) - 30.0 * report_cases.SECONDS) < 15
    film.set(cv2.CAP_PROP_POS_FRAMES, 100)
    is_there, frame = film.read()
    assert is_there
    assert frame.shape[:2] == (720, 1280)
    assert [path.name for path in tmp_path.iterdir()] == ['walk.mp4']


class Read(NamedTuple):
    """An annotated recording."""

    counts: dict[str, int]
    first: dict[str, tuple[Any, bytes]]
    latched: set[str]


def read_mcap(path: Path) -> Read:
    """Read it with rosbags' own types."""
    types = get_typestore(Stores.ROS2_JAZZY)
    first: dict[str, tuple[Any, bytes]] = {}
    counts: dict[str, int] = {}
    with Reader(path) as reader:
        latched = {
            c.topic
            for c in reader.connections
            for qos in getattr(c.ext, 'offered_qos_profiles', ())
            if qos.durability is QosDurability.TRANSIENT_LOCAL
        }
        for connection, _, data in reader.messages():
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
            if connection.topic not in first:
                first[connection.topic] = types.deserialize_cdr(data, connection.msgtype), data
    return Read(counts, first, latched)


def test_the_annotated_recording_is_the_input_and_the_result(
    run: Run, walk: Path, tmp_path: Path
) -> None:
    """One file; every message of the input is in it, byte for byte, images included."""
    path = tmp_path / 'annotated.mcap'
    assert run('--annotated', path).code == 0
    found = read_mcap(path)
    with open_bag(walk / 'bag') as bag:
        before = {topic: info.n_messages for topic, info in bag.topics.items()}
    assert {topic: found.counts[topic] for topic in before} == before
    assert set(found.counts) - set(before) == {
        '/tf_static', '/rpgd_calibrator/transform', '/rpgd_calibrator/skeleton_world',
        '/rpgd_calibrator/markers', '/rpgd_calibrator/pose', '/rpgd_calibrator/status',
        '/rpgd_calibrator/reprojection_error',
        *(f'/rpgd_calibrator/cam{i}/reprojection' for i in range(4)),
    }  # fmt: skip
    assert {'/tf_static', '/rpgd_calibrator/transform'} <= found.latched
    transform = found.first['/rpgd_calibrator/transform'][0]
    assert (transform.header.frame_id, transform.child_frame_id) == ('world', 'mocap')
    pose = found.first['/rpgd_calibrator/pose'][0]
    assert pose.pose.pose.orientation == transform.transform.rotation
    covariance = np.reshape(pose.pose.covariance, (6, 6))
    np.testing.assert_array_equal(covariance, covariance.T)
    assert 0.0 < np.sqrt(covariance[0, 0]) < 5e-3  # metres: ROS has the translation first
    status = found.first['/rpgd_calibrator/status'][0].data
    assert re.fullmatch(r'Calibrated from the recording: .* px \(median\), .* mm\.', status)
    assert 0.0 < found.first['/rpgd_calibrator/reprojection_error'][0].data < 20.0
    t = transform.transform.translation
    np.testing.assert_allclose([t.x, t.y, t.z], truth_of(walk).translation, atol=5e-3)
    (link,) = found.first['/tf_static'][0].transforms
    assert link.transform == transform.transform
    assert found.counts['/rpgd_calibrator/skeleton_world'] == before['/mocap/skeleton']


def test_reprojections_lie_on_the_keypoints_of_the_same_stamp(run: Run, tmp_path: Path) -> None:
    """In pixels, within the detector's noise; markers stand in the world."""
    path = tmp_path / 'annotated'
    assert run('--annotated', path).code == 0
    assert (path / 'metadata.yaml').exists()
    seen: dict[int, NDArray[np.float64]] = {}
    made: dict[int, NDArray[np.float64]] = {}
    with open_bag(path) as bag:
        topics = {'/cam3/keypoints': (seen, 17), '/rpgd_calibrator/cam3/reprojection': (made, 12)}
        for topic, _, payload in bag.stream(topics):
            store, n_joints = topics[topic]
            batch = decode_joints(
                bag.topics[topic].msgtype, [payload], n_joints=n_joints, n_values=2
            ).batch
            assert batch is not None
            store[int(batch.stamp_ns[0])] = batch.values[0]
    assert len(made) > 0.9 * len(seen)
    assert made.keys() <= seen.keys()
    nearest = [
        np.nanmin(np.linalg.norm(seen[stamp][:, None] - uv[None], axis=-1), axis=0)
        for stamp, uv in made.items()
    ]
    assert np.nanmedian(nearest) < 5.0
    markers = read_mcap(next(path.glob('*.mcap'))).first['/rpgd_calibrator/markers'][0].markers
    assert {m.header.frame_id for m in markers} == {'world'}
    assert {m.text for m in markers} >= {'cam0', 'cam1', 'cam2', 'cam3'}
    assert all(len(m.points) % 2 == 0 for m in markers)


def test_layouts_of_foxglove_and_rviz_find_their_topics_in_an_annotated_recording(
    run: Run, tmp_path: Path
) -> None:
    """But for the diagnostics of a running node; types are those that the panels take."""
    path = tmp_path / 'annotated.mcap'
    assert run('--annotated', path).code == 0
    with open_bag(path) as bag:
        types = {topic: info.msgtype for topic, info in bag.topics.items()}
    config = Path(__file__).resolve().parents[1] / 'config'
    panels = json.loads((config / 'foxglove.json').read_text())['configById']
    paths = [panels['RawMessages!status']['topicPath']]
    paths += [path['value'] for path in panels['Plot!error']['paths']]
    shown = {path.partition('.')[0] for path in paths} | set(panels['3D!rpgd']['topics'])
    displays = yaml.safe_load((config / 'rpgd_ros.rviz').read_text())['Visualization Manager'][
        'Displays'
    ]
    in_rviz = {d['Topic']['Value']: d['Class'] for d in displays if 'Topic' in d}
    assert shown | set(in_rviz) <= set(types)
    for topic, display in in_rviz.items():
        assert (
            types[topic].rpartition('/')[2].removesuffix('Stamped') == display.rpartition('/')[2]
        )


def test_an_annotated_recording_replaces_nothing(run: Run, tmp_path: Path) -> None:
    """Said before the work."""
    path = tmp_path / 'annotated.mcap'
    path.write_text('mine')
    outcome = run('--annotated', path, bag=Path('nowhere'))
    assert outcome.code == calibrate_bag.EXIT_BAD_INPUT
    assert 'exists already' in outcome.err
    assert path.read_text() == 'mine'


def test_an_image_topic_can_be_given_and_a_wrong_one_is_named(run: Run, tmp_path: Path) -> None:
    """With those that there are."""
    outcome = run('--overlay', tmp_path / 'o', '--images', 'cam2=/nowhere')
    assert outcome.code == calibrate_bag.EXIT_BAD_INPUT
    assert "no such image topic; the bag has '/cam0/image_raw/compressed'" in outcome.err
    assert run('--overlay', tmp_path / 'o', '--images', 'cam7=/nowhere').code == 2


def test_topics_of_unknown_types_are_left_out_with_a_word(
    run: Run, walk: Path, tmp_path: Path
) -> None:
    """A bag of Humble has no definitions; what cannot be written is named."""
    with open_bag(walk / 'plain') as bag:
        types = {topic: info.msgtype for topic, info in bag.topics.items()}
        messages = [Message(t, types[t], at, data) for t, at, data in bag.stream(types)]
    odd = Message('/odd', 'odd_msgs/msg/Odd', messages[0].receive_ns, b'\x00\x01\x00\x00')
    write_humble_bag(tmp_path / 'bag', [odd, *messages])
    outcome = run('--annotated', tmp_path / 'a.mcap', bag=tmp_path / 'bag')
    assert outcome.code == 0
    assert "not copied: topic '/odd' has type 'odd_msgs/msg/Odd'" in outcome.err
    counts = read_mcap(tmp_path / 'a.mcap').counts
    assert '/odd' not in counts
    assert counts['/cam0/camera_info'] > 0


@needs_libraries
def test_a_refused_run_writes_its_page_and_nothing_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nobody should use what was found; everybody should see why."""
    report_cases.still(tmp_path)
    words = ['--report', tmp_path / 'r.html', '--output', tmp_path / 'r.yaml', '--json']
    words += ['--annotated', tmp_path / 'a.mcap', '--export', tmp_path / 'labels']
    code = calibrate_bag.main(
        [str(w) for w in (tmp_path / 'bag', '--rig', tmp_path / 'rig.yaml', *words)]
    )
    tree = json.loads(capsys.readouterr().out)
    assert code == tree['exit_code'] == calibrate_bag.EXIT_REFUSED
    assert tree['reason'] == 'degenerate_motion'
    assert tree['files'] == {'report': str(tmp_path / 'r.html')}
    assert {path.name for path in tmp_path.iterdir()} == {
        'bag', 'rig.yaml', 'truth.yaml', 'r.html'
    }  # fmt: skip


def test_a_definition_that_is_not_ours_travels_with_its_topic(tmp_path: Path) -> None:
    """What a bag defines can be copied, whatever package it is of."""
    with BagWriter(tmp_path / 'bag') as writer:
        writer.declare('/odd', 'odd_msgs/msg/Odd', 'std_msgs/Header header\nfloat64 value\n')
        writer.write('/odd', 'odd_msgs/msg/Odd', 1, b'\x00\x01\x00\x00' + bytes(24))
    with open_bag(tmp_path / 'bag') as bag:
        assert 'float64 value' in bag.definitions()['/odd']
        assert [payload for _, _, payload in bag.stream(['/odd'])]
