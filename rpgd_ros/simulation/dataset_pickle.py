# SPDX-License-Identifier: Apache-2.0
"""Writes arrays as AIST++ stores them: pickles (protocol 4) as numpy 1 makes them.

The bytes are put together here: a writer that only knows arrays of numbers needs no pickle, which
this package keeps to the one module that reads such files.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

PROTOCOL = b'\x80\x04'
STOP, MARK, TUPLE, TUPLE1, TUPLE3 = b'.', b'(', b't', b'\x85', b'\x87'
EMPTY_DICT, SET_ITEMS, REDUCE, BUILD, FALSE, TRUE, NONE = (
    b'}',
    b'u',
    b'R',
    b'b',
    b'\x89',
    b'\x88',
    b'N',
)
RECONSTRUCT = b'cnumpy.core.multiarray\n_reconstruct\n'
NDARRAY, DTYPE = b'cnumpy\nndarray\n', b'cnumpy\ndtype\n'


def pickled(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the pickle of a mapping of arrays of numbers."""
    items = b''.join(_text(name) + _array(values) for name, values in arrays.items())
    return PROTOCOL + EMPTY_DICT + MARK + items + SET_ITEMS + STOP


def _array(values: NDArray[Any]) -> bytes:
    data = np.ascontiguousarray(values)
    empty = RECONSTRUCT + NDARRAY + _int(0) + TUPLE1 + _bytes(b'b') + TUPLE3 + REDUCE
    shape = MARK + b''.join(_int(n) for n in values.shape) + TUPLE
    state = _int(1) + shape + _dtype(data.dtype) + FALSE + _bytes(data.tobytes())
    return empty + MARK + state + TUPLE + BUILD


def _dtype(dtype: np.dtype[Any]) -> bytes:
    made = DTYPE + _text(dtype.str[1:]) + FALSE + TRUE + TUPLE3 + REDUCE
    rest = _text('<') + NONE * 3 + _int(-1) * 2 + _int(0)
    return made + MARK + _int(3) + rest + TUPLE + BUILD


def _int(value: int) -> bytes:
    return b'J' + struct.pack('<i', value)


def _text(text: str) -> bytes:
    data = text.encode()
    return b'X' + struct.pack('<I', len(data)) + data


def _bytes(data: bytes) -> bytes:
    return b'\x8e' + struct.pack('<Q', len(data)) + data
