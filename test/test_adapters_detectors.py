# SPDX-License-Identifier: Apache-2.0
"""Body trackers and detectors, with the habits of each."""

from __future__ import annotations

from typing import Any, Literal

import drivers
import numpy as np
import pytest
from drivers import STAMP_NS

from rpgd_ros.messages import Decoded, decode
from rpgd_ros.messages.adapters.detectors import MAX_BODIES
from rpgd_ros.skeletons import joint_names, landmarks

ARRIVAL_NS = STAMP_NS + 5_000_000
NOT_SEEN = [np.nan, np.nan]


def decode_one(
    payload: bytes, msgtype: str, joints: str, n_values: Literal[2, 3], **keywords: Any
) -> Decoded:
    """Decode one message with the joints of a convention."""
    return decode(
        msgtype, [payload], joints=joint_names(joints), n_values=n_values,
        receive_ns=[ARRIVAL_NS], **keywords,
    )  # fmt: skip


def read(message: Any, joints: str, n_values: Literal[2, 3] = 2, **keywords: Any) -> Decoded:
    """Serialise and decode one message, in both byte orders."""
    little, big = (
        decode_one(
            drivers.serialise(message, little_endian=is_little), message.__msgtype__, joints,
            n_values, **keywords,
        )
        for is_little in (True, False)
    )  # fmt: skip
    assert little.dropped == big.dropped
    if little.batch is not None and big.batch is not None:
        np.testing.assert_array_equal(little.batch.values, big.batch.values)
    return little


def values(decoded: Decoded) -> Any:
    """Return the (J, C) joints of the only message."""
    assert not decoded.dropped
    assert decoded.batch is not None
    return decoded.batch.values[0]


def scores(decoded: Decoded) -> Any:
    """Return the (J,) scores of the only message."""
    assert decoded.batch is not None
    assert decoded.batch.confidence is not None
    return decoded.batch.confidence[0]


def azure(body: int = 1, **keywords: Any) -> list[Any]:
    """Return the 32 markers of a body; each place tells its joint."""
    return [drivers.rviz_marker(body * 100 + j, (j, 0.0, 2.0), **keywords) for j in range(32)]


def test_azure_counts_its_joints_within_each_hundred() -> None:
    """`id = body * 100 + joint`, in any order; the body's number is no person's index."""
    found = values(read(drivers.marker_array(azure(7)[::-1]), 'azure32', 3))
    np.testing.assert_array_equal(found[:, 0], range(32))


def test_azure_has_no_scores() -> None:
    """The type has no place for them."""
    decoded = read(drivers.marker_array(azure()), 'azure32', 3)
    assert decoded.batch is not None
    assert decoded.batch.confidence is None
    assert decoded.batch.frame_id == 'depth_camera_link'
    assert decoded.batch.stamp_ns.tolist() == [STAMP_NS]


def test_azure_sends_an_empty_array_of_an_empty_room() -> None:
    """It has no header, so not even a stamp."""
    assert read(drivers.marker_array([]), 'azure32', 3).dropped == {'nobody': 1}


def test_markers_that_take_others_away_are_no_joints() -> None:
    """RViz displays are cleaned with markers of the actions DELETE and DELETEALL."""
    gone = [
        drivers.rviz_marker(200, (9, 9, 9), action=2),
        drivers.rviz_marker(0, (9, 9, 9), action=3),
    ]
    found = values(read(drivers.marker_array([*azure(), *gone]), 'azure32', 3))
    np.testing.assert_array_equal(found[:, 0], range(32))
    assert read(drivers.marker_array(gone), 'azure32', 3).dropped == {'nobody': 1}


@pytest.mark.parametrize('number', [132, -1, 99])
def test_other_markers_than_a_body_tracker_sends_are_wrong_joints(number: int) -> None:
    """An arrow of some other node is no skeleton."""
    message = drivers.marker_array([*azure(), drivers.rviz_marker(number, (0, 0, 1))])
    assert read(message, 'azure32', 3).dropped == {'wrong_joints': 1}


def test_markers_with_points_texts_and_meshes_are_read_through() -> None:
    """What a marker may carry besides its pose does not confuse the next one."""
    items = azure()
    odd = items[0]
    odd.ns, odd.text, odd.mesh_resource = 'body', 'x' * 7, 'package://a/b.dae'
    odd.points = [drivers.point((1, 2, 3))] * 3
    odd.colors = [odd.color] * 5
    odd.texture.data = np.arange(5, dtype=np.uint8)
    odd.uv_coordinates = [drivers.make('visualization_msgs/msg/UVCoordinate', 0.5, 0.5)] * 2
    odd.mesh_file.data = np.arange(3, dtype=np.uint8)
    found = values(read(drivers.marker_array(items), 'azure32', 3))
    np.testing.assert_array_equal(found[:, 0], range(32))


def test_two_bodies_are_two_skeletons() -> None:
    """Which of them a camera sees is the solver's to find."""
    both = read(drivers.marker_array([*azure(1), *azure(2)]), 'azure32', 3).batch
    assert both is not None
    assert both.others is not None
    assert both.others.shape == (1, 1, 32, 3)


@pytest.mark.parametrize(
    ('joints', 'body_format'), [('openpose18', 0), ('zed34', 1), ('zed38', 2)]
)
@pytest.mark.parametrize('package', ['zed_msgs', 'zed_interfaces'])
def test_zed_gives_both_keypoints_and_skeletons(
    joints: str, body_format: int, package: str
) -> None:
    """The first slots of 70 are the body format's joints; those behind them are zeros."""
    n_joints = len(joint_names(joints))
    uv = np.arange(1.0, 2 * n_joints + 1).reshape(-1, 2)
    xyz = np.arange(1.0, 3 * n_joints + 1).reshape(-1, 3)
    item = drivers.zed_object(uv, xyz, body_format=body_format, package=package, label='Body_12')
    message = drivers.objects([item], package=package)
    np.testing.assert_array_equal(values(read(message, joints, 2)), uv)
    np.testing.assert_array_equal(values(read(message, joints, 3)), xyz)


def test_zed_says_in_two_ways_that_a_joint_was_not_found() -> None:
    """NaN in 3D, zeros or negative numbers in 2D."""
    uv, xyz = np.full((18, 2), 100.0), np.ones((18, 3))
    uv[3], uv[4], xyz[5] = -1.0, 0.0, np.nan
    message = drivers.objects([drivers.zed_object(uv, xyz)])
    assert np.flatnonzero(np.isnan(values(read(message, 'openpose18', 2))).all(1)).tolist() == [
        3,
        4,
    ]
    assert np.flatnonzero(np.isnan(values(read(message, 'openpose18', 3))).any(1)).tolist() == [5]


def test_zed_in_another_body_format_is_wrong_joints() -> None:
    """18 joints read as the first of 34 would be other joints."""
    message = drivers.objects([drivers.zed_object(np.ones((18, 2)), body_format=0)])
    assert read(message, 'zed34').dropped == {'wrong_joints': 1}


def test_zed_objects_without_a_skeleton_are_nobody() -> None:
    """Object detection uses the same type for cars."""
    car = drivers.zed_object(has_skeleton=False, label='Vehicle')
    person = drivers.zed_object(np.full((18, 2), 5.0))
    assert read(drivers.objects([car]), 'openpose18').dropped == {'nobody': 1}
    assert (values(read(drivers.objects([car, person]), 'openpose18')) == 5.0).all()


def test_eyes_and_ears_of_ros4hri_are_not_those_of_openpose() -> None:
    """Both put right before left everywhere else; REP 155 puts the left eye first."""
    hri, openpose = (landmarks(joint_names(name)) for name in ('hri18', 'openpose18'))
    assert hri[14:] == ('left_eye', 'right_eye', 'left_ear', 'right_ear')
    assert openpose[14:] == ('right_eye', 'left_eye', 'right_ear', 'left_ear')
    assert hri[2:14] == openpose[2:14]
    # The neck is computed from the shoulders, so it says nothing that they do not.
    assert hri[1] != openpose[1] == 'neck'


def test_ros4hri_sends_shares_of_the_image() -> None:
    """Not seen is all zero; a place outside the image is the detector's guess."""
    rows = np.full((18, 3), 0.5)
    rows[3], rows[4], rows[5] = 0.0, (1.2, 0.5, 0.9), (0.5, -0.1, 0.9)
    decoded = read(drivers.skeleton_2d(rows), 'hri18')
    found = values(decoded)
    assert np.flatnonzero(np.isnan(found).all(1)).tolist() == [3, 4, 5]
    np.testing.assert_array_equal(found[0], [0.5, 0.5])
    assert scores(decoded)[0] == 0.5
    corner = np.full((18, 3), 0.5)
    corner[0] = 0.0, 0.0, 0.9
    assert not np.isnan(
        values(read(drivers.skeleton_2d(corner), 'hri18', zero_is_missing=False))[0]
    ).any()


def test_ros4hri_has_18_joints() -> None:
    """A rig file that says otherwise would pair the wrong ones."""
    assert read(drivers.skeleton_2d(np.ones((18, 3))), 'coco17').dropped == {'wrong_joints': 1}


@pytest.mark.parametrize('package', ['yolo_msgs', 'yolov8_msgs'])
def test_ids_of_yolo_begin_with_one(package: str) -> None:
    """The nose, index 0, has the id 1; keypoints of a low score are left out."""
    item = drivers.detection({1: (10, 20, 0.9), 17: (30, 40, 0.6)}, package=package, n_border=3)
    decoded = read(drivers.detections([item], package=package), 'coco17')
    found = values(decoded)
    np.testing.assert_array_equal(found[[0, 1, 16]], [[10, 20], NOT_SEEN, [30, 40]])
    np.testing.assert_array_equal(scores(decoded)[[0, 1, 16]], [0.9, np.nan, 0.6])


@pytest.mark.parametrize('number', [0, 18, -5])
def test_an_id_of_yolo_that_no_joint_has_is_wrong_joints(number: int) -> None:
    """A model of other keypoints runs, or a detector that counts from zero."""
    item = drivers.detection({number: (1, 2, 0.5)})
    assert read(drivers.detections([item]), 'coco17').dropped == {'wrong_joints': 1}


def test_detections_without_keypoints_are_no_persons() -> None:
    """A chair beside the person does not make two of them."""
    chair, person = drivers.detection({}, name='chair'), drivers.detection({1: (5, 6, 0.9)})
    np.testing.assert_array_equal(
        values(read(drivers.detections([chair, person]), 'coco17'))[0], [5, 6]
    )
    assert read(drivers.detections([chair]), 'coco17').dropped == {'nobody': 1}
    assert read(drivers.detections([]), 'coco17').dropped == {'nobody': 1}


def test_two_detections_are_two_persons() -> None:
    """Which of them is the subject is the solver's to find."""
    both = [drivers.detection({1: (5, 6, 0.9)}), drivers.detection({1: (50, 60, 0.8)})]
    decoded = read(drivers.detections(both), 'coco17')
    assert decoded.missing == {'nan': 32}
    assert decoded.batch is not None
    values, scores = decoded.batch.take(np.array([0, 1]))
    np.testing.assert_array_equal(values[0, [0, 2]], [[5, 6], [50, 60]])
    assert scores is not None
    np.testing.assert_array_equal(scores[0, [0, 2]], [0.9, 0.8])


def test_depths_beside_the_keypoints_are_read_through() -> None:
    """A depth camera adds them; the next detection begins behind them."""
    both = [
        drivers.detection({1: (5, 6, 0.9)}, n_in_3d=17),
        drivers.detection({2: (7, 8, 0.9)}, n_in_3d=3),
    ]
    decoded = read(drivers.detections(both), 'coco17')
    assert decoded.batch is not None
    values, _ = decoded.batch.take(np.array([0, 1]))
    np.testing.assert_array_equal(values[0, [0, 3]], [[5, 6], [7, 8]])


def test_crowd_of_a_stadium_is_no_subject() -> None:
    """64 persons are taken, one more is several persons too many."""
    rows = np.full((25, 3), 7.0)
    assert not read(drivers.openpose_list([rows] * MAX_BODIES), 'body25').dropped
    many = drivers.openpose_list([rows] * (MAX_BODIES + 1))
    assert read(many, 'body25').dropped == {'several_persons': 1}


def test_openpose_says_with_zeros_that_a_joint_is_missing() -> None:
    """Score included; the others have one."""
    rows = np.full((25, 3), 7.0)
    rows[8] = 0.0
    decoded = read(drivers.openpose_list([rows]), 'body25')
    np.testing.assert_array_equal(values(decoded)[[7, 8]], [[7.0, 7.0], NOT_SEEN])
    assert scores(decoded)[7] == 7.0
    assert decoded.missing == {'zero': 1}


def test_openpose_without_a_header_is_stamped_with_its_arrival() -> None:
    """The type had no header once; that this was done is counted, for people to see."""
    message = drivers.openpose_list([np.full((25, 3), 7.0)])
    payload = drivers.without_header(drivers.serialise(message))
    decoded = decode_one(payload, message.__msgtype__, 'body25', 2)
    assert decoded.batch is not None
    assert decoded.batch.stamp_ns.tolist() == [ARRIVAL_NS]
    assert decoded.missing == {'no_header': 1}
    assert (values(decoded) == 7.0).all()
    nobody = drivers.without_header(drivers.serialise(drivers.openpose_list([])))
    assert decode_one(nobody, message.__msgtype__, 'body25', 2).dropped == {'nobody': 1}


def test_openpose_of_nobody_and_of_another_model() -> None:
    """The list is empty, or has another number of joints than the rig file says."""
    assert read(drivers.openpose_list([]), 'body25').dropped == {'nobody': 1}
    other = drivers.openpose_list([np.ones((18, 3))])
    assert read(other, 'body25').dropped == {'wrong_joints': 1}
    assert not read(other, 'openpose18').dropped


@pytest.mark.parametrize(
    'message',
    [
        drivers.skeleton_2d(np.ones((18, 3))),
        drivers.detections([drivers.detection({1: (1, 2, 0.5)})]),
        drivers.openpose_list([np.ones((18, 3))]),
    ],
    ids=lambda m: m.__msgtype__,
)
def test_keypoints_are_no_skeletons(message: Any) -> None:
    """A type of pixels on the MoCap's topic is dropped."""
    assert read(message, 'openpose18', 3).dropped == {'wrong_type': 1}
