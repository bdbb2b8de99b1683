# SPDX-License-Identifier: Apache-2.0
"""Skeletons and keypoints in the layouts of other tools, written from arrays."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from rpgd_ros.core.geometry import Array

MOCAP_FPS = 100.0
TRC_KEYS = (
    'DataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame OrigNumFrames'
)


def write_trc(
    path: Path,
    joints: Sequence[str],
    x: Array,
    *,
    units: str = 'm',
    fps: float = MOCAP_FPS,
    time_s: Array | None = None,
) -> None:
    """Write as OpenSim and Pose2Sim do; NaN is an empty cell."""
    n_frames, n_joints = x.shape[:2]
    names = '\t\t\t'.join(joints)
    axes = '\t'.join(f'X{j + 1}\tY{j + 1}\tZ{j + 1}' for j in range(n_joints))
    lines = [
        f'PathFileType\t4\t(X/Y/Z)\t{path.name}',
        TRC_KEYS.replace(' ', '\t'),
        f'{fps:g}\t{fps:g}\t{n_frames}\t{n_joints}\t{units}\t{fps:g}\t1\t{n_frames}',
        f'Frame#\tTime\t{names}\t\t',
        f'\t\t{axes}',
        '',
    ]
    times = np.arange(n_frames) / fps if time_s is None else time_s
    for i, (t, row) in enumerate(zip(times, x.reshape(n_frames, -1), strict=True)):
        cells = ['' if np.isnan(v) else f'{v:.7f}' for v in row]
        lines.append('\t'.join([str(i + 1), f'{t:.6f}', *cells]))
    path.write_text('\n'.join([*lines, '']))


def write_csv(
    path: Path,
    joints: Sequence[str],
    x: Array,
    head: str = '# units: m\n',
    fps: float = MOCAP_FPS,
    start_s: float = 0.0,
) -> None:
    """Write the documented table."""
    header = ','.join(['time', *(f'{j}.{a}' for j in joints for a in 'xyz')])
    rows = [
        ','.join([f'{start_s + i / fps:.4f}', *('' if np.isnan(v) else f'{v:.6f}' for v in row)])
        for i, row in enumerate(x.reshape(len(x), -1))
    ]
    path.write_text(head + '\n'.join([header, *rows, '']))


def write_c3d(
    path: Path, joints: Sequence[str], x: Array, *, units: str = 'm', fps: float = MOCAP_FPS
) -> None:
    """Write with ezc3d, names behind that of a subject; skips the test where it is missing."""
    file = pytest.importorskip('ezc3d').c3d()
    point = file['parameters']['POINT']
    point['UNITS']['value'], point['RATE']['value'] = [units], [fps]
    point['LABELS']['value'] = [f'Anna:{joint}' for joint in joints]
    points = np.ones((4, len(joints), len(x)))
    points[:3] = x.transpose(2, 1, 0)
    file['data']['points'] = points
    file.write(str(path))


# Orders in which programs write the rotations of a joint.
ORDERS = ('ZXY', 'XYZ', 'ZYX', 'YXZ')


def write_bvh(path: Path, joints: Sequence[str], x: Array, fps: float = MOCAP_FPS) -> None:
    """Write a BVH file whose joints are where `x` (T, J, 3) says.

    Half of the joints hang in a chain and half on the root; each turns about as it likes, which
    the positions of its children undo.
    """
    rng = np.random.default_rng(8)
    parents = [-1, *(j - 1 if j % 2 else 0 for j in range(1, len(joints)))]
    angles = rng.uniform(-170.0, 170.0, (len(x), len(joints), 3))
    turns: list[Array] = []
    rows = []
    for j, parent in enumerate(parents):
        turn = np.broadcast_to(np.eye(3), (len(x), 3, 3))
        for letter, angle in zip(ORDERS[j % 4], angles[:, j].T, strict=True):
            turn = turn @ _turns('XYZ'.index(letter), np.radians(angle))
        if parent < 0:
            local = x[:, j]
        else:
            local = np.einsum('tba,tb->ta', turns[parent], x[:, j] - x[:, parent])
            turn = turns[parent] @ turn
        turns.append(turn)
        rows.append(np.concatenate([local, angles[:, j]], 1))
    lines = ['HIERARCHY', *_bvh_joint(joints, parents, 0), 'MOTION', f'Frames: {len(x)}']
    order = _depth_first(parents, 0)
    table = np.concatenate([rows[j] for j in order], 1)
    data = [' '.join(f'{v:.6f}' for v in row) for row in table]
    path.write_text('\n'.join([*lines, f'Frame Time: {1.0 / fps:.8f}', *data, '']))


def _depth_first(parents: Sequence[int], joint: int) -> list[int]:
    children = [j for j, p in enumerate(parents) if p == joint]
    return [joint, *(j for child in children for j in _depth_first(parents, child))]


def _bvh_joint(joints: Sequence[str], parents: Sequence[int], joint: int) -> list[str]:
    rotations = ' '.join(f'{a}rotation' for a in ORDERS[joint % 4])
    offset = '0.0 0.0 0.0' if joint == 0 else '0.1 0.2 0.3'
    children = [j for j, p in enumerate(parents) if p == joint]
    inner = [line for child in children for line in _bvh_joint(joints, parents, child)]
    if not children:
        inner = ['End Site', '{', 'OFFSET 0.0 0.1 0.0', '}']
    return [
        f'{"ROOT" if joint == 0 else "JOINT"} {joints[joint]}',
        '{',
        f'\tOFFSET {offset}',
        f'\tCHANNELS 6 Xposition Yposition Zposition {rotations}',
        *inner,
        '}',
    ]


def _turns(axis: int, angle: Array) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    turn = np.tile(np.eye(3), (len(angle), 1, 1))
    a, b = [(1, 2), (2, 0), (0, 1)][axis]
    turn[:, a, a], turn[:, b, b], turn[:, a, b], turn[:, b, a] = c, c, -s, s
    return turn


def people(uv: Array) -> Array:
    """Return keypoints (..., K, 2) as detectors write them (..., K, 3): 0 0 0 = missing."""
    scores = np.where(np.isfinite(uv).all(-1, keepdims=True), 0.9, 0.0)
    table = np.concatenate([np.nan_to_num(uv, nan=0.0), scores], -1)
    return np.round(table, 4)


def write_openpose(folder: Path, uv: Array, first: int = 0) -> None:
    """Write as OpenPose does: one file per frame, with who stands beside the walker."""
    folder.mkdir(parents=True)
    for i, person in enumerate(people(uv), start=first):
        entry = {'person_id': [-1], 'pose_keypoints_2d': person.ravel().tolist()}
        small = {'person_id': [-1], 'pose_keypoints_2d': (0.5 * person).ravel().tolist()}
        found = [small, entry] if i % 7 == 0 else [entry]
        text = json.dumps({'version': 1.3, 'people': found})
        (folder / f'video_{i:012d}_keypoints.json').write_text(text)


def write_coco(path: Path, uv: Array) -> None:
    """Write as detectors that are evaluated on COCO do: one list for the video."""
    entries = [
        {'image_id': i, 'category_id': 1, 'keypoints': p.ravel().tolist(), 'score': 0.9}
        for i, p in enumerate(people(uv))
    ]
    path.write_text(json.dumps(entries))


def write_labels(path: Path, uv: Array, keypoints: Sequence[str]) -> None:
    """Write as labelling tools do: COCO's annotations, with images and names."""
    table = people(uv)
    images = [{'id': 100 + i, 'file_name': f'frames/{i:06d}.jpg'} for i in range(len(table))]
    annotations = [
        {'id': i, 'image_id': 100 + i, 'category_id': 1, 'keypoints': p.ravel().tolist()}
        for i, p in enumerate(table)
    ]
    categories = [{'id': 1, 'name': 'person', 'keypoints': list(keypoints)}]
    tree = {'images': images, 'annotations': annotations, 'categories': categories}
    path.write_text(json.dumps(tree))


def write_alphapose(path: Path, uv: Array) -> None:
    """Write as AlphaPose does: one list, images by name."""
    entries = [
        {'image_id': f'{i}.jpg', 'category_id': 1, 'keypoints': p.ravel().tolist(), 'score': 2.9}
        for i, p in enumerate(people(uv))
    ]
    path.write_text(json.dumps(entries))


def write_mmpose(path: Path, uv: Array, keypoints: Sequence[str]) -> None:
    """Write as MMPose does for a video: frames with instances, and names."""
    table = people(uv)
    frames = [
        {
            'frame_id': i,
            'instances': [{'keypoints': p[:, :2].tolist(), 'keypoint_scores': p[:, 2].tolist()}],
        }
        for i, p in enumerate(table)
    ]
    meta = {'keypoint_id2name': {str(k): name for k, name in enumerate(keypoints)}}
    path.write_text(json.dumps({'meta_info': meta, 'instance_info': frames}))
