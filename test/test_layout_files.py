# SPDX-License-Identifier: Apache-2.0
"""The layouts hold what Foxglove and RViz read; keys that neither knows are passed over silently.

The names are those of the panels of Lichtblick 1.28 (the open line of Foxglove Studio) and of
rviz_common and rviz_default_plugins of Jazzy.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

CONFIG = Path(__file__).resolve().parents[1] / 'config'
FOXGLOVE: dict[str, set[str]] = {
    '3D': {'followMode', 'cameraState', 'layers', 'topics'},
    'RawMessages': {'topicPath', 'expansion'},
    'Plot': {'foxglovePanelTitle', 'lichtblickPanelTitle', 'paths', 'minYValue', 'isSynced',
             'showLegend'},
    'DiagnosticSummary': {'topicToRender', 'hardwareIdFilter', 'minLevel', 'pinnedIds'},
    'CallService': {'serviceName', 'requestPayload', 'buttonText'},
}  # fmt: skip
CAMERA = {'perspective', 'distance', 'phi', 'thetaOffset', 'target', 'targetOffset',
          'targetOrientation', 'fovy', 'near', 'far'}  # fmt: skip
TOPIC = {'visible', 'pointShape', 'pointSize'}
RVIZ: dict[str, set[str]] = {
    'Grid': {'Cell Size', 'Plane Cell Count'},
    'TF': {'Show Names'},
    'MarkerArray': {'Topic'},
    'PointCloud2': {'Topic', 'Style', 'Size (m)', 'Decay Time'},
    'PoseWithCovariance': {'Topic', 'Shape'},
}
RVIZ_TOPIC = {'Value', 'Depth', 'History Policy', 'Reliability Policy', 'Durability Policy'}


@pytest.fixture(scope='module')
def foxglove() -> dict[str, Any]:
    """Return the layout of Foxglove."""
    tree: dict[str, Any] = json.loads((CONFIG / 'foxglove.json').read_text())
    return tree


def test_panels_of_foxglove_exist_with_their_keys(foxglove: dict[str, Any]) -> None:
    """A panel of an unknown type is an empty frame; a misspelt key has no effect."""
    for name, panel in foxglove['configById'].items():
        assert set(panel) <= FOXGLOVE[name.partition('!')[0]], name
    for path in foxglove['configById']['Plot!error']['paths']:
        assert set(path) == {'value', 'enabled', 'timestampMethod'}


def test_space_of_foxglove_is_looked_at_from_where_the_layout_says(
    foxglove: dict[str, Any],
) -> None:
    """At the body: targetOffset moves the view, target is that of a frame which is followed."""
    space = foxglove['configById']['3D!rpgd']
    assert set(space['cameraState']) == CAMERA
    assert space['cameraState']['targetOffset'] == [0, 0, 1]
    assert all(set(topic) <= TOPIC for topic in space['topics'].values())
    assert {layer['layerId'] for layer in space['layers'].values()} == {'foxglove.Grid'}


def test_displays_of_rviz_exist_with_their_properties() -> None:
    """An unknown class is a red line in the list of displays."""
    manager = yaml.safe_load((CONFIG / 'rpgd_ros.rviz').read_text())['Visualization Manager']
    for display in manager['Displays']:
        package, _, kind = display['Class'].partition('/')
        assert package == 'rviz_default_plugins'
        assert set(display) - {'Class', 'Name', 'Enabled'} <= RVIZ[kind], display['Name']
        assert set(display.get('Topic', {})) <= RVIZ_TOPIC
    assert {tool['Class'] for tool in manager['Tools']} <= {
        'rviz_default_plugins/MoveCamera', 'rviz_default_plugins/Measure'
    }  # fmt: skip
    assert manager['Views']['Current']['Class'] == 'rviz_default_plugins/Orbit'
