# SPDX-License-Identifier: Apache-2.0
"""Reads the small files of datasets, and finds the libraries that read the large ones."""

from __future__ import annotations

import importlib
import struct
import zlib
from pathlib import Path
from types import ModuleType

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.datasets.sequence import refusal, shown

MAX_TEXT_BYTES = 4 * 2**20  # metadata.xml of Human3.6M, the largest of them, has half a megabyte

MISSING = "this needs {}, which is not installed: pip install 'rpgd_ros[datasets]'"

# What cdflib and SciPy raise on damaged files (measured on flipped bytes; the NameError is
# SciPy's): nothing that is a fault of ours.
DAMAGE = (
    ArithmeticError, AssertionError, AttributeError, BufferError, EOFError, LookupError,
    MemoryError, NameError, NotImplementedError, OSError, TypeError, ValueError, struct.error,
    zlib.error,
)  # fmt: skip


def require_folder(path: Path) -> Path:
    """Return the path of a folder.

    Raises:
        InputError: There is none.

    """
    if not path.is_dir():
        raise refusal(path, 'no such folder')
    return path


def require_size(path: Path, max_bytes: int) -> None:
    """Refuse a file that is missing, or larger than its kind ever is."""
    try:
        n_bytes = path.stat().st_size
    except OSError as error:
        raise refusal(path, f'cannot be read: {error.strerror or error}') from error
    if n_bytes > max_bytes:
        raise refusal(path, f'{n_bytes} bytes: such files have at most {max_bytes}')


def read_text(path: Path) -> str:
    """Read a text file of limited size.

    Raises:
        InputError: Missing, too large, no text.

    """
    require_size(path, MAX_TEXT_BYTES)
    try:
        return path.read_text(encoding='utf-8')
    except OSError as error:
        raise refusal(path, f'cannot be read: {error.strerror or error}') from error
    except UnicodeDecodeError as error:
        raise refusal(path, 'no text (UTF-8)') from error


def numbers(path: Path, what: str, words: list[str], count: int) -> Array:
    """Return words of a text file as that many finite numbers.

    Raises:
        InputError: Fewer, more, or no numbers.

    """
    try:
        values = np.array([float(word) for word in words])
    except ValueError as error:
        raise refusal(path, f'{what}: need numbers, found {shown(" ".join(words))}') from error
    if len(values) != count or not np.isfinite(values).all():
        raise refusal(path, f'{what}: need {count} finite numbers, found {len(values)}')
    return values


def load_cdflib() -> ModuleType:
    """Return the library that reads CDF files.

    Raises:
        InputError: It is not installed.

    """
    try:
        return importlib.import_module('cdflib')
    except ImportError as error:
        raise InputError(Reason.BAD_INPUT, MISSING.format('cdflib')) from error


def load_scipy_io() -> ModuleType:
    """Return the library that reads MATLAB's files.

    Raises:
        InputError: It is not installed.

    """
    try:
        return importlib.import_module('scipy.io')
    except ImportError as error:
        raise InputError(Reason.BAD_INPUT, MISSING.format('scipy')) from error
