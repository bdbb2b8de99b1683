# SPDX-License-Identifier: Apache-2.0
"""Plays a bag to the live calibrator, once or for ever.

ros2 launch rpgd_ros replay.launch.py bag:=walk rig_file:=rig.yaml
"""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    IncludeLaunchDescription,
    OpaqueFunction,
)
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution, ThisLaunchFileDir

ARGUMENTS = {
    'bag': (None, 'Folder of the rosbag2, or its file'),
    'rig_file': (None, 'Path of the rig file: cameras, joints, topics'),
    # Not the file of the live node: a replay does not overwrite what the studio uses.
    'result_file': ('~/.ros/rpgd/replay.yaml', 'Where the result is kept'),
    'params_file': ('', 'Path of a copy of config/calibrator.yaml; empty = the defaults'),
    'rate': ('1.0', 'How many times faster than recorded'),
    'loop': ('false', 'Whether to begin again at the end'),
    'rviz': ('false', 'Whether to open RViz with the layout of this package'),
}
# Handed on to calibrate.launch.py.
PASSED_ON = ('rig_file', 'result_file', 'params_file', 'rviz')

# The player opens its publishers, then waits: what is played before the node has found them is
# lost. The node looks ten times a second, but it has to start first.
DELAY_SECONDS = 5


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and what they start."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=start)])


def start(context: LaunchContext) -> list[IncludeLaunchDescription | ExecuteProcess]:
    """Return the calibrator and the player, once the arguments are known."""
    given = context.launch_configurations
    passed_on = {name: given[name] for name in PASSED_ON}
    path = PathJoinSubstitution([ThisLaunchFileDir(), 'calibrate.launch.py'])
    calibrator = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(path),
        launch_arguments={**passed_on, 'use_sim_time': 'true'}.items(),
    )
    command = ['ros2', 'bag', 'play', given['bag'], '--clock', '--rate', given['rate']]
    command += ['--delay', str(DELAY_SECONDS)]
    command += ['--loop'] if given['loop'].lower() in {'true', '1'} else []
    return [calibrator, ExecuteProcess(cmd=command, output='screen')]
