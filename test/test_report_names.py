# SPDX-License-Identifier: Apache-2.0
"""Names of joints and cameras are names in the plots, whatever they look like."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import report_cases

from rpgd_ros import report
from rpgd_ros.apps import calibrate_bag
from rpgd_ros.report.blocks import LONGEST, labels

SCRIPT = Path(report.__file__).parent / 'page' / 'report.js'
NODE = shutil.which('node')


def strings(value: object, key: str = '') -> Iterator[tuple[str, str]]:
    """Yield all strings of a tree with the key that they stand under."""
    if isinstance(value, str):
        yield key, value
    elif isinstance(value, dict):
        for inner, item in value.items():
            yield from strings(item, inner)
    elif isinstance(value, list):
        for item in value:
            yield from strings(item, key)


@pytest.mark.skipif(NODE is None, reason='needs node')
def test_only_a_colour_is_looked_up_among_the_colours_of_the_page() -> None:
    """A joint may be called @bad; one that is called so in a list of data stays."""
    own = re.search(r'const coloured = .*?\n  };\n', SCRIPT.read_text(), re.DOTALL)
    assert own
    figure = {'x': ['@bad', '@other'], 'name': '@bad', 'marker': {'color': ['@bad', '#fff']}}
    style = "{ getPropertyValue: (name) => name === '--bad' ? ' red' : '' }"
    line = f'{own[0]} console.log(JSON.stringify(coloured({json.dumps(figure)}, {style})))'
    ended = subprocess.run([str(NODE), '-e', line], capture_output=True, check=True, timeout=60)
    found: Any = json.loads(ended.stdout)
    assert found == {**figure, 'marker': {'color': ['red', '#fff']}}


@pytest.mark.skipif(
    not all(map(importlib.util.find_spec, ('plotly', 'jinja2'))), reason='needs the extra report'
)
def test_colours_of_the_page_are_asked_for_where_they_are_looked_up(tmp_path: Path) -> None:
    """Each of them, in all figures of a page."""
    report_cases.good(tmp_path)
    page = tmp_path / 'report.html'
    words = [tmp_path / 'bag', '--rig', tmp_path / 'rig.yaml', '--report', page]
    assert calibrate_bag.main([str(word) for word in words]) == 0
    figures = re.findall(r'data-figure="[^"]+">(.*?)</script>', page.read_text())
    keys = {
        key
        for figure in figures
        for key, text in strings(json.loads(figure))
        if text.startswith('@')
    }
    assert keys
    assert all('color' in key for key in keys)


def test_names_that_are_cut_are_still_two() -> None:
    """Else they would share a place on an axis."""
    long = 'x' * LONGEST
    found = labels(['a', f'{long}1', f'{long}2', 'b'])
    assert len(set(found)) == 4
    assert (found[0], found[3]) == ('a', 'b')
