# SPDX-License-Identifier: Apache-2.0
"""Joint conventions are the published ones, and joints find each other by landmark."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rpgd_ros.core import InputError, Reason
from rpgd_ros.skeletons import (
    CONVENTIONS,
    EDGES,
    edges,
    joint_names,
    landmarks,
    match_joints,
    mirror,
)

SIZES = {
    'coco17': 17,
    'body25': 25,
    'halpe26': 26,
    'h36m17': 17,
    'h36m32': 32,
    'mpi28': 28,
    'kinect20': 20,
    'azure32': 32,
    'mediapipe33': 33,
    'plug_in_gait': 12,
    'openpose18': 18,
    'hri18': 18,
    'zed34': 34,
    'zed38': 38,
    'xsens23': 23,
}
# Indices that the publications' own code uses.
PUBLISHED = {
    'coco17': {'nose': 0, 'left_eye': 1, 'right_ear': 4, 'left_hip': 11, 'right_ankle': 16},
    'body25': {
        'Neck': 1,
        'RWrist': 4,
        'MidHip': 8,
        'LHip': 12,
        'REye': 15,
        'LHeel': 21,
        'RHeel': 24,
    },
    'halpe26': {'LEye': 1, 'Head': 17, 'Neck': 18, 'Hip': 19, 'LBigToe': 20, 'RSmallToe': 23},
    'h36m17': {'RHip': 1, 'LHip': 4, 'Thorax': 8, 'Head': 10, 'LShoulder': 11, 'RWrist': 16},
    'h36m32': {
        'RightUpLeg': 1,
        'LeftUpLeg': 6,
        'Spine1': 12,
        'Neck': 13,
        'LeftArm': 17,
        'RightHand': 27,
    },
    'mpi28': {
        'spine4': 1,
        'pelvis': 4,
        'head_top': 7,
        'left_shoulder': 9,
        'right_shoulder': 14,
        'left_hip': 18,
        'right_hip': 23,
    },
    'kinect20': {'HIP_CENTER': 0, 'HEAD': 3, 'HAND_LEFT': 7, 'HIP_LEFT': 12, 'FOOT_RIGHT': 19},
    'azure32': {'NECK': 3, 'CLAVICLE_RIGHT': 11, 'HIP_LEFT': 18, 'HEAD': 26, 'EYE_RIGHT': 30},
    'mediapipe33': {
        'left_eye_outer': 3,
        'mouth_right': 10,
        'left_thumb': 21,
        'right_hip': 24,
        'right_foot_index': 32,
    },
    'plug_in_gait': {'LHipJC': 0, 'RWristJC': 11},
    'openpose18': {'Neck': 1, 'RHip': 8, 'REye': 14, 'LEye': 15, 'REar': 16, 'LEar': 17},
    'hri18': {'NECK': 1, 'RIGHT_HIP': 8, 'LEFT_EYE': 14, 'RIGHT_EYE': 15, 'RIGHT_EAR': 17},
    'zed34': {'NECK': 3, 'RIGHT_CLAVICLE': 11, 'LEFT_HIP': 18, 'HEAD': 26, 'RIGHT_HEEL': 33},
    'zed38': {'NECK': 4, 'LEFT_SHOULDER': 12, 'RIGHT_HIP': 19, 'RIGHT_HEEL': 29},
    'xsens23': {'pelvis': 0, 'right_upper_arm': 8, 'left_hand': 14, 'left_toe': 22},
}

every_convention = pytest.mark.parametrize('convention', CONVENTIONS)


def pairs_by_name(mocap: str, keypoints: str) -> dict[str, str]:
    """Return keypoint -> MoCap joint as paired between two conventions."""
    m, k = CONVENTIONS[mocap], CONVENTIONS[keypoints]
    return {k[b]: m[a] for a, b in match_joints(m, k)}


def test_conventions_have_their_published_joints() -> None:
    """Each has its number of joints, none twice, and known ones at their published index."""
    assert {name: len(joints) for name, joints in CONVENTIONS.items()} == SIZES
    for convention, known in PUBLISHED.items():
        joints = CONVENTIONS[convention]
        assert len(set(joints)) == len(joints)
        assert {name: joints.index(name) for name in known} == known


def test_human36m_17_is_the_known_selection_of_the_32() -> None:
    """The indices 0 1 2 3 6 7 8 12 13 14 15 17 18 19 25 26 27 are the same landmarks."""
    chosen = [0, 1, 2, 3, 6, 7, 8, 12, 13, 14, 15, 17, 18, 19, 25, 26, 27]
    marks = landmarks(CONVENTIONS['h36m32'])
    assert [marks[j] for j in chosen] == list(landmarks(CONVENTIONS['h36m17']))


def test_mpi_17_is_the_known_selection_of_the_28() -> None:
    """The dataset's relevant joints are the same landmarks as Human3.6M's limbs."""
    chosen = [14, 15, 16, 9, 10, 11, 23, 24, 25, 18, 19, 20]
    marks = landmarks(CONVENTIONS['mpi28'])
    limbs = [14, 15, 16, 11, 12, 13, 1, 2, 3, 4, 5, 6]
    assert [marks[j] for j in chosen] == [landmarks(CONVENTIONS['h36m17'])[j] for j in limbs]


@every_convention
def test_landmarks_are_unique_within_a_convention(convention: str) -> None:
    """No two joints of one skeleton are the same point of the body."""
    marks = landmarks(CONVENTIONS[convention])
    assert None not in marks
    assert len(set(marks)) == len(marks)


@every_convention
def test_mirror_swaps_the_sides_and_is_its_own_inverse(convention: str) -> None:
    """Left joints go to right ones, middle joints stay."""
    joints = CONVENTIONS[convention]
    image = mirror(joints)
    assert [image[j] for j in image] == list(range(len(joints)))
    marks = landmarks(joints)
    for j, mark in enumerate(marks):
        sided = str(mark).startswith(('left_', 'right_'))
        assert (image[j] != j) == sided


@every_convention
def test_bones_join_the_skeleton(convention: str) -> None:
    """Every joint is in a bone, no bone comes twice, and mirrored bones are bones."""
    joints = CONVENTIONS[convention]
    bones = EDGES[convention]
    assert bones == edges(joints)
    assert {j for bone in bones for j in bone} == set(range(len(joints)))
    unordered = {frozenset(bone) for bone in bones}
    assert len(unordered) == len(bones)
    image = mirror(joints)
    missing = {b for b in unordered if frozenset(image[j] for j in b) not in unordered}
    assert len(missing) <= 2  # a drawing may cross the middle on one side only


@every_convention
def test_convention_pairs_with_itself_completely(convention: str) -> None:
    """A dataset whose 2D is projected 3D has every joint on both sides."""
    joints = CONVENTIONS[convention]
    assert match_joints(joints, joints) == tuple((j, j) for j in range(len(joints)))


@pytest.mark.parametrize('keypoints', ['coco17', 'body25', 'halpe26', 'mediapipe33'])
@pytest.mark.parametrize('mocap', CONVENTIONS)
def test_every_mocap_pairs_its_limbs_with_every_detector(mocap: str, keypoints: str) -> None:
    """Shoulders, elbows, wrists, hips, knees and ankles are found in all conventions."""
    marks = landmarks(CONVENTIONS[mocap])
    paired = {marks[j] for j, _ in match_joints(CONVENTIONS[mocap], CONVENTIONS[keypoints])}
    limbs = ('shoulder', 'elbow', 'wrist', 'hip', 'knee', 'ankle')
    assert {f'{side}_{limb}' for side in ('left', 'right') for limb in limbs} <= paired


def test_plug_in_gait_pairs_with_coco_as_people_would() -> None:
    """The example of the documentation."""
    pairs = pairs_by_name('plug_in_gait', 'coco17')
    assert pairs['left_hip'] == 'LHipJC'
    assert pairs['right_wrist'] == 'RWristJC'
    assert len(pairs) == 12


def test_bones_of_human36m_are_paired_by_their_upper_end() -> None:
    """LeftArm begins at the shoulder; LeftShoulder is the collar bone and pairs with nothing."""
    pairs = pairs_by_name('h36m32', 'body25')
    assert pairs['LShoulder'] == 'LeftArm'
    assert pairs['LAnkle'] == 'LeftFoot'
    assert pairs['Neck'] == 'Neck'
    assert 'LeftShoulder' not in pairs.values()


def test_different_points_of_one_name_are_not_paired() -> None:
    """Human3.6M's Neck is the jaw, OpenPose's lies between the shoulders."""
    assert pairs_by_name('h36m17', 'body25')['Neck'] == 'Thorax'
    assert 'HIP_CENTER' not in pairs_by_name('kinect20', 'body25').values()


@pytest.mark.parametrize(
    ('names', 'marks'),
    [
        (['LHJC', 'RKJC', 'LAJC', 'C7'], ('left_hip', 'right_knee', 'left_ankle', None)),
        (['l_hip', 'HIP_RIGHT', 'leftKnee', 'T10'], ('left_hip', 'right_hip', 'left_knee', None)),
        (['LeftUpLeg', 'LeftShoulder', 'LeftUpArm'], ('left_hip', None, 'left_shoulder')),
        (['RightUpperArm', 'RightShoulder', 'L5'], ('right_shoulder', None, None)),
        (['LeftShoulder', 'LeftElbow'], ('left_shoulder', 'left_elbow')),
        (['Neck', 'LHip'], (None, 'left_hip')),
    ],
)
def test_landmarks_are_read_from_names(names: list[str], marks: tuple[str | None, ...]) -> None:
    """Common spellings are known; what could mean two things means nothing."""
    assert landmarks(names) == marks


def test_part_of_a_convention_is_read_by_it() -> None:
    """A detector that sends 21 of Halpe's joints keeps their meaning."""
    names = ['RHip', 'LHip', 'Head', 'Neck', 'LBigToe']
    assert landmarks(names) == ('right_hip', 'left_hip', 'head_top', 'neck', 'left_big_toe')


def test_unknown_names_pair_where_both_sides_agree() -> None:
    """Markers that a program of one's own tracks in both."""
    names = ['helmet', 'left glove', 'right glove']
    assert match_joints(names, names[::-1]) == ((2, 0), (1, 1), (0, 2))


def test_joint_map_goes_before_landmarks() -> None:
    """It adds, replaces and removes pairs; keypoints go by name or landmark."""
    mocap = ['A', 'B', 'LHipJC', 'RHipJC', 'LKneeJC']
    body25 = CONVENTIONS['body25']
    pairs = match_joints(mocap, body25, {'Nose': 'A', 'left_hip': 'B', 'RHip': None})
    named = {body25[k]: mocap[j] for j, k in pairs}
    assert named == {'Nose': 'A', 'LHip': 'B', 'LKnee': 'LKneeJC'}


def test_joint_map_takes_a_joint_from_its_landmark() -> None:
    """A joint given to another keypoint is no longer paired by itself."""
    mocap = ['LHipJC', 'RHipJC', 'LKneeJC', 'RKneeJC']
    pairs = match_joints(mocap, CONVENTIONS['coco17'], {'nose': 'LHipJC'})
    assert (0, 0) in pairs
    assert all(j != 0 for j, k in pairs if k != 0)


@pytest.mark.parametrize(
    ('joint_map', 'message'),
    [
        ({'left_hipp': 'A'}, r"no keypoint 'left_hipp', did you mean left_hip\?"),
        ({'left_hip': 'LHipC'}, r"no MoCap joint 'LHipC', did you mean LHipJC\?"),
        ({'left_hip': 'A', 'right_hip': 'A'}, 'second pair'),
        ({'zzz' * 60: 'A'}, r'no keypoint .{70,90}\.\.\.'),
        (None, r'2 joints .* need 3\. Give joint_map.*A, B'),
    ],
)
def test_maps_that_cannot_be_are_named(joint_map: dict[str, str | None], message: str) -> None:
    """The message says which name, and the nearest one that exists."""
    mocap = ['A', 'B', 'LHipJC', 'RHipJC']
    with pytest.raises(InputError, match=message) as refused:
        match_joints(mocap, CONVENTIONS['coco17'], joint_map)
    assert refused.value.reason is Reason.BAD_RIG


@pytest.mark.parametrize(
    ('found', 'message'),
    [
        ('coco_17', r'did you mean coco17\?'),
        ('xyz', 'known: coco17'),
        ([], '1 to 256'),
        ([f'joint{i}' for i in range(257)], '1 to 256'),
        (['a', 'b', 'a'], "'a' comes twice, at 0 and 2"),
        (['a', False], 'joint 1 is False'),
        (['a', ' '], "joint 1 is ' '"),
        (17, 'got 17'),
        ({'a': 1}, 'need the name'),
    ],
)
def test_joint_lists_that_cannot_be_are_named(found: object, message: str) -> None:
    """The message says what was found, and what is needed."""
    with pytest.raises(InputError, match=message) as refused:
        joint_names(found)
    assert refused.value.reason is Reason.BAD_RIG


def test_names_and_lists_are_taken() -> None:
    """A convention by name, or a list as it stands."""
    assert joint_names('kinect20')[0] == 'HIP_CENTER'
    assert joint_names(['b', 'a']) == ('b', 'a')


def test_custom_lists_get_the_bones_they_have() -> None:
    """Known landmarks are joined, unknown joints are left alone."""
    assert set(edges(['LAJC', 'x', 'LKJC', 'LHJC'])) == {(2, 0), (3, 2)}
    assert mirror(['LAJC', 'x', 'RAJC']) == (2, 1, 0)


@settings(derandomize=True, max_examples=100)
@given(st.lists(st.text(min_size=1, max_size=12), min_size=1, max_size=20, unique=True))
def test_any_names_can_be_asked_for(names: list[str]) -> None:
    """No name of a message makes the functions fail; indices stay in range."""
    assert len(landmarks(names)) == len(mirror(names)) == len(names)
    assert all(0 <= j < len(names) for j in mirror(names))
    assert all(a != b for a, b in edges(names))
