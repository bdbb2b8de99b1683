# SPDX-License-Identifier: Apache-2.0
"""`calibrate_bag --json`: the outcome for programs."""

from __future__ import annotations

import json
from typing import Any, Final

import yaml

from rpgd_ros.apps.bag_job import Written
from rpgd_ros.apps.bag_run import BagRun
from rpgd_ros.io.result_file import result_text

JSON_SCHEMA: Final = 1


def json_of(
    status: str,
    code: int,
    *,
    reason: str = '',
    message: str = '',
    run: BagRun | None = None,
    written: list[Written] | None = None,
) -> str:
    """Return a run for programs; the keys are documented in docs/report.md.

    Args:
        status: accepted, partial, refused, bad_input.
        code: Exit code.
        reason: Code of the reason, '' where accepted.
        message: What to tell a person.
        run: What was found, as far as it went.
        written: Files.

    """
    tree: dict[str, Any] = {
        'schema': JSON_SCHEMA,
        'status': status,
        'exit_code': code,
        'reason': reason or None,
        'message': message or None,
        'streams': [
            {**s._asdict(), 'dropped': dict(s.dropped)} for s in (run.streams if run else ())
        ],
        'files': {what: str(path) for what, path in written or ()},
        'result': None,
        'check': None,
    }
    if run is not None and run.calibration is not None and run.refusal is None:
        world_frame, mocap_frame = run.frames
        text = result_text(
            run.calibration,
            world_frame=world_frame,
            mocap_frame=mocap_frame,
            stamp_ns=run.stamp_ns,
            optical_frames=run.session.optical_frames(),
            levels=run.stored_levels,
        )
        tree['result'] = yaml.safe_load(text)
    return json.dumps(tree, indent=2, default=str)
