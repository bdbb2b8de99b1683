# SPDX-License-Identifier: Apache-2.0
"""The reprojected skeleton over the images of a walk: single pictures, or a film of all cameras.

The in-the-wild figure of the publication, for every instant.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Final, NamedTuple, Self

import cv2
import numpy as np

from rpgd_ros.core import Camera, Observations, RigidTransform
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.observations import NS_PER_S, View
from rpgd_ros.io.atomic import refuse_link, write_atomic
from rpgd_ros.report.images import Image
from rpgd_ros.report.overlay import (
    DETECTED,
    GROUND,
    INK,
    REPROJECTED,
    TILE_WIDTH,
    draw_skeleton,
)
from rpgd_ros.skeletons import edges

FILMS: Final = ('.mp4', '.avi', '.mkv')
CODECS: Final = {'.mp4': 'mp4v', '.avi': 'MJPG', '.mkv': 'mp4v'}
JPEG_QUALITY: Final = 88
USUAL_HZ: Final = 25.0  # of a film, where no time is known
LOWEST_HZ, HIGHEST_HZ = 1.0, 120.0


class Instant(NamedTuple):
    """One camera at one instant.

    Attributes:
        camera: Its number.
        row: Number of the instant in its view.
        image: (height, width, 3) blue, green, red; None = an empty canvas.

    """

    camera: int
    row: int
    image: Image | None


class Painter:
    """Draws keypoints and the reprojected skeleton of a calibration."""

    def __init__(
        self, cameras: Sequence[Camera], observations: Observations, world_T_mocap: RigidTransform
    ) -> None:
        """Reproject everything once.

        Args:
            cameras: One per view.
            observations: At the clock offsets that were found.
            world_T_mocap: The calibration.

        """
        self._cameras = cameras
        self._views = observations.views
        names = observations.joint_names or ()
        self._bones = edges(names)
        self._uv = [
            camera.project_camera(
                ((camera.camera_T_world or RigidTransform.identity()) @ world_T_mocap)
                @ view.x_mocap
            )
            for camera, view in zip(cameras, observations.views, strict=True)
        ]

    def paint(self, instant: Instant, width: int = 0) -> Image:
        """Return the picture of an instant.

        Args:
            instant: What to draw.
            width: Of the picture, pixels; 0 = that of the camera.

        """
        camera = self._cameras[instant.camera]
        scale = width / camera.size[0] if width else 1.0
        size = round(camera.size[0] * scale), max(1, round(camera.size[1] * scale))
        canvas = _canvas(instant.image, size)
        for uv, bones, colour in (
            (self._uv[instant.camera][instant.row], self._bones, REPROJECTED),
            (self._views[instant.camera].uv[instant.row], (), DETECTED),
        ):
            draw_skeleton(canvas, _scaled(uv, scale), bones, colour)
        return canvas


def write_pictures(
    folder: Path, painter: Painter, names: Sequence[str], instants: Iterable[Instant]
) -> int:
    """Write one JPEG per instant, as `cam0_000012.jpg`; return how many.

    Args:
        folder: Where; must exist.
        painter: Draws them.
        names: Of the cameras.
        instants: What to draw.

    Raises:
        InputError: NOT_WRITABLE.

    """
    count = 0
    for instant in instants:
        options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        _, encoded = cv2.imencode('.jpg', painter.paint(instant), options)
        name = f'{names[instant.camera]}_{instant.row:06d}.jpg'
        write_atomic(folder / name, encoded.tobytes())
        count += 1
    return count


def write_film(
    path: Path,
    painter: Painter,
    cameras: Sequence[Camera],
    observations: Observations,
    instants: Iterable[Instant],
) -> int:
    """Write a film of all cameras beside each other; return its number of frames.

    A frame ends with each instant of the camera that has most of them; the others show their last.

    Args:
        path: File, `.mp4`, `.avi` or `.mkv`.
        painter: Draws the instants.
        cameras: One per view.
        observations: Their data.
        instants: In the order of time.

    Raises:
        InputError: NOT_WRITABLE.

    """
    refuse_link(path)
    leader = max(range(len(cameras)), key=lambda v: observations.views[v].n_frames)
    wall = _Wall(cameras)
    with _Film(path, _rate_hz(observations.views[leader]), wall.size) as film:
        for instant in instants:
            wall.hang(instant.camera, painter.paint(instant, TILE_WIDTH))
            if instant.camera == leader:
                film.add(wall.image)
    return film.n_frames


def blank_instants(
    views: Sequence[View], rows: Mapping[int, Sequence[int]] | None = None
) -> Iterator[Instant]:
    """Yield instants without images, in the order of time.

    Args:
        views: One per camera.
        rows: Which of each camera; None = all.

    """
    every: list[tuple[float, int, int]] = []
    for v, view in enumerate(views):
        chosen = range(view.n_frames) if rows is None else rows.get(v, ())
        stamps = view.stamp_ns
        every += [(float(k if stamps is None else stamps[k]), v, k) for k in chosen]
    for _, v, k in sorted(every):
        yield Instant(v, k, None)


class _Wall:
    """A grid of pictures, one per camera, with its name."""

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._names = [camera.name for camera in cameras]
        heights = [round(c.size[1] * TILE_WIDTH / c.size[0]) for c in cameras]
        self._height = max(2, *heights, 2)
        self._columns = max(1, round(np.sqrt(len(cameras))))
        rows = -(-len(cameras) // self._columns)
        # Codecs want even numbers of pixels.
        self.size = self._columns * TILE_WIDTH, 2 * (-(-rows * self._height // 2))
        self.image = np.full((self.size[1], self.size[0], 3), GROUND, np.uint8)

    def hang(self, camera: int, picture: Image) -> None:
        row, column = divmod(camera, self._columns)
        top, left = row * self._height, column * TILE_WIDTH
        self.image[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
        place = left + 14, top + 30
        cv2.putText(self.image, self._names[camera], place, cv2.FONT_HERSHEY_SIMPLEX, 0.7, INK, 1,
                    cv2.LINE_AA)  # fmt: skip


class _Film:
    """Writes a film beside its place, and puts it there when it is whole."""

    def __init__(self, path: Path, hz: float, size: tuple[int, int]) -> None:
        self.path, self.n_frames = path, 0
        self._hz, self._size = hz, size

    def add(self, image: Image) -> None:
        self._writer.write(image)
        self.n_frames += 1

    def __enter__(self) -> Self:
        try:
            self._folder = tempfile.TemporaryDirectory(prefix='.film.', dir=self.path.parent)
        except OSError as error:
            raise self._not_writable(error.strerror or str(error)) from error
        self._scratch = Path(self._folder.name) / f'film{self.path.suffix}'
        codec = cv2.VideoWriter.fourcc(*CODECS[self.path.suffix])
        self._writer = cv2.VideoWriter(str(self._scratch), codec, self._hz, self._size)
        if not self._writer.isOpened():
            self._folder.cleanup()
            msg = f'this OpenCV writes no {self.path.suffix}'
            raise self._not_writable(msg)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._writer.release()
        try:
            if kind is None:
                self._check()
                self._scratch.replace(self.path)
        except OSError as failure:
            raise self._not_writable(failure.strerror or str(failure)) from failure
        finally:
            self._folder.cleanup()

    def _check(self) -> None:
        """Read the film back: a writer of OpenCV does not say that the disk is full."""
        reader = cv2.VideoCapture(str(self._scratch))
        n_frames = 0
        while reader.grab():
            n_frames += 1
        reader.release()
        if n_frames < self.n_frames:
            msg = f'{n_frames} of {self.n_frames} frames came to the disk, it may be full'
            raise self._not_writable(msg)

    def _not_writable(self, why: str) -> InputError:
        return InputError(Reason.NOT_WRITABLE, f'{self.path} cannot be written: {why}')


def _canvas(image: Image | None, size: tuple[int, int]) -> Image:
    """Return an image of a size of its own, or an empty one."""
    if image is None:
        return np.full((size[1], size[0], 3), GROUND, np.uint8)
    if image.shape[1::-1] == size:
        return image.copy()
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _scaled(uv: Array, scale: float) -> Array:
    """Move pixels to another size of the image; centres of pixels are whole numbers."""
    scaled: Array = (uv + 0.5) * scale - 0.5
    return scaled


def _rate_hz(view: View) -> float:
    if view.stamp_ns is None or view.n_frames < 2:
        return USUAL_HZ
    period_s = float(np.median(np.diff(view.stamp_ns))) / NS_PER_S
    return float(np.clip(1.0 / period_s, LOWEST_HZ, HIGHEST_HZ)) if period_s > 0.0 else USUAL_HZ
