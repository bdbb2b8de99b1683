# SPDX-License-Identifier: Apache-2.0
"""`--json` of the programs that write recordings: the outcome for programs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from rpgd_ros.core.errors import InputError

JSON_SCHEMA: Final = 1


def json_of(
    status: str,
    code: int,
    *,
    error: InputError | None = None,
    files: Mapping[str, Path] | None = None,
    **more: object,
) -> str:
    """Return a run for programs; the keys are documented in docs/import.md.

    Args:
        status: written, understood, bad_input.
        code: Exit code.
        error: Why nothing was written.
        files: What was, by its kind.
        **more: What else the program has to say.

    """
    tree: dict[str, Any] = {
        'schema': JSON_SCHEMA,
        'status': status,
        'exit_code': code,
        'reason': error.reason if error else None,
        'message': error.message if error else None,
        'files': {kind: str(path) for kind, path in (files or {}).items()},
    }
    return json.dumps(tree | more, indent=2, default=str)
