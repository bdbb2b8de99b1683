# SPDX-License-Identifier: Apache-2.0
"""`calibrate_bag --json`: what a recording has beside every outcome."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import yaml

from rpgd_ros.apps.bag_job import Written
from rpgd_ros.apps.bag_run import BagRun
from rpgd_ros.apps.outcome_json import json_of
from rpgd_ros.core.errors import RpgdError


def bag_json(
    status: str,
    code: int,
    *,
    error: RpgdError | None = None,
    message: str = '',
    run: BagRun | None = None,
    written: Sequence[Written] = (),
    check: Mapping[str, object] | None = None,
) -> str:
    """Return a run for programs; the keys are documented in docs/report.md.

    Args:
        status: accepted, partial, refused, bad_input; of a check fits, does_not_fit.
        code: Exit code.
        error: Why there is no result.
        message: What else to tell a person.
        run: What was found, as far as it went.
        written: Files.
        check: How an older result fits.

    """
    streams = run.streams if run else ()
    return json_of(
        status,
        code,
        error=error,
        message=message,
        files={one.what: one.path for one in written},
        streams=[{**s._asdict(), 'dropped': dict(s.dropped)} for s in streams],
        result=yaml.safe_load(run.result_text) if run else None,
        check=check,
    )
