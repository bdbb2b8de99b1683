# SPDX-License-Identifier: Apache-2.0
"""`--json`: the outcome for programs, as every command tells it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from rpgd_ros.core.errors import RpgdError

JSON_SCHEMA: Final = 1


def json_of(
    status: str,
    code: int,
    *,
    error: RpgdError | None = None,
    message: str = '',
    files: Mapping[str, Path] | None = None,
    **more: object,
) -> str:
    """Return a run for programs; the keys are documented in docs/report.md and docs/import.md.

    Args:
        status: What became of it, a word.
        code: Exit code.
        error: Why there is no result.
        message: What else to tell a person.
        files: What was written, by its kind.
        **more: What else the program has to say.

    """
    tree: dict[str, Any] = {
        'schema': JSON_SCHEMA,
        'status': status,
        'exit_code': code,
        'reason': error.reason if error else None,
        'message': error.message if error else message or None,
        'files': {kind: str(path) for kind, path in (files or {}).items()},
    }
    return json.dumps(tree | more, indent=2, default=str)
