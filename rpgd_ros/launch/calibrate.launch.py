# SPDX-License-Identifier: Apache-2.0
"""Starts the calibrator, and RViz where wanted.

ros2 launch rpgd_ros calibrate.launch.py rig_file:=rig.yaml
ros2 launch rpgd_ros calibrate.launch.py rig_file:=hall.yaml namespace:=hall rviz:=true
"""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

NODE = 'rpgd_calibrator'
# Handed on to the node as parameters where they are given.
PARAMETERS = {
    'rig_file': 'Path of the rig file: cameras, joints, topics. Always needed',
    'result_file': 'Where results are kept; empty = ~/.ros/rpgd/<namespace>/<node name>.yaml',
    'world_frame': 'Parent frame of the transform; empty = the one of the rig file',
    'mocap_frame': 'Child frame of the transform; empty = rig file, or messages',
    'tf_mode': 'static: publish /tf_static; none: leave TF alone',
}
OTHERS = {
    'params_file': ('', 'Path of a copy of config/calibrator.yaml; empty = the defaults'),
    'namespace': ('', 'Of the node and of the relative topics of the rig file'),
    'use_sim_time': ('false', 'Whether a simulator or a player publishes /clock'),
    'rviz': ('false', 'Whether to open RViz with the layout of this package'),
}
# What the layout of RViz shows, below the name of the node.
SHOWN = ('markers', 'pose', 'skeleton_world')


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and what they start."""
    arguments = [
        DeclareLaunchArgument(name, default_value='', description=text)
        for name, text in PARAMETERS.items()
    ]
    arguments += [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in OTHERS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=start)])


def start(context: LaunchContext) -> list[Node]:
    """Return the nodes, once the arguments are known."""
    given = {name: value for name, value in context.launch_configurations.items() if value}
    own = {name: given[name] for name in PARAMETERS if name in given}
    own['use_sim_time'] = given['use_sim_time'].lower() in {'true', '1'}
    namespace = given.get('namespace', '')
    calibrator = Node(
        package='rpgd_ros',
        executable='calibrator',
        name=NODE,
        namespace=namespace,
        parameters=[*([given['params_file']] if 'params_file' in given else []), own],
        output='screen',
    )
    layout = PathJoinSubstitution([FindPackageShare('rpgd_ros'), 'config', 'rpgd_ros.rviz'])
    fixed = ['-f', own['world_frame']] if 'world_frame' in own else []
    prefix = f'/{namespace.strip("/")}' if namespace else ''
    rviz = Node(
        package='rviz2',
        executable='rviz2',
        arguments=['-d', layout, *fixed],
        remappings=[(f'/{NODE}/{topic}', f'{prefix}/{NODE}/{topic}') for topic in SHOWN],
        condition=IfCondition(LaunchConfiguration('rviz')),
    )
    return [calibrator, rviz]
