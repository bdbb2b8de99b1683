# SPDX-License-Identifier: Apache-2.0
"""`import_recording --json`: what was understood, for programs."""

from __future__ import annotations

from typing import Any

from rpgd_ros.apps.import_inputs import Inputs
from rpgd_ros.apps.import_tables import unpaired, warnings_of
from rpgd_ros.importing import CameraPlan, Plan


def plan_tree(plan: Plan, inputs: Inputs) -> dict[str, Any]:
    """Return what was understood of the files of a shoot."""
    skeleton = plan.skeleton
    return {
        'skeleton': {
            'path': str(skeleton.source.path),
            'format': skeleton.source.format,
            'frames': len(skeleton.time_s),
            'fps': skeleton.fps,
            'from_s': float(skeleton.time_s[0]),
            'to_s': float(skeleton.time_s[-1]),
            'joints': list(skeleton.joints),
            'units': skeleton.units,
            'units_stated': skeleton.source.units,
            'up': skeleton.up,
            'standing': skeleton.standing or None,
            'body_m': skeleton.size_m,
        },
        'timecode': plan.timecode or None,
        'cameras': [_camera(plan, camera) for camera in plan.cameras],
        'warnings': warnings_of(plan, inputs),
    }


def _camera(plan: Plan, camera: CameraPlan) -> dict[str, Any]:
    found, joints = camera.detections, plan.skeleton.joints
    keypoints, others = unpaired(plan, camera)
    return {
        'camera': camera.camera.name,
        'path': str(found.path),
        'format': found.format,
        'frames': len(found.frames),
        'fps': camera.fps,
        'from_s': float(camera.time_s[0]),
        'to_s': float(camera.time_s[-1]),
        'nobody': found.n_empty,
        'others': found.n_others,
        'seen': float((found.scores > 0.0).mean()),
        'units': camera.units,
        'pairs': {camera.joints[k]: joints[j] for j, k in camera.pairs},
        'keypoints_without_joint': keypoints,
        'joints_without_keypoint': others,
    }
