# SPDX-License-Identifier: Apache-2.0
"""The node leaves a page beside the result when it is asked to save."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from ros_live import live
from ros_scene import make_scene

pytest.importorskip('plotly')
pytest.importorskip('jinja2')


def test_saving_writes_the_report_beside_the_result(tmp_path: Path) -> None:
    """Of the calibration that is published; calibrating alone writes none."""
    folder = tmp_path / 'walk'
    folder.mkdir()
    walk = make_scene(folder)
    rig = tmp_path / 'rig.yaml'
    rig.write_bytes(walk.rig.read_bytes())
    page = tmp_path / 'result.html'
    with live(rig) as node:
        node.play(walk)
        assert node.calibrate()[0]
        assert not page.exists()
        assert node.call('save').success
        text = page.read_text()
    assert re.search('<h1>Accepted', text)
    assert 'static_transform_publisher' in text
