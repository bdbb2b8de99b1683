# SPDX-License-Identifier: Apache-2.0
"""Skeletons of MoCap drivers, with the habits of each."""

from __future__ import annotations

from typing import Any

import drivers
import numpy as np
import pytest
from drivers import NO_TURN, STAMP_NS, ZEROS

from rpgd_ros.messages import Decoded, decode

HIP, KNEE, ANKLE = (0.1, 0.2, 0.9), (0.1, 0.2, 0.5), (0.1, 0.2, 0.1)
JOINTS = ('hip', 'knee', 'ankle')


def read(*messages: Any, joints: tuple[str, ...] = JOINTS, **keywords: Any) -> Decoded:
    """Decode messages of one type as skeletons."""
    payloads = [drivers.serialise(message) for message in messages]
    arrivals = [STAMP_NS + 1] * len(payloads)
    return decode(
        messages[0].__msgtype__,
        payloads,
        joints=joints,
        n_values=3,
        receive_ns=arrivals,
        **keywords,
    )


def skeleton(decoded: Decoded, row: int = 0) -> Any:
    """Return the (J, 3) joints of one message."""
    assert not decoded.dropped
    assert decoded.batch is not None
    return decoded.batch.values[row]


def bodies(*names: str) -> dict[str, Any]:
    """Return poses of hip, knee and ankle under other names."""
    return {name: (xyz, NO_TURN) for name, xyz in zip(names, (HIP, KNEE, ANKLE), strict=True)}


ALL_NAMED = [
    drivers.markers([drivers.marker(n, x) for n, (x, _) in bodies(*JOINTS).items()]),
    drivers.rigid_bodies(bodies(*JOINTS)),
    drivers.named_poses(bodies(*JOINTS)),
    drivers.link_states(bodies(*JOINTS)),
    drivers.link_states(bodies(*JOINTS), package='xsens_mvn_ros_msgs'),
]
every_named = pytest.mark.parametrize('message', ALL_NAMED, ids=lambda m: m.__msgtype__)


@every_named
@pytest.mark.parametrize('little_endian', [True, False])
def test_joints_are_found_by_their_names(message: Any, little_endian: bool) -> None:  # noqa: FBT001
    """In the order of the rig file, whatever that of the message, in both byte orders."""
    payload = drivers.serialise(message, little_endian=little_endian)
    decoded = decode(
        message.__msgtype__, [payload], joints=('knee', 'ankle', 'hip'), n_values=3, receive_ns=[0]
    )
    np.testing.assert_array_equal(skeleton(decoded), [KNEE, ANKLE, HIP])
    assert decoded.batch is not None
    assert decoded.batch.stamp_ns.tolist() == [STAMP_NS]
    assert decoded.batch.confidence is None


@every_named
def test_a_joint_that_the_message_lacks_is_missing(message: Any) -> None:
    """Lost bodies are left out by some drivers, so that places in the list mean nothing."""
    found = skeleton(read(message, joints=('knee', 'thumb', 'hip')))
    np.testing.assert_array_equal(found, [KNEE, [np.nan] * 3, HIP])


@every_named
def test_names_that_nobody_asked_for_are_wrong_joints(message: Any) -> None:
    """The rig file names another subject, say."""
    assert read(message, joints=('Ann.hip', 'Ann.knee')).dropped == {'wrong_joints': 1}


@every_named
def test_skeletons_are_no_keypoints(message: Any) -> None:
    """A type of 3D joints on a camera's topic is dropped, not read as pixels."""
    payload = drivers.serialise(message)
    decoded = decode(message.__msgtype__, [payload], joints=JOINTS, n_values=2, receive_ns=[0])
    assert decoded.dropped == {'wrong_type': 1}


@pytest.mark.parametrize(
    'message',
    [
        drivers.markers([]),
        drivers.rigid_bodies({}),
        drivers.named_poses({}),
        drivers.link_states({}),
    ],
    ids=lambda m: m.__msgtype__,
)
def test_an_empty_list_means_that_nobody_is_there(message: Any) -> None:
    """Drivers send it while the volume is empty."""
    assert read(message).dropped == {'nobody': 1}


def test_vicon_says_with_zeros_that_a_marker_is_lost() -> None:
    """The driver of mocap4r2 sends (0, 0, 0) of what its system does not see."""
    message = drivers.markers([drivers.marker('hip', (0, 0, 0)), drivers.marker('knee', KNEE)])
    decoded = read(message)
    np.testing.assert_array_equal(skeleton(decoded), [[np.nan] * 3, KNEE, [np.nan] * 3])
    assert decoded.missing == {'nan': 1, 'zero': 1}
    kept = skeleton(read(message, zero_is_missing=False))
    np.testing.assert_array_equal(kept[0], [0.0, 0.0, 0.0])


def test_markers_without_names_are_called_by_their_index() -> None:
    """Qualisys leaves `id_type` at 'name' beside an empty name; OptiTrack says 'index'."""
    message = drivers.markers([
        drivers.marker('', HIP, index=4, id_type=0),
        drivers.marker('', KNEE, index=0, id_type=1),
    ])  # fmt: skip
    np.testing.assert_array_equal(skeleton(read(message, joints=('0', '4'))), [KNEE, HIP])


def test_markers_that_qualisys_leaves_out_do_not_shift_the_others() -> None:
    """A marker that is NaN is not in the list; the index of the others stays."""
    whole = [drivers.marker('', x, index=i) for i, x in enumerate((HIP, KNEE, ANKLE))]
    decoded = read(drivers.markers(whole), drivers.markers(whole[1:]), joints=('0', '1', '2'))
    np.testing.assert_array_equal(skeleton(decoded, 1), [[np.nan] * 3, KNEE, ANKLE])


def test_two_subjects_with_the_same_marker_names_are_several_persons() -> None:
    """The driver does not say whose marker it is: neither can be used."""
    twice = [drivers.marker('hip', HIP), drivers.marker('hip', KNEE)]
    assert read(drivers.markers(twice)).dropped == {'several_persons': 1}
    absent = [drivers.marker('hip', (0, 0, 0)), drivers.marker('hip', KNEE)]
    np.testing.assert_array_equal(skeleton(read(drivers.markers(absent)))[0], KNEE)
    np.testing.assert_array_equal(skeleton(read(drivers.markers(absent[::-1])))[0], KNEE)


def test_a_rigid_body_with_a_quaternion_of_zeros_is_occluded() -> None:
    """Vicon sends it of occluded segments: with zeros for the place, or with an offset's."""
    message = drivers.rigid_bodies({'Bob.hip': (HIP, ZEROS), 'Bob.knee': (KNEE, NO_TURN)})
    found = skeleton(read(message, joints=('Bob.hip', 'Bob.knee')))
    np.testing.assert_array_equal(found, [[np.nan] * 3, KNEE])


@pytest.mark.parametrize('n_bodies', [1, 9, 30])
def test_rigid_bodies_are_read_among_the_markers_that_each_repeats(n_bodies: int) -> None:
    """Names of any length move the markers by any number of bytes, and their padding with them."""
    labelled = [drivers.marker('m' * i, (i, 1.0, 2.0), index=i) for i in range(1, 12)]
    named = {f'{"s" * i}.joint': ((i, 2.0, 3.0), NO_TURN) for i in range(n_bodies)}
    found = skeleton(read(drivers.rigid_bodies(named, labelled), joints=tuple(named)))
    np.testing.assert_array_equal(found, [[i, 2.0, 3.0] for i in range(n_bodies)])


def test_rigid_bodies_may_have_markers_of_their_own() -> None:
    """OptiTrack's driver gives each body the markers that belong to it."""
    message = drivers.rigid_bodies(bodies('1', '2', '3'))
    for i, body in enumerate(message.rigidbodies):
        body.markers = [drivers.marker('', (i, 0, 1), index=i)] * i
    np.testing.assert_array_equal(skeleton(read(message, joints=('3', '1'))), [ANKLE, HIP])


def test_a_pose_without_orientation_is_a_place_all_the_same() -> None:
    """A body of one marker has NaN for its quaternion in motion_capture_tracking."""
    message = drivers.named_poses({'hip': (HIP, (np.nan,) * 4), 'knee': ((np.nan,) * 3, NO_TURN)})
    np.testing.assert_array_equal(skeleton(read(message))[:2], [HIP, [np.nan] * 3])


def test_segments_of_xsens_come_in_any_order() -> None:
    """The driver walks a hash table."""
    poses = bodies(*JOINTS)
    shuffled = dict(reversed(poses.items()))
    decoded = read(drivers.link_states(poses), drivers.link_states(shuffled))
    np.testing.assert_array_equal(skeleton(decoded, 0), skeleton(decoded, 1))


def test_xsens_with_an_empty_outer_header_is_stamped_by_its_segments() -> None:
    """Earlier drivers fill the headers of the segments only."""
    message = drivers.link_states(bodies(*JOINTS), outer=drivers.header(0, ''))
    decoded = read(message)
    assert decoded.batch is not None
    assert decoded.batch.stamp_ns.tolist() == [STAMP_NS]
    nowhere = drivers.link_states(bodies(*JOINTS), stamp_ns=0)
    assert read(nowhere).dropped == {'zero_stamp': 1}
    assert read(nowhere, needs_stamp=False).batch is not None


def test_a_frame_that_changes_is_refused() -> None:
    """Another frame means another transform."""
    other = drivers.named_poses(bodies(*JOINTS), frame_id='other')
    decoded = read(drivers.named_poses(bodies(*JOINTS)), other)
    assert decoded.dropped == {'frame_changed': 1}
    assert read(other, frame_id='map').dropped == {'frame_changed': 1}


@pytest.mark.parametrize('wrong', [np.inf, -np.inf, np.nan, 1e300])
def test_damaged_numbers_are_missing_joints(wrong: float) -> None:
    """The other joints of the message are used."""
    message = drivers.named_poses({'hip': ((0.0, wrong, 1.0), NO_TURN), 'knee': (KNEE, NO_TURN)})
    np.testing.assert_array_equal(skeleton(read(message))[:2], [[np.nan] * 3, KNEE])
