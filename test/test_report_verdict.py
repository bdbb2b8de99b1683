# SPDX-License-Identifier: Apache-2.0
"""The first line of a report says whether to use a transform, and its page shows the place."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
import report_cases

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


def test_a_moved_camera_is_named_with_how_far_and_shown(said: Callable[[str], Said]) -> None:
    """The other three give a transform; the page leads to the one."""
    page = said('bumped')
    assert re.match(r'Accepted, but without cam2: it was moved by 0\.5\d° and \d+', page.first)
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
    assert page.marked == {'time'}


def test_swapped_labels_are_refused_and_the_joints_are_named(said: Callable[[str], Said]) -> None:
    """The first pairs on top, all of them in the table of joints; no word of clocks and lenses."""
    page = said('swapped')
    assert page.first == 'Refused: left and right are swapped'
    assert page.marked == {'joints'}
    assert page.places['joints'] == 'So do 3 more pairs'
    assert 'LHipJC lies where RHipJC should be' in page.page
    assert len(re.findall('<tr class="marked"><td>[LR]', page.page)) == 12
    assert 'clock' not in page.page[page.page.index('<header') : page.page.index('</header>')]
