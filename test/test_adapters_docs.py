# SPDX-License-Identifier: Apache-2.0
"""The page of inputs offers what the package reads."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from rpgd_ros.io.rig import parse_rig, rig_text
from rpgd_ros.messages import KEYPOINT_TYPES, SKELETON_TYPES
from rpgd_ros.messages.adapters.decode import ADAPTERS

PAGE = Path(__file__).parents[1] / 'docs' / 'inputs.md'
TEXT = PAGE.read_text()
SNIPPETS = re.findall(r'```yaml\n(.*?)```', TEXT, re.DOTALL)
CAMERA = {'name': 'cam0', 'keypoints': 'coco17', 'camera_info_topic': 'cam0/camera_info'}


def anchor(title: str) -> str:
    """Return the link to a heading, as GitHub makes it."""
    kept = re.sub(r'[^\w\- ]', '', title.lower())
    return '#' + kept.replace(' ', '-')


@pytest.mark.parametrize('snippet', SNIPPETS)
def test_every_snippet_is_part_of_a_rig_file(snippet: str) -> None:
    """With the rest of a rig around it, it is read, pairs its joints, and reads back the same."""
    own: dict[str, Any] = yaml.safe_load(snippet)
    tree = {
        'schema': 1,
        'world_frame': 'studio',
        'mocap': {'joints': 'coco17', 'topic': 'mocap/skeleton'},
        'cameras': [CAMERA],
    } | own
    rig = parse_rig(yaml.safe_dump(tree))
    assert len(rig.cameras[0].pairs) >= 4
    again = parse_rig(rig_text(rig))
    assert again.mocap == rig.mocap
    assert again.cameras[0].pairs == rig.cameras[0].pairs


def test_every_type_that_is_read_is_named_and_no_other() -> None:
    """The table is complete."""
    named = set(re.findall(r'`(\w+/msg/\w+)`', TEXT))
    assert named == {*SKELETON_TYPES, *KEYPOINT_TYPES}
    for msgtype, adapter in ADAPTERS.items():
        assert (3 in adapter.dimensions) == (msgtype in SKELETON_TYPES)
        assert (2 in adapter.dimensions) == (msgtype in KEYPOINT_TYPES)


def test_every_link_within_the_page_leads_somewhere() -> None:
    """Each family of the table has its section."""
    anchors = {anchor(title) for title in re.findall(r'^## (.*)$', TEXT, re.MULTILINE)}
    assert set(re.findall(r'\]\((#[^)]*)\)', TEXT)) <= anchors
