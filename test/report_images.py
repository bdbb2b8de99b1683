# SPDX-License-Identifier: Apache-2.0
"""Gives a recording images: a dark room in which the keypoints are seen as light figures."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from rpgd_ros.io.bag import BagWriter, open_bag
from rpgd_ros.messages import decode_joints
from rpgd_ros.messages.image import (
    COMPRESSED_IMAGE,
    IMAGE,
    encode_compressed_image,
    encode_image,
)
from rpgd_ros.report.overlay import draw_skeleton
from rpgd_ros.skeletons import CONVENTIONS, EDGES

SIZE: Final = (1920, 1080)
EVERY = 6  # keypoint messages to an image: cameras of such a size send 5 a second


def with_images(bag: Path, target: Path) -> Path:
    """Copy a studio recording, with JPEGs of cam0 and raw grey images of cam1."""
    with open_bag(bag) as opened, BagWriter(target) as writer:
        counts: dict[str, int] = {}
        for topic, at, payload in opened.stream(opened.topics):
            msgtype = opened.topics[topic].msgtype
            writer.write(topic, msgtype, at, payload)
            if topic not in {'/cam0/keypoints', '/cam1/keypoints'}:
                continue
            counts[topic] = counts.get(topic, 0) + 1
            if counts[topic] % EVERY:
                continue
            decoded = decode_joints(
                msgtype, [payload], n_joints=len(CONVENTIONS['coco17']), n_values=2
            ).batch
            assert decoded is not None
            picture = room(decoded.values[0])
            stamp_ns = int(decoded.stamp_ns[0])
            if topic == '/cam0/keypoints':
                _, jpeg = cv2.imencode('.jpg', picture, [cv2.IMWRITE_JPEG_QUALITY, 60])
                image = encode_compressed_image(stamp_ns, 'cam0', jpeg.tobytes(), 'jpeg')
                writer.write('/cam0/image_raw/compressed', COMPRESSED_IMAGE, at, image)
            else:
                grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8)
                image = encode_image(stamp_ns, 'cam1', SIZE, grey.tobytes(), 'mono8')
                writer.write('/cam1/image_raw', IMAGE, at, image)
    return target


def room(uv: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Draw a figure where the keypoints (17, 2) are."""
    width, height = SIZE
    shade = np.linspace(60, 120, height).astype(np.uint8)
    picture = np.repeat(np.repeat(shade[:, None, None], width, 1), 3, 2)
    picture = np.ascontiguousarray(picture)
    for u in range(0, width, 160):
        cv2.line(picture, (u, 0), (u, height), (70, 80, 90), 1)
    draw_skeleton(picture, uv, EDGES['coco17'], (220, 220, 225))
    return picture
