# SPDX-License-Identifier: Apache-2.0
"""Human3.6M: marker-based MoCap and four cameras with distortion, 50 frames per second.

The layout is that of its own archives, unpacked side by side:

    metadata.xml                                            camera parameters, of its code release
    S*/MyPoseFeatures/D3_Positions/<action>.cdf             Pose (1, T, 96), millimetres, world
    S*/MyPoseFeatures/D2_Positions/<action>.<camera>.cdf    Pose (1, T, 64), pixels

The element w0 of metadata.xml has 300 numbers: for each camera and each of 11 subjects three
angles of R = X(a) Y(b) Z(c) and the camera's place T in millimetres, x_camera = R (x_world - T);
then for each camera f (2), c (2), k (3), p (2). k and p are taken for OpenCV's k1 k2 k3 and p1 p2.
The dataset's own projection leaves out OpenCV's factor 2 of the tangential terms, which is 0.3
pixels at the edge of the image.

The dataset's own pose is the identity, so each sequence is moved first, see `drawn_pose`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import Array
from rpgd_ros.datasets.files import (
    numbers,
    read_by_library,
    read_text,
    require_folder,
    require_library,
    undamaged,
)
from rpgd_ros.datasets.sequence import (
    DatasetSequence,
    camera_from_file,
    check_name,
    refusal,
    sequence_from_world,
    sequence_names,
)
from rpgd_ros.skeletons import joint_names

FPS = 50.0
M_PER_MM = 0.001
JOINTS = joint_names('h36m32')
# In the order of metadata.xml. Two of the cameras record two lines more.
SIZES = {
    '54138969': (1000, 1002),
    '55011271': (1000, 1000),
    '58860488': (1000, 1000),
    '60457274': (1000, 1002),
}
N_SUBJECTS = 11
N_EXTRINSICS, N_INTRINSICS = 6, 9
W0_LENGTH = len(SIZES) * (N_SUBJECTS * N_EXTRINSICS + N_INTRINSICS)
PUBLISHED = ('S1', 'S5', 'S6', 'S7', 'S8', 'S9', 'S11')
MAX_CDF_BYTES = 64 * 2**20  # the longest action takes 3 MiB
CHILD = Path(__file__).with_name('cdf_child.py')
D3 = Path('MyPoseFeatures') / 'D3_Positions'
D2 = Path('MyPoseFeatures') / 'D2_Positions'


@dataclass(frozen=True, slots=True)
class Human36m:
    """A folder of Human3.6M.

    Attributes:
        folder: That holds metadata.xml and the subjects.
        names: `<subject>/<action>`.

    """

    folder: Path
    names: tuple[str, ...]

    @classmethod
    def open(cls, folder: Path, *, is_published: bool = False) -> Human36m:
        """List the sequences.

        Args:
            folder: Where.
            is_published: Whether to keep to the publication's subjects.

        Raises:
            InputError: Not such a folder.

        """
        require_folder(folder)
        found = [path for path in folder.glob(f'S*/{D3}/*.cdf') if path.stem[0] != '_']
        subjects = {f'S{number}' for number in range(1, N_SUBJECTS + 1)}
        wanted = set(PUBLISHED) if is_published else subjects
        pairs = sorted((_subject(path), path.stem) for path in found)
        names = (f'{subject}/{action}' for subject, action in pairs if subject in wanted)
        return cls(folder, sequence_names(folder, names))

    def read(self, name: str) -> DatasetSequence:
        """Read one sequence; see `Dataset`."""
        check_name(name, self.names)
        metadata, skeletons, *views = self.files(name)
        cameras = read_cameras(metadata, int(name.partition('/')[0].removeprefix('S')))
        first, *others = _poses((skeletons, *views))
        x_world = _table(skeletons, first, 3, M_PER_MM)
        uv = np.empty((len(cameras), *x_world.shape[:2], 2))
        for row, path, values in zip(uv, views, others, strict=True):
            keypoints = _table(path, values, 2)
            if keypoints.shape != row.shape:
                counts = f'{len(keypoints)} frames, but D3_Positions has {len(x_world)}'
                raise refusal(path, counts)
            row[:] = keypoints
        return sequence_from_world(name, cameras, x_world, uv, fps=FPS, joint_names=JOINTS)

    def files(self, name: str) -> tuple[Path, ...]:
        """Return camera parameters, 3D, and 2D per camera; see `Dataset`."""
        subject, action = name.split('/')
        place = self.folder / subject
        views = (place / D2 / f'{action}.{camera}.cdf' for camera in SIZES)
        return (self.folder / 'metadata.xml', place / D3 / f'{action}.cdf', *views)

    def objection(self, sequence: DatasetSequence) -> str:
        """Leave no sequence out; see `Dataset`."""
        del sequence
        return ''


def _subject(path: Path) -> str:
    return path.parents[2].name


def read_cameras(path: Path, subject: int) -> tuple[Camera, ...]:
    """Read the cameras as they hung for a subject (1 to 11) from metadata.xml.

    Raises:
        InputError: No such file, or not 300 numbers in its element w0.

    """
    _, has_begin, rest = read_text(path).partition('<w0>')
    inside, has_end, _ = rest.partition('</w0>')
    if not (has_begin and has_end):
        raise refusal(path, 'no element w0 with the camera parameters')
    w0 = numbers(path, 'w0', inside.strip().strip('[]').split(), W0_LENGTH)
    split = len(SIZES) * N_SUBJECTS * N_EXTRINSICS
    extrinsics = w0[:split].reshape(len(SIZES), N_SUBJECTS, N_EXTRINSICS)[:, subject - 1]
    intrinsics = w0[split:].reshape(len(SIZES), N_INTRINSICS)
    rows = zip(SIZES.items(), extrinsics, intrinsics, strict=True)
    return tuple(_camera(path, name, size, e, i) for (name, size), e, i in rows)


def _camera(
    path: Path, name: str, size: tuple[int, int], extrinsic: Array, intrinsic: Array
) -> Camera:
    rotation = rotation_from_angles(extrinsic[:3])
    fx, fy, cx, cy, k1, k2, k3, p1, p2 = intrinsic
    return camera_from_file(
        path,
        name,
        matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion=np.array([k1, k2, p1, p2, k3]),
        size=size,
        rotation=rotation,
        translation=-rotation @ extrinsic[3:] * M_PER_MM,
    )


def rotation_from_angles(angles: Array) -> Array:
    """Return R = X(a) Y(b) Z(c) of three angles, radians."""
    (sa, sb, sc), (ca, cb, cc) = np.sin(angles), np.cos(angles)
    x = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
    y = np.array([[cb, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, cb]])
    z = np.array([[cc, -sc, 0.0], [sc, cc, 0.0], [0.0, 0.0, 1.0]])
    rotation: Array = x @ y @ z
    return rotation


def _poses(paths: Sequence[Path]) -> list[Array]:
    """Return the variable Pose of each of some CDF files."""
    require_library('cdflib')
    what = 'a CDF file with a variable Pose'
    contents = read_by_library(CHILD, paths, what=what, max_bytes=MAX_CDF_BYTES)
    return [content.arrays[0] for content in contents]


def _table(path: Path, values: Array, n_values: int, unit: float = 1.0) -> Array:
    """Return the values of a variable Pose as (T, 32, n_values)."""
    width = len(JOINTS) * n_values
    if values.ndim != 3 or values.shape[0] != 1 or values.shape[2] != width:
        raise refusal(path, f'Pose must be (1, T, {width}), found {values.shape}')
    return undamaged(values.reshape(-1, len(JOINTS), n_values), unit)
