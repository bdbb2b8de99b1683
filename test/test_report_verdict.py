# SPDX-License-Identifier: Apache-2.0
"""The first line of a report says whether to use a transform, and its page shows the place."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import report_cases
import scenes

from rpgd_ros.core import CalibrationConfig, CalibrationError, RigidTransform, calibrate
from rpgd_ros.report import Case, write_report
from rpgd_ros.skeletons import CONVENTIONS

pytest.importorskip('plotly')
pytest.importorskip('jinja2')


class Said(NamedTuple):
    """What a page says first.

    Attributes:
        title: Of the browser's tab.
        first: The first line.
        kind: accepted, warned or refused.
        places: Target and text of what the head of the page leads to.
        marked: Keys of the sections that are to be looked at.
        page: All of it.

    """

    title: str
    first: str
    kind: str
    places: dict[str, str]
    marked: set[str]
    page: str


@pytest.fixture
def said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[[str], Said]:
    """Return a function that makes a recording and reads the page of its calibration."""

    def said(name: str) -> Said:
        make = report_cases.BAD.get(name, report_cases.good)
        make(tmp_path)
        made = report_cases.run_on(tmp_path, lambda: capsys.readouterr().out)
        return read(made.page)

    return said


def read(path: Path) -> Said:
    """Read what a page says first."""
    page = path.read_text()
    head = page[page.index('<header') : page.index('</header>')]
    found = [re.search(r, page) for r in ('<title>(.*?)</title>', '<h1>(.*?)</h1>')]
    title, first = (html.unescape(match[1]) if match else '' for match in found)
    kind = re.search('<header class="(.*?)">', page)
    links = re.findall('<a href="#(.*?)">(.*?)</a>', head)
    marked = re.findall(r'<section id="([^"]*)" class="[^"]* marked"', page)
    return Said(
        title, first, kind[1] if kind else '', {key: html.unescape(text) for key, text in links},
        set(marked), page,
    )  # fmt: skip


def test_a_good_walk_is_accepted_with_what_it_is_known_to(said: Callable[[str], Said]) -> None:
    """In degrees and millimetres, and nothing is to be looked at."""
    page = said('good')
    assert re.fullmatch(r'Accepted: known to 0\.\d+° and [\d.]+\xa0mm', page.first)
    assert page.first in page.title
    assert (page.kind, page.places, page.marked) == ('accepted', {}, set())


def test_a_still_person_is_refused_and_the_place_is_shown(said: Callable[[str], Said]) -> None:
    """The room shows where the person stood."""
    page = said('still')
    assert page.first == 'Refused: the person stood still'
    assert page.kind == 'refused'
    assert 'room' in page.places
    assert 'room' in page.marked
    assert 'static_transform_publisher' not in page.page


def test_a_moved_camera_is_named_with_how_far_and_shown(tmp_path: Path) -> None:
    """The other three give a transform; the page leads to the one."""
    case = scenes.scene('human36m', 600, 2)
    cameras = list(case.cameras)
    half = np.radians(0.5) / 2
    moved = RigidTransform.from_quat_xyzw([0.01, 0, 0], [0, np.sin(half), 0, np.cos(half)])
    pose = cameras[2].camera_T_world
    assert pose is not None
    cameras[2] = replace(cameras[2], camera_T_world=moved @ pose)
    config = CalibrationConfig()
    config = replace(config, rig=replace(config.rig, on_bumped_camera='exclude'))
    calibration = calibrate(cameras, case.observations, config=config)
    write_report(
        tmp_path / 'report.html',
        Case('walk', 'world', 'mocap', 0, tuple(cameras), case.observations, calibration),
    )
    page = read(tmp_path / 'report.html')
    name = re.escape(cameras[2].name)
    assert re.match(rf'Accepted, but without {name}: it was moved by 0\.\d+° and \d+', page.first)
    assert page.kind == 'warned'
    assert 'camera-2' in page.places
    assert page.marked == {'camera-2'}


def test_a_camera_that_follows_somebody_else_is_named(said: Callable[[str], Said]) -> None:
    """In how many of its frames, and where to see them."""
    page = said('one_wrong_person')
    assert 'cam1 follows somebody or something else in' in page.first
    assert page.marked == {'camera-1'}
    assert 'camera-1' in page.places


def test_the_wrong_person_in_all_cameras_is_refused(said: Callable[[str], Said]) -> None:
    """Every camera is led to, and the map of who agreed when."""
    page = said('wrong_person')
    assert page.first == 'Refused: cameras and MoCap do not show the same person'
    assert 'of the keypoints' in page.page
    assert set(page.places) >= {'time', 'camera-0', 'camera-1', 'camera-2', 'camera-3'}


def test_swapped_labels_are_refused_and_the_joints_are_named(tmp_path: Path) -> None:
    """The first pairs on top, all of them in the table of joints."""
    case = scenes.scene('human36m', 150, 2, outlier_ratio=1.0, kind='swap')
    names = CONVENTIONS['h36m32']
    observations = replace(case.observations, joint_names=names)
    with pytest.raises(CalibrationError) as refused:
        calibrate(case.cameras, observations)
    write_report(
        tmp_path / 'report.html',
        Case(
            name='walk',
            world_frame='world',
            mocap_frame='mocap',
            stamp_ns=0,
            cameras=tuple(case.cameras),
            observations=observations,
            calibration=refused.value.calibration,
            refusal=refused.value,
            moved_m=2.0,
        ),
    )
    page = read(tmp_path / 'report.html')
    assert page.first == 'Refused: left and right are swapped'
    assert 'joints' in page.marked
    assert 'RightUpLeg lies where LeftUpLeg should be' in page.page
    assert len(re.findall('<tr class="marked"><td>(?:Left|Right)', page.page)) > 8
