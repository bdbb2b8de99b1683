# SPDX-License-Identifier: Apache-2.0
"""Says what import_recording understood of the files."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from rpgd_ros.apps.import_inputs import Inputs
from rpgd_ros.importing import CameraPlan, Plan
from rpgd_ros.io.camera_files import TOML

NO_POSES = (
    'the calibration gives no poses for several cameras: calibrate_bag places each of them, in '
    'the world of those that have one, else in the MoCap frame'
)


def print_plan(console: Console, plan: Plan, inputs: Inputs) -> None:
    """Print streams, joints, durations, units and warnings."""
    skeleton = plan.skeleton
    file = skeleton.source
    axes = f'its {skeleton.up} axis turned to z' if skeleton.up else 'axes as in the file'
    standing = f', body along {skeleton.standing}' if skeleton.standing else ''
    stated = 'stated' if file.units == skeleton.units else 'as asked for'
    _say(console, f'skeleton    {file.path} ({file.format})')
    _say(
        console,
        f'            {len(skeleton.time_s)} frames at {skeleton.fps:.4g} Hz, '
        f'{skeleton.time_s[0]:.3f} to {skeleton.time_s[-1]:.3f} s; {len(skeleton.joints)} joints',
    )
    _say(
        console,
        f'            positions in {skeleton.units} ({stated}), body {skeleton.size_m:.2f} m; '
        f'{axes}{standing}',
    )
    names = ', '.join(camera.name for camera in inputs.cameras)
    if plan.timecode:
        _say(console, f'timecode    {plan.timecode}')
    unit = inputs.arguments.camera_units or 'm'
    asked = 'as asked for' if inputs.arguments.camera_units else 'as Pose2Sim means them'
    units = (
        f'; positions in {unit} ({asked}: TOML states no unit)' if TOML in inputs.formats else ''
    )
    _say(console, f'calibration {", ".join(inputs.formats)}: {names}{units}')
    for camera in plan.cameras:
        found = camera.detections
        _say(console, f'{camera.camera.name:<11} {found.path} ({found.format})')
    console.print(_streams(plan))
    for camera in plan.cameras:
        _say_joints(console, plan, camera)
    for warning in warnings_of(plan, inputs):
        _say(console, f'warning: {warning}')


def _say(console: Console, sentence: str) -> None:
    """Print a sentence with foreign words in it as it is."""
    console.print(sentence, markup=False, highlight=False, soft_wrap=True)


def _streams(plan: Plan) -> Table:
    headings = ('frames', 'Hz', 'from s', 'to s', 'nobody', 'others', 'seen', 'pairs')
    table = Table('camera', box=None, pad_edge=False)
    for heading in headings:
        table.add_column(heading, justify='right')
    for camera in plan.cameras:
        found = camera.detections
        seen = float((found.scores > 0.0).mean())
        table.add_row(
            camera.camera.name,
            str(len(found.frames)),
            f'{camera.fps:g}',
            f'{camera.time_s[0]:.3f}',
            f'{camera.time_s[-1]:.3f}',
            str(found.n_empty),
            str(found.n_others),
            f'{seen:.0%}',
            str(len(camera.pairs)),
        )
    return table


def _say_joints(console: Console, plan: Plan, camera: CameraPlan) -> None:
    """Say which joints are paired; once for all cameras that have the same."""
    same = [c.camera.name for c in plan.cameras if c.pairs == camera.pairs]
    if same[0] != camera.camera.name:
        return
    joints = plan.skeleton.joints
    pairs = ', '.join(f'{camera.joints[k]} = {joints[j]}' for j, k in camera.pairs)
    _say(console, f'{", ".join(same)}: {pairs}')
    whats = ('keypoints without a joint', 'joints without a keypoint')
    for what, names in zip(whats, unpaired(plan, camera), strict=True):
        if names:
            _say(console, f'  {what}: {", ".join(names)}')


def unpaired(plan: Plan, camera: CameraPlan) -> tuple[list[str], list[str]]:
    """Return the keypoints of a camera, and the joints, that have no partner."""
    keypoints = {k for _, k in camera.pairs}
    joints = {j for j, _ in camera.pairs}
    return (
        [n for k, n in enumerate(camera.joints) if k not in keypoints],
        [n for j, n in enumerate(plan.skeleton.joints) if j not in joints],
    )


def warnings_of(plan: Plan, inputs: Inputs) -> list[str]:
    """Return all that looks wrong."""
    warnings = [
        *plan.skeleton.warnings,
        *plan.warnings,
        *(w for c in plan.cameras for w in c.warnings),
    ]
    without = ', '.join(inputs.without_keypoints)
    if without:
        warnings.append(f'no keypoints for {without}: left out')
    if len(plan.cameras) > 1 and any(c.camera.camera_T_world is None for c in plan.cameras):
        warnings.append(NO_POSES)
    return warnings
