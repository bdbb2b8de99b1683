# SPDX-License-Identifier: Apache-2.0
"""A film is whole, or it is not there."""

from __future__ import annotations

import resource
from pathlib import Path

import cv2
import numpy as np
import pytest
import scenes

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.report.film import FILMS, Instant, Painter, write_film

FRAMES = 40


def film(path: Path) -> int:
    """Write a film of noise, which no codec makes small; return its number of frames."""
    case = scenes.perfect(frames=FRAMES)
    painter = Painter(case.cameras, case.observations, case.truth.world_T_mocap)
    noise = np.random.default_rng(0).integers(0, 255, (720, 1280, 3), np.uint8)
    instants = [Instant(v, k, noise) for k in range(FRAMES) for v in range(len(case.cameras))]
    return write_film(path, painter, case.cameras, case.observations, instants)


@pytest.mark.parametrize('suffix', FILMS)
def test_a_film_has_all_its_frames(tmp_path: Path, suffix: str) -> None:
    """In each of the formats, and nothing lies beside it."""
    path = tmp_path / f'film{suffix}'
    assert film(path) == FRAMES
    reader = cv2.VideoCapture(str(path))
    assert [reader.grab() for _ in range(FRAMES + 1)] == [*[True] * FRAMES, False]
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize('suffix', FILMS)
def test_a_full_disk_leaves_the_older_film(tmp_path: Path, suffix: str) -> None:
    """A limit on the size of files stands for the disk: OpenCV does not say that it is full."""
    path = tmp_path / f'film{suffix}'
    path.write_bytes(b'older')
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(InputError, match='frames came to the disk') as refused:
            film(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert refused.value.reason is Reason.NOT_WRITABLE
    assert path.read_bytes() == b'older'
    assert list(tmp_path.iterdir()) == [path]


def test_a_film_does_not_replace_a_link(tmp_path: Path) -> None:
    """Neither is what it points to made."""
    link = tmp_path / 'film.mp4'
    link.symlink_to(tmp_path / 'nowhere.mp4')
    with pytest.raises(InputError, match='symbolic link'):
        film(link)
    assert link.is_symlink()
    assert not link.exists()
