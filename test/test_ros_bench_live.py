# SPDX-License-Identifier: Apache-2.0
"""The benchmark of the live node, small."""

from __future__ import annotations

import re

from harness import ros_environment, running

from rpgd_ros.ros.domain import free_domain

WAIT_S = 120.0
N_MESSAGES = 1080  # in a second: 240 skeletons, and 60 detections of each of 14 cameras


def test_every_taker_is_measured_under_every_load() -> None:
    """Nobody loses messages at a fifth of the usual rate; all figures are there."""
    arguments = ['-m', 'rpgd_ros.apps.bench_live', '--seconds', '1', '--rates', '200']
    with running(arguments, ros_environment(free_domain(), COLUMNS='100')) as child:
        assert child.wait(seconds=WAIT_S) == 0, child.output
    told = re.findall(r'(node|rclpy), (.*): (\d+) of (\d+) lost at (\d+)/s', child.output)
    assert [(taker, load) for taker, load, *_ in told] == [
        ('node', 'PointCloud2'),
        ('rclpy', 'PointCloud2'),
        ('node', 'PoseArray'),
        ('rclpy', 'PoseArray'),
        ('node', 'PoseArray, 200/s'),
        ('rclpy', 'PoseArray, 200/s'),
    ]
    for _, load, lost, sent, rate in told:
        if load.endswith('200/s'):
            assert (int(lost), int(sent)) == (0, 200)
            assert 100 < int(rate) <= 200  # a second of it, on a machine that does more
        else:
            assert int(sent) >= 0.95 * N_MESSAGES
    assert re.search(r'PoseArray, 200/s [^\d]*\d+ [^\d]*\d+ [^\d]*0 [^\d]*\d+\.\d\d', child.output)
