# SPDX-License-Identifier: Apache-2.0
"""Reads the pickles of AIST++ without running what they say.

A pickle is a program. Here it may name nine things, all of them needed to store numpy arrays, and
none of them is what it names: each is replaced by a small class of this module that checks what it
is given. Not even numpy's own unpickling runs, which trusts shapes and lists.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from rpgd_ros.datasets.files import require_size
from rpgd_ros.datasets.sequence import refusal, shown

MAX_BYTES = 256 * 2**20  # the longest sequence of AIST++ takes 5 MiB
NUMERIC = frozenset('biuf')
# What unpickling raises on damaged bytes.
DAMAGE = (
    pickle.UnpicklingError, ArithmeticError, AttributeError, EOFError, ImportError, LookupError,
    MemoryError, OSError, RecursionError, TypeError, ValueError,
)  # fmt: skip


class _Dtype:
    """Stands for a numpy.dtype of numbers."""

    def __init__(self, text: str, *_flags: object) -> None:
        self.dtype = np.dtype(text if isinstance(text, str) else 'O')
        if self.dtype.kind not in NUMERIC:
            msg = f'values of type {shown(text)} are no numbers'
            raise ValueError(msg)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _version, order, *_rest = state
        self.dtype = self.dtype.newbyteorder(order)

    def array(self, data: bytes, shape: tuple[int, ...], order: str) -> NDArray[Any]:
        """Return numbers from bytes, which must be as many as the shape says."""
        values: NDArray[Any] = np.frombuffer(data, self.dtype).reshape(
            shape, order='F' if order == 'F' else 'C'
        )
        return values


class _Array:
    """Stands for a numpy.ndarray that is being filled."""

    value: NDArray[Any]

    def __init__(self, *_type_shape_code: object) -> None:
        self.value = np.zeros(0)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _version, shape, dtype, is_fortran, data = state
        self.value = dtype.array(data, shape, 'F' if is_fortran else 'C')


def _from_buffer(data: bytes, dtype: _Dtype, shape: tuple[int, ...], order: str) -> _Array:
    array = _Array()
    array.value = dtype.array(data, shape, order)
    return array


def _scalar(dtype: _Dtype, data: bytes) -> _Array:
    return _from_buffer(data, dtype, (), 'C')


def _encode(text: str, _encoding: str) -> bytes:
    """Protocol 2 stores bytes as text, in this encoding and no other."""
    return text.encode('latin1')


_CORES = ('numpy.core', 'numpy._core')  # before and since numpy 2
SAFE: Mapping[tuple[str, str], Callable[..., Any] | str] = MappingProxyType(
    {
        ('numpy', 'ndarray'): 'numpy.ndarray',  # an argument only
        ('numpy', 'dtype'): _Dtype,
        ('_codecs', 'encode'): _encode,
        **{(f'{core}.multiarray', '_reconstruct'): _Array for core in _CORES},
        **{(f'{core}.multiarray', 'scalar'): _scalar for core in _CORES},
        **{(f'{core}.numeric', '_frombuffer'): _from_buffer for core in _CORES},
    }
)


class _Unpickler(pickle.Unpickler):
    """Finds nothing but the names of `SAFE`."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in SAFE:
            msg = f'{shown(f"{module}.{name}")} is not allowed in data'
            raise pickle.UnpicklingError(msg)
        return SAFE[module, name]


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read a pickled mapping of arrays of numbers; entries of other kinds are left out.

    Args:
        path: Of the file.

    Raises:
        InputError: Missing, too large, damaged, or more than arrays.

    """
    require_size(path, MAX_BYTES)
    with path.open('rb') as file:
        return arrays_of(path, file)


def arrays_of(path: Path, file: BinaryIO) -> dict[str, NDArray[Any]]:
    """Do what `read_arrays` does with an open file; the path is for messages."""
    try:
        tree = _Unpickler(file).load()
    except DAMAGE as error:
        raise refusal(path, f'no pickle of plain arrays: {shown(str(error))}') from error
    if not isinstance(tree, dict):
        raise refusal(path, 'need a mapping of arrays')
    return {
        key: value.value
        for key, value in tree.items()
        if isinstance(key, str) and isinstance(value, _Array)
    }
