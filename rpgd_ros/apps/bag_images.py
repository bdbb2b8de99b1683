# SPDX-License-Identifier: Apache-2.0
"""Finds the images of a recording and hands them out with the instants that they show."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from rpgd_ros.apps.bag_run import BagRun
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import IntArray
from rpgd_ros.core.observations import NS_PER_S, Observations
from rpgd_ros.io.bag import TopicInfo, absolute_name, open_bag
from rpgd_ros.io.rig import Rig, RigCamera
from rpgd_ros.messages.image import (
    IMAGE_TYPES,
    MAX_IMAGE_BYTES,
    decode_image,
    image_stamp,
)
from rpgd_ros.report.film import Instant
from rpgd_ros.report.images import to_bgr

HEAD_BYTES: Final = 64  # of a message, which hold its stamp
APART_S: Final = 0.02  # at most, between an image and the keypoints found in it
# Of the images beside keypoints: those of a depth sensor are none.
NO_PICTURE: Final = ('depth', 'infra', 'ir/', 'mask', 'heatmap', 'disparity', 'theora')
LIKELY: Final = ('image_raw', 'image_color', 'image')


@dataclass(frozen=True, eq=False)
class BagImages:
    """The images of a recording.

    Attributes:
        path: Of the bag.
        topics: Camera number by topic.
        types: Message type by topic.
        shown: By camera number, the instants (rows of its view) by the stamp of the image.

    """

    path: Path
    topics: Mapping[str, int]
    types: Mapping[str, str]
    shown: Mapping[int, Mapping[int, int]]

    def rows(self, camera: int) -> tuple[int, ...]:
        """Return the instants of a camera that have an image."""
        return tuple(sorted(self.shown.get(camera, {}).values()))

    def instants(
        self,
        wanted: Mapping[int, Collection[int]] | None = None,
        *,
        tell: Callable[[str], None] = lambda _: None,
        progress: Callable[[str, float], None] = lambda *_: None,
    ) -> Iterator[Instant]:
        """Yield instants with their images, in the order of the recording.

        Args:
            wanted: Rows by camera; None = all that have an image.
            tell: Told once of each topic whose images cannot be used.
            progress: Told the stage and the share that was read.

        """
        bad: set[str] = set()
        n = 0
        total = max(1, sum(len(rows) for rows in self.shown.values()))
        with open_bag(self.path) as bag:
            for topic, _, payload in bag.stream(self.topics, longest=MAX_IMAGE_BYTES):
                camera = self.topics[topic]
                try:
                    row = self.shown[camera].get(image_stamp(payload))
                    if row is None or topic in bad:
                        continue
                    n += 1
                    progress('images', n / total)
                    if wanted is None or row in wanted.get(camera, ()):
                        image = to_bgr(decode_image(self.types[topic], payload))
                        yield Instant(camera, row, image)
                except InputError as error:
                    bad.add(topic)
                    tell(f'{topic[:80]}: {error.message}')


def find_images(run: BagRun, given: Sequence[str]) -> BagImages:
    """Find the image topic of each camera, and which instants its images show.

    Args:
        run: A run whose observations are there.
        given: `camera=topic` where the names do not tell.

    Raises:
        InputError: BAD_PARAMETER: `given` names a camera or topic that there is not.

    """
    observations, snapshot = run.observations, run.snapshot
    if observations is None or snapshot is None:
        return BagImages(run.bag, {}, {}, {})
    with open_bag(run.bag) as bag:
        chosen = topics_of(run.rig, bag.topics, given)
        names = [camera.name for camera in snapshot.cameras]
        topics = {chosen[name]: v for v, name in enumerate(names) if name in chosen}
        stamps: dict[str, list[int]] = {topic: [] for topic in topics}
        for topic, _, payload in bag.stream(topics, longest=HEAD_BYTES) if topics else ():
            stamps[topic].append(image_stamp(payload))
        types = {topic: bag.topics[topic].msgtype for topic in topics}
    shown = {
        v: _matched(np.array(stamps[topic], np.int64), camera_stamps(run, observations, v))
        for topic, v in topics.items()
    }
    return BagImages(run.bag, topics, types, shown)


def camera_stamps(run: BagRun, observations: Observations, camera: int) -> IntArray:
    """Return the stamps (F,) of a camera's instants as it sent them, ns."""
    stamps = observations.views[camera].stamp_ns
    if stamps is None:
        return np.zeros(0, np.int64)
    sent: IntArray = stamps + round(run.offsets_s[camera] * NS_PER_S)
    return sent


def topics_of(rig: Rig, topics: Mapping[str, TopicInfo], given: Sequence[str]) -> dict[str, str]:
    """Return the image topic of each camera that has one.

    Raises:
        InputError: BAD_PARAMETER.

    """
    images = {name: info for name, info in topics.items() if info.msgtype in IMAGE_TYPES}
    found = {}
    for camera in rig.cameras:
        likely = _likely(camera, [name for name, info in images.items() if info.n_messages])
        if likely:
            found[camera.name] = likely
    for words in given:
        name, _, topic = words.partition('=')
        if name not in {camera.name for camera in rig.cameras}:
            msg = f'--images {words[:80]!r}: no camera {name[:80]!r} in the rig file'
            raise InputError(Reason.BAD_PARAMETER, msg)
        if absolute_name(topic) not in images:
            there = ', '.join(repr(name[:80]) for name in images) or 'none'
            msg = f'--images {words[:80]!r}: no such image topic; the bag has {there}'
            raise InputError(Reason.BAD_PARAMETER, msg)
        found[name] = absolute_name(topic)
    return found


def _likely(camera: RigCamera, images: Sequence[str]) -> str:
    """Return the image topic beside a camera's other topics, '' where there is none."""
    sources = [camera.keypoints_topic, camera.camera_info_topic]
    spaces = {absolute_name(topic).rpartition('/')[0] for topic in sources if topic}
    spaces |= {absolute_name(camera.name)}
    beside = [
        name
        for name in images
        if any(space and name.startswith(f'{space}/') for space in spaces)
        and not any(word in name.lower() for word in NO_PICTURE)
    ]

    def rank(name: str) -> tuple[bool, int, int, str]:
        is_rectified = 'rect' in name
        likely = next((i for i, word in enumerate(LIKELY) if word in name), len(LIKELY))
        return is_rectified != camera.rectified, likely, len(name), name

    return min(beside, key=rank, default='')


def _matched(images_ns: IntArray, frames_ns: IntArray) -> dict[int, int]:
    """Return the instant that each image shows, by the image's stamp; the nearest to either."""
    if not len(images_ns) or not len(frames_ns):
        return {}
    images = np.unique(images_ns)
    after = np.clip(np.searchsorted(images, frames_ns), 0, len(images) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(images[before] - frames_ns) < np.abs(images[after] - frames_ns)
    nearest = np.where(nearer, before, after)
    apart = np.abs(images[nearest] - frames_ns)
    found: dict[int, tuple[int, int]] = {}
    for row, (i, distance) in enumerate(zip(nearest.tolist(), apart.tolist(), strict=True)):
        stamp = int(images[i])
        if distance <= APART_S * NS_PER_S and distance < found.get(stamp, (1 << 62, 0))[0]:
            found[stamp] = distance, row
    return {stamp: row for stamp, (_, row) in found.items()}
