# SPDX-License-Identifier: Apache-2.0
"""Does many tasks on the workers of an existing Dask cluster."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Generator, Sequence
from types import ModuleType
from typing import TypeVar

from rpgd_ros.core.errors import InputError, Reason

T = TypeVar('T')
R = TypeVar('R')

TIMEOUT_S = 20.0  # until a scheduler that does not answer is taken for missing


def each_on_cluster(
    function: Callable[[T], R], tasks: Sequence[T], *, address: str
) -> Generator[tuple[T, R | None], None, None]:
    """Yield tasks with what a function makes of them on a cluster, as they finish.

    Dask gives the tasks of a worker that died to the others. One that was at or waiting for
    workers that died again and again (`distributed.scheduler.allowed-failures`) is given up.

    Args:
        function: Of a module that the workers have; it keeps its results itself.
        tasks: What to do.
        address: Of the scheduler, such as tcp://host:8786.

    Yields:
        The task, and its result or None where it was given up.

    Raises:
        InputError: The library is not installed, or no scheduler answers.

    """
    distributed = _library()
    try:
        client = distributed.Client(address, timeout=TIMEOUT_S)
    except (OSError, ValueError) as error:
        msg = f'no Dask scheduler answers at {address[:80]!r}: {error}'
        raise InputError(Reason.BAD_INPUT, msg) from error
    with client:
        futures = client.map(function, tasks, pure=False)
        task_of = {future.key: task for future, task in zip(futures, tasks, strict=True)}
        try:
            for future in distributed.as_completed(futures):
                try:
                    result = future.result()
                except distributed.KilledWorker:
                    yield task_of[future.key], None
                else:
                    yield task_of[future.key], result
                future.release()
        finally:
            client.cancel(futures)


def _library() -> ModuleType:
    try:
        return importlib.import_module('distributed')
    except ImportError as error:
        msg = "--scheduler needs distributed: pip install 'rpgd_ros[cluster]'"
        raise InputError(Reason.BAD_INPUT, msg) from error
