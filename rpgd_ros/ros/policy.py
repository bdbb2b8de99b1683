# SPDX-License-Identifier: Apache-2.0
"""The least rights that a calibrator needs, as an SROS2 policy. Needs no ROS."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from xml.sax.saxutils import escape

from rpgd_ros.io.rig import Rig

NODE_NAME = 'rpgd_calibrator'
ALWAYS_PUBLISHED = ('/diagnostics', '/parameter_events', '/rosout', '/tf_static')
OWN_TOPICS = (
    'transform', 'pose', 'reprojection_error', 'status', 'skeleton_world', 'markers',
)  # fmt: skip
ALWAYS_HEARD = ('/clock', '/parameter_events', '/tf_static')
OWN_SERVICES = ('calibrate', 'save', 'revert', 'load', 'reset', 'set_enabled')
PARAMETER_SERVICES = (
    'describe_parameters', 'get_parameter_types', 'get_parameters', 'get_type_description',
    'list_parameters', 'set_parameters', 'set_parameters_atomically',
)  # fmt: skip
HEAD = """\
<?xml version="1.0" encoding="UTF-8"?>
<!-- SPDX-License-Identifier: Apache-2.0 -->
<!-- Least rights of the calibrator with the topics of rigs/example_rig.yaml; put yours there.
     ros2 security create_permission <keystore> /rpgd sros2_policy.xml -->
"""


def policy_xml(rig: Rig) -> str:
    """Return the policy of a node with this rig."""
    inputs = [rig.mocap.topic]
    for camera in rig.cameras:
        inputs += [
            camera.keypoints_topic,
            camera.camera_info_topic or f'{camera.name}/camera_info',
        ]
    own = [f'~/{topic}' for topic in OWN_TOPICS]
    own += [f'~/{camera.name}/reprojection' for camera in rig.cameras]
    blocks = [
        *_block('topics', 'subscribe', 'topic', [*ALWAYS_HEARD, *inputs]),
        *_block('topics', 'publish', 'topic', [*ALWAYS_PUBLISHED, *own]),
        *_block('services', 'reply', 'service', [f'~/{s}' for s in _services()]),
    ]
    lines = [
        '<policy version="0.2.0">',
        '  <enclaves>',
        '    <enclave path="/rpgd">',
        '      <profiles>',
        f'        <profile ns="/" node="{NODE_NAME}">',
        *(f'          {line}' for line in blocks),
        '        </profile>',
        '      </profiles>',
        '    </enclave>',
        '  </enclaves>',
        '</policy>',
    ]
    return HEAD + '\n'.join(lines) + '\n'


def _services() -> Sequence[str]:
    return (*OWN_SERVICES, *PARAMETER_SERVICES)


def _block(kind: str, right: str, element: str, names: Iterable[str]) -> list[str]:
    inner = [f'  <{element}>{escape(name)}</{element}>' for name in sorted(set(names))]
    return [f'<{kind} {right}="ALLOW">', *inner, f'</{kind}>']
