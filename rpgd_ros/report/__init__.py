# SPDX-License-Identifier: Apache-2.0
"""Pictures of a calibration."""

from rpgd_ros.report.overlay import draw_skeleton, overlay_sheet, write_png

__all__ = ['draw_skeleton', 'overlay_sheet', 'write_png']
