# SPDX-License-Identifier: Apache-2.0
"""Writes simulated sequences as trees in the layouts of published datasets.

The layouts are described where they are read, in `rpgd_ros.datasets`. What a detector did not
report is NaN in all of them.
"""

from __future__ import annotations

import importlib
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, RigidTransform, so3_log
from rpgd_ros.io.atomic import write_atomic
from rpgd_ros.simulation.dataset_pickle import pickled
from rpgd_ros.simulation.dataset_scenes import TwinPlan, TwinSequence, rig_of, sequences_of

Progress = Callable[[str, float], None]

MM_PER_M, CM_PER_M = 1000.0, 100.0
N_SETTINGS = 9  # of AIST++: so many times its cameras were moved
MICROSECONDS = 1_000_000

H36M_CAMERAS = ('54138969', '55011271', '58860488', '60457274')
H36M_SUBJECTS = (1, 5, 6, 7, 8, 9, 11)
H36M_ACTIONS = (
    'Directions', 'Discussion', 'Eating', 'Greeting', 'Phoning', 'Photo', 'Posing', 'Purchases',
    'Sitting', 'SittingDown', 'Smoking', 'Waiting', 'WalkDog', 'WalkTogether', 'Walking',
)  # fmt: skip
N_H36M_SUBJECTS = 11
CDF_FLOAT = 44
MISSING = "this needs {}, which is not installed: pip install 'rpgd_ros[datasets]'"


def write_twin(plan: TwinPlan, folder: Path, progress: Progress | None = None) -> None:
    """Write the tree of a plan into an existing, empty folder.

    Args:
        plan: What to simulate; its preset decides the layout.
        folder: Where.
        progress: Called with a stage and the fraction of it that is done.

    Raises:
        InputError: A preset that is no dataset's, an optional library that is not installed,
            NOT_WRITABLE.

    """
    if plan.preset.name not in WRITERS:
        msg = f'{plan.preset.name} is no dataset; datasets are {", ".join(WRITERS)}'
        raise InputError(Reason.BAD_INPUT, msg)
    try:
        WRITERS[plan.preset.name](plan, folder, progress)
    except OSError as error:
        msg = f'{folder} cannot be written: {error.strerror or error}'
        raise InputError(Reason.NOT_WRITABLE, msg) from error


def _world_to_camera(camera: Camera) -> RigidTransform:
    return camera.camera_T_world or RigidTransform.identity()


def _write_aistpp(plan: TwinPlan, folder: Path, progress: Progress | None) -> None:
    for name in ('keypoints2d', 'keypoints3d', 'cameras'):
        (folder / name).mkdir()
    mapping = []
    numbered = enumerate(sequences_of(plan, lambda k: rig_of(plan, k % N_SETTINGS), progress))
    for k, sequence in numbered:
        name, setting = f'gBR_sBM_cAll_d04_mBR0_ch{k + 1:02d}', f'setting{k % N_SETTINGS + 1}'
        mapping.append(f'{name} {setting}\n')
        if k < N_SETTINGS:
            cameras = [
                _aistpp_camera(f'c{number:02d}', camera)
                for number, camera in enumerate(sequence.cameras, 1)
            ]
            write_atomic(folder / 'cameras' / f'{setting}.json', json.dumps(cameras))
        x = sequence.x_world * CM_PER_M
        skeletons = pickled({'keypoints3d': x, 'keypoints3d_optim': x})
        write_atomic(folder / 'keypoints3d' / f'{name}.pkl', skeletons)
        keypoints = np.concatenate([sequence.uv, sequence.confidence[..., None]], -1)
        step = MICROSECONDS / plan.preset.camera_hz
        arrays = {
            'keypoints2d': keypoints,
            'det_scores': sequence.confidence.mean(-1),
            'timestamps': np.round(np.arange(len(x)) * step).astype(np.int64),
        }
        write_atomic(folder / 'keypoints2d' / f'{name}.pkl', pickled(arrays))
    write_atomic(folder / 'cameras' / 'mapping.txt', ''.join(mapping))
    write_atomic(folder / 'ignore_list.txt', '')


def _aistpp_camera(name: str, camera: Camera) -> dict[str, Any]:
    camera_T_world = _world_to_camera(camera)
    return {
        'name': name,
        'size': list(camera.size),
        'matrix': camera.matrix.tolist(),
        'rotation': so3_log(camera_T_world.rotation).tolist(),
        'translation': (camera_T_world.translation * CM_PER_M).tolist(),
        'distortions': camera.distortion.tolist(),
    }


def _write_human36m(plan: TwinPlan, folder: Path, progress: Progress | None) -> None:
    try:
        cdfwrite = importlib.import_module('cdflib.cdfwrite')
    except ImportError as error:
        raise InputError(Reason.BAD_INPUT, MISSING.format('cdflib')) from error
    n = len(H36M_SUBJECTS)
    rigs = _h36m_rigs(plan)
    write_atomic(folder / 'metadata.xml', _h36m_metadata(rigs))
    numbered = enumerate(sequences_of(plan, lambda k: rigs[k % n], progress))
    for k, sequence in numbered:
        take, action = divmod(k // n, len(H36M_ACTIONS))
        name = H36M_ACTIONS[action] + (f' {take}' if take else '')
        poses = folder / f'S{H36M_SUBJECTS[k % n]}' / 'MyPoseFeatures'
        for kind in ('D3_Positions', 'D2_Positions'):
            (poses / kind).mkdir(parents=True, exist_ok=True)
        _write_pose(cdfwrite, poses / 'D3_Positions' / f'{name}.cdf', sequence.x_world * MM_PER_M)
        for camera, uv in zip(H36M_CAMERAS, sequence.uv, strict=True):
            _write_pose(cdfwrite, poses / 'D2_Positions' / f'{name}.{camera}.cdf', uv)


def _h36m_rigs(plan: TwinPlan) -> list[tuple[Camera, ...]]:
    """Return a rig per subject: the cameras were hung anew for each, their lenses stayed."""
    first = rig_of(plan, 0)
    rigs = [rig_of(plan, number) for number in range(len(H36M_SUBJECTS))]
    return [
        tuple(
            replace(lens, camera_T_world=camera.camera_T_world)
            for lens, camera in zip(first, rig, strict=True)
        )
        for rig in rigs
    ]


def _write_pose(cdfwrite: ModuleType, path: Path, values: Array) -> None:
    pose = values.reshape(1, len(values), -1).astype(np.float32)
    file = cdfwrite.CDF(path, cdf_spec={'Compressed': 0})
    try:
        spec = {
            'Variable': 'Pose', 'Data_Type': CDF_FLOAT, 'Num_Elements': 1, 'Rec_Vary': True,
            'Dim_Sizes': list(pose.shape[1:]),
        }  # fmt: skip
        file.write_var(spec, var_data=pose)
    finally:
        file.close()


def _h36m_metadata(rigs: list[tuple[Camera, ...]]) -> str:
    """Return the camera parameters; the first rig stands for subjects that nobody filmed."""
    by_subject = dict(zip(H36M_SUBJECTS, rigs, strict=True))
    w0: list[float] = []
    for number, _ in enumerate(H36M_CAMERAS):
        for subject in range(1, N_H36M_SUBJECTS + 1):
            pose = _world_to_camera(by_subject.get(subject, rigs[0])[number])
            place = -pose.rotation.T @ pose.translation * MM_PER_M
            w0 += [*euler_xyz(pose.rotation), *place.tolist()]
    for camera in rigs[0]:
        k1, k2, p1, p2, k3 = camera.distortion.tolist()
        w0 += [*camera.pinhole, k1, k2, k3, p1, p2]
    return f'<metadata><w0>[{" ".join(f"{value:.10g}" for value in w0)}]</w0></metadata>\n'


def euler_xyz(rotation: Array) -> list[float]:
    """Return (a, b, c) of X(a) Y(b) Z(c), radians."""
    r = rotation
    return [
        float(np.arctan2(-r[1, 2], r[2, 2])),
        float(np.arcsin(np.clip(r[0, 2], -1.0, 1.0))),
        float(np.arctan2(-r[0, 1], r[0, 0])),
    ]


def _write_mpi_inf_3dhp(plan: TwinPlan, folder: Path, progress: Progress | None) -> None:
    try:
        scipy_io = importlib.import_module('scipy.io')
    except ImportError as error:
        raise InputError(Reason.BAD_INPUT, MISSING.format('scipy')) from error
    for k, sequence in enumerate(sequences_of(plan, lambda k: rig_of(plan, k), progress)):
        place = folder / f'S{k // 2 + 1}' / f'Seq{k % 2 + 1}'
        place.mkdir(parents=True)
        write_atomic(place / 'camera.calibration', _mpi_calibration(sequence.cameras))
        with io.BytesIO() as file:
            scipy_io.savemat(file, _mpi_annotations(sequence))
            write_atomic(place / 'annot.mat', file.getvalue())


def _mpi_annotations(sequence: TwinSequence) -> dict[str, Any]:
    n_cameras, n_frames = sequence.uv.shape[:2]
    annot2, annot3 = (np.empty((n_cameras, 1), dtype=object) for _ in range(2))
    for v, camera in enumerate(sequence.cameras):
        x_camera = (_world_to_camera(camera) @ sequence.x_world) * MM_PER_M
        annot2[v, 0] = sequence.uv[v].reshape(n_frames, -1)
        annot3[v, 0] = x_camera.reshape(n_frames, -1)
    frames = np.arange(n_frames, dtype=np.float64)[:, None]
    return {'annot2': annot2, 'annot3': annot3, 'univ_annot3': annot3, 'frames': frames}


def _mpi_calibration(cameras: tuple[Camera, ...]) -> str:
    lines = ['Skeletool Camera Calibration File V1.0']
    for number, camera in enumerate(cameras):
        extrinsic = _world_to_camera(camera).matrix
        extrinsic[:3, 3] *= MM_PER_M
        intrinsic = np.eye(4)
        intrinsic[:3, :3] = camera.matrix
        width, height = camera.size
        lines += [
            f'name          {number}',
            '  sensor      10 10',
            f'  size        {width} {height}',
            '  animated    0',
            f'  intrinsic   {_row(intrinsic)}',
            f'  extrinsic   {_row(extrinsic)}',
            '  radial      0',
        ]
    return '\n'.join(lines) + '\n'


def _row(matrix: Array) -> str:
    return ' '.join(f'{value:.10g}' for value in matrix.ravel()) + ' '


WRITERS: Mapping[str, Callable[[TwinPlan, Path, Progress | None], None]] = MappingProxyType(
    {
        'aistpp': _write_aistpp,
        'human36m': _write_human36m,
        'mpi_inf_3dhp': _write_mpi_inf_3dhp,
    }
)
