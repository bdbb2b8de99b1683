# SPDX-License-Identifier: Apache-2.0
"""Pictures of a calibration, and the report."""

from rpgd_ros.report.case import Case, Photo, Step, StreamCount
from rpgd_ros.report.convergence import settle
from rpgd_ros.report.html import check_libraries, write_report
from rpgd_ros.report.instants import choose_instants
from rpgd_ros.report.overlay import draw_skeleton, overlay_sheet, write_png

__all__ = [
    'Case',
    'Photo',
    'Step',
    'StreamCount',
    'check_libraries',
    'choose_instants',
    'draw_skeleton',
    'overlay_sheet',
    'settle',
    'write_png',
    'write_report',
]
