# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/CameraInfo to intrinsics and back."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np

from rpgd_ros.core.camera import EQUIDISTANT_LENGTHS, PINHOLE_LENGTHS, Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.lens import Model
from rpgd_ros.messages.cdr import MAX_FRAME_ID, NS_PER_S, CdrError, CdrReader, CdrWriter

CAMERA_INFO: Final = 'sensor_msgs/msg/CameraInfo'

MAX_COEFFICIENTS: Final = 14  # OpenCV's longest list; those beyond its model's length must be zero
MAX_MODEL_NAME: Final = 64
LARGEST_ELEMENT: Final = 1e9  # of K, R, P: a focal length beyond it is damage
_MODELS: Final[dict[str, tuple[Model, tuple[int, ...]]]] = {
    'plumb_bob': ('pinhole', PINHOLE_LENGTHS[:3]),
    'rational_polynomial': ('pinhole', PINHOLE_LENGTHS),
    'equidistant': ('equidistant', EQUIDISTANT_LENGTHS),
    'fisheye': ('equidistant', EQUIDISTANT_LENGTHS),
}


@dataclass(frozen=True, slots=True, eq=False)
class CameraInfo:
    """Intrinsics of the images as delivered: binning and region of interest are applied.

    Attributes:
        stamp_ns: From the header.
        frame_id: The camera's optical frame.
        size: Width and height, pixels.
        model: As in `Camera`.
        matrix: (3, 3) K of the raw image, pixels.
        distortion: OpenCV coefficients of the raw image.
        rectified_matrix: (3, 3) P[:3, :3] of the rectified image; None where it is not given.
        rectification: (3, 3) `rectified_R_camera`: turns the optical axes to those of the
            rectified image.

    """

    stamp_ns: int
    frame_id: str
    size: tuple[int, int]
    model: Model
    matrix: Array
    distortion: Array
    rectified_matrix: Array | None
    rectification: Array

    def camera(
        self, name: str, camera_T_world: RigidTransform | None, *, is_rectified: bool = False
    ) -> Camera:
        """Build the camera that the keypoints were seen by.

        Args:
            name: Of the camera.
            camera_T_world: World to the optical frame of the header; None where unknown.
            is_rectified: Whether the keypoints were found in rectified images.

        Raises:
            InputError: Rectified keypoints, but no rectification in the message.

        """
        try:
            if not is_rectified:
                return Camera(
                    name, self.matrix, self.distortion, self.size, camera_T_world, self.model
                )
            if self.rectified_matrix is None:
                msg = f'camera {name}: its keypoints are rectified, but P of CameraInfo is zero'
                raise InputError(Reason.MISSING_INTRINSICS, msg)
            turn = RigidTransform(self.rectification, np.zeros(3))
            pose = turn if camera_T_world is None else turn @ camera_T_world
            return Camera(name, self.rectified_matrix, np.zeros(0), self.size, pose)
        except ValueError as error:
            raise InputError(Reason.BAD_MESSAGE, f'CameraInfo: {error}') from error


@np.errstate(invalid='ignore')  # asking a signalling NaN
def decode_camera_info(payload: bytes) -> CameraInfo:
    """Read a serialised sensor_msgs/CameraInfo.

    Raises:
        InputError: Not a CameraInfo, an unknown distortion model, or an uncalibrated camera.

    """
    try:
        return _read(CdrReader(payload))
    except (CdrError, struct.error) as error:
        msg = f'not a {CAMERA_INFO}: {error}'
        raise InputError(Reason.BAD_MESSAGE, msg) from error


def _read(reader: CdrReader) -> CameraInfo:
    sec, nanosec = reader.integers('i', 1)[0], reader.u32()
    frame_id = reader.string(MAX_FRAME_ID)
    height, width = reader.u32(), reader.u32()
    model_name = reader.string(MAX_MODEL_NAME)
    n_coefficients = reader.u32()
    if n_coefficients > MAX_COEFFICIENTS:
        msg = f'{n_coefficients} distortion coefficients, at most {MAX_COEFFICIENTS}'
        raise InputError(Reason.BAD_MESSAGE, msg)
    d = reader.numbers(n_coefficients)
    k = _matrix('K', reader.numbers(9))
    r = _matrix('R', reader.numbers(9))
    p = _matrix('P', reader.numbers(12))[:, :3]
    binning = np.maximum(reader.integers('I', 2), 1)  # 0 means 1
    x_offset, y_offset, roi_height, roi_width = reader.integers('I', 4)
    if not k[0, 0]:
        msg = f'CameraInfo of {frame_id!r} is uncalibrated (K is zero): calibrate the camera'
        raise InputError(Reason.MISSING_INTRINSICS, msg)
    model, distortion = _distortion(model_name, d)
    # K and P are those of the full image; cropping comes first, then binning, with the pixel
    # arithmetic of image_geometry.
    crop = np.array([[1.0, 0.0, -x_offset], [0.0, 1.0, -y_offset], [0.0, 0.0, 1.0]])
    delivered = np.diag([1.0 / binning[0], 1.0 / binning[1], 1.0]) @ crop
    return CameraInfo(
        stamp_ns=sec * NS_PER_S + nanosec,
        frame_id=frame_id,
        size=(int((roi_width or width) // binning[0]), int((roi_height or height) // binning[1])),
        model=model,
        matrix=delivered @ k,
        distortion=distortion,
        rectified_matrix=delivered @ p if p[0, 0] else None,
        rectification=r if r.any() else np.eye(3),
    )


def _matrix(name: str, numbers: Array) -> Array:
    if not np.abs(numbers).max() <= LARGEST_ELEMENT:  # False for NaN
        msg = f'{name} of CameraInfo holds numbers that are not finite or absurdly large'
        raise InputError(Reason.BAD_MESSAGE, msg)
    return numbers.reshape(3, -1)


def _distortion(model_name: str, d: Array) -> tuple[Model, Array]:
    """Translate a distortion model; trailing zeros beyond its length are the model's own."""
    if not d.any():  # also the way of drivers that leave the name empty
        return _MODELS.get(model_name, _MODELS['plumb_bob'])[0], np.zeros(0)
    if model_name not in _MODELS:
        msg = f'distortion model {model_name!r}; known: {", ".join(_MODELS)}'
        raise InputError(Reason.BAD_MESSAGE, msg)
    model, lengths = _MODELS[model_name]
    used = int(np.flatnonzero(d)[-1]) + 1
    length = min((n for n in lengths if n >= used), default=0)
    if not length or not np.isfinite(d).all():
        msg = f'{model_name} takes {max(lengths)} finite coefficients, got {d.size}'
        raise InputError(Reason.BAD_MESSAGE, msg)
    return model, np.pad(d[:length], (0, max(0, length - d.size)))


def encode_camera_info(camera: Camera, stamp_ns: int, frame_id: str) -> bytes:
    """Serialise the intrinsics of a camera as sensor_msgs/CameraInfo.

    Args:
        camera: Its pose is not part of the message.
        stamp_ns: Stamp of the header.
        frame_id: The camera's optical frame.

    Raises:
        InputError: Stamp or frame that cannot be sent.

    """
    model_name, length = 'plumb_bob', 5
    if camera.model == 'equidistant':
        model_name, length = 'equidistant', 4
    elif camera.distortion.size > length:
        model_name, length = 'rational_polynomial', 8
    d = np.pad(camera.distortion, (0, length - camera.distortion.size))
    width, height = camera.size
    p = np.column_stack([camera.matrix, np.zeros(3)])
    writer = CdrWriter().header(stamp_ns, frame_id).numbers('I', height, width)
    writer.string(model_name).numbers('I', length).numbers('d', *d)
    writer.numbers('d', *camera.matrix.flat).numbers('d', *np.eye(3).flat).numbers('d', *p.flat)
    return writer.numbers('I', 0, 0).numbers('I', 0, 0, 0, 0).numbers('B', 0).done()
