# SPDX-License-Identifier: Apache-2.0
"""The edge to ROS 2: the only room that imports rclpy.

Nothing is imported here, so that `rpgd_ros.ros.parameters`, which needs no ROS, can be read
where none is installed.
"""
