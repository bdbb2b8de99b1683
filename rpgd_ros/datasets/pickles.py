# SPDX-License-Identifier: Apache-2.0
"""Reads pickles of datasets without running what they say.

A pickle is a program. Here it is first read through for instructions that arrays do not need, and
for numbers that would fill the memory. It may name nine things, all of them needed to store numpy
arrays, and none of them is what it names: each is replaced by a small class of this module that
checks what it is given. Not even numpy's own unpickling runs, which trusts shapes and lists.
"""

from __future__ import annotations

import io
import lzma
import pickle
import pickletools
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rpgd_ros.datasets.files import read_bytes, require_size
from rpgd_ros.datasets.sequence import refusal, shown

# The longest sequence of AIST++ takes 5 MiB; all skeletons of Human3.6M together 200, keypoints
# 300 once they are unpacked.
MAX_BYTES = 256 * 2**20
MAX_UNPACKED_BYTES = 512 * 2**20
# All skeletons of Human3.6M take 10 000; an instruction of one byte can make an object of 72.
MAX_INSTRUCTIONS = 2**20
NUMERIC_OR_OBJECT = re.compile('[<>|=]?[biufO][0-9]{0,2}')
# What unpickling raises on damaged bytes.
DAMAGE = (
    pickle.UnpicklingError, ArithmeticError, AttributeError, EOFError, ImportError, LookupError,
    MemoryError, OSError, RecursionError, TypeError, ValueError,
)  # fmt: skip
# And unpacking an archive.
ARCHIVE_DAMAGE = (*DAMAGE, lzma.LZMAError, RuntimeError, struct.error, zipfile.BadZipFile,
                  zlib.error)  # fmt: skip

# What pickles of arrays, mappings and lists are made of.
OPCODES = frozenset({
    'PROTO', 'FRAME', 'STOP', 'MARK', 'EMPTY_DICT', 'EMPTY_LIST', 'EMPTY_TUPLE', 'TUPLE', 'TUPLE1',
    'TUPLE2', 'TUPLE3', 'SETITEM', 'SETITEMS', 'APPEND', 'APPENDS', 'GLOBAL', 'STACK_GLOBAL',
    'REDUCE', 'BUILD', 'BINPUT', 'LONG_BINPUT', 'MEMOIZE', 'BINGET', 'LONG_BINGET', 'NONE',
    'NEWTRUE', 'NEWFALSE', 'BININT', 'BININT1', 'BININT2', 'LONG1', 'BINFLOAT', 'BINUNICODE',
    'SHORT_BINUNICODE', 'SHORT_BINBYTES', 'BINBYTES', 'BINBYTES8', 'BYTEARRAY8',
})  # fmt: skip
PUTS = frozenset({'BINPUT', 'LONG_BINPUT'})


class _Maker:
    """Calls one function of this module; nothing can be done to it."""

    __slots__ = ('_function',)

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def __call__(self, *arguments: Any) -> Any:
        return self._function(*arguments)

    def __setstate__(self, state: object) -> None:
        msg = 'a function has no state'
        raise pickle.UnpicklingError(msg)


class _Dtype:
    """Stands for a numpy.dtype of numbers, or of one object of any kind allowed here."""

    def __init__(self, text: str, *_flags: object) -> None:
        if not (isinstance(text, str) and NUMERIC_OR_OBJECT.fullmatch(text)):
            # Of other things not the text: that of tuples in tuples has no end.
            what = shown(text) if isinstance(text, str) else type(text).__name__
            msg = f'values of type {what} are no numbers'
            raise ValueError(msg)
        self.dtype = np.dtype(text)
        self.is_object = self.dtype.kind == 'O'

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _version, order, *_rest = state
        if not self.is_object:
            self.dtype = self.dtype.newbyteorder(order)

    def array(self, data: Any, shape: tuple[int, ...], order: str) -> Any:
        """Return numbers from bytes, which must be as many as the shape says; or the object."""
        if self.is_object:
            if shape != () or not isinstance(data, list) or len(data) != 1:
                msg = 'an array of objects'
                raise ValueError(msg)
            return data[0]
        values: NDArray[Any] = np.frombuffer(data, self.dtype).reshape(
            shape, order='F' if order == 'F' else 'C'
        )
        return values


class _Array:
    """Stands for a numpy.ndarray that is being filled; an array of one object is that object."""

    value: Any

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


_CORES = ('numpy.core', 'numpy._core')  # before and since numpy 2
SAFE: Mapping[tuple[str, str], _Maker | str] = MappingProxyType(
    {
        ('numpy', 'ndarray'): 'numpy.ndarray',  # an argument only
        ('numpy', 'dtype'): _Maker(_Dtype),
        **{(f'{core}.multiarray', '_reconstruct'): _Maker(_Array) for core in _CORES},
        **{(f'{core}.multiarray', 'scalar'): _Maker(_scalar) for core in _CORES},
        **{(f'{core}.numeric', '_frombuffer'): _Maker(_from_buffer) for core in _CORES},
    }
)


class _Unpickler(pickle._Unpickler):  # noqa: SLF001
    """Finds nothing but the names of `SAFE`, and makes mappings with plain keys only.

    That of C hashes a key before anybody can look at it, and the hash of a tuple of tuples of ...
    is a segmentation fault, or never ends.
    """

    stack: list[Any]
    pop_mark: Callable[[], list[Any]]

    def __init__(self, data: bytes) -> None:
        super().__init__(io.BytesIO(data))
        self._left = len(data)
        self._encoder = _Maker(self._encode)

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ('_codecs', 'encode'):
            return self._encoder
        if (module, name) not in SAFE:
            msg = f'{shown(f"{module}.{name}")} is not allowed in data'
            raise pickle.UnpicklingError(msg)
        return SAFE[module, name]

    def _encode(self, text: str, _encoding: str) -> bytes:
        """Protocol 2 stores bytes as text, in this encoding and no other, and each once."""
        self._left -= len(text)
        if self._left < 0:
            msg = 'it makes more bytes than the data have'
            raise pickle.UnpicklingError(msg)
        return text.encode('latin1')

    def _set_item(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        self._set(key, value)

    def _set_items(self) -> None:
        items = self.pop_mark()
        for key, value in zip(items[::2], items[1::2], strict=True):
            self._set(key, value)

    def _set(self, key: object, value: object) -> None:
        target = self.stack[-1]
        if not isinstance(target, dict) or not isinstance(key, str | int):
            msg = f'a key of type {type(key).__name__} is not allowed in data'
            raise pickle.UnpicklingError(msg)
        target[key] = value

    dispatch: ClassVar[dict[int, Any]] = pickle._Unpickler.dispatch | {  # noqa: SLF001
        pickle.SETITEM[0]: _set_item,
        pickle.SETITEMS[0]: _set_items,
    }


def _load(data: bytes) -> Any:
    for number, (opcode, argument, _) in enumerate(pickletools.genops(data)):
        if opcode.name not in OPCODES:
            msg = f'{opcode.name} is not allowed in data'
            raise pickle.UnpicklingError(msg)
        # An unpickler may keep places up to the highest number: 5 bytes could take 64 GiB.
        if opcode.name in PUTS and argument is not None and argument > number:
            msg = f'place {argument} of {number} is not allowed in data'
            raise pickle.UnpicklingError(msg)
        if number >= MAX_INSTRUCTIONS:
            msg = f'more than {MAX_INSTRUCTIONS} instructions'
            raise pickle.UnpicklingError(msg)
    return _Unpickler(data).load()


def read_arrays(path: Path, needed: Sequence[str] = ()) -> dict[str, NDArray[Any]]:
    """Read a pickled mapping of arrays of numbers; entries of other kinds are left out.

    Args:
        path: Of the file.
        needed: Entries that must be arrays where they are there.

    Raises:
        InputError: Missing, too large, damaged, or more than arrays.

    """
    return arrays_of(path, read_bytes(path, MAX_BYTES), needed)


def arrays_of(path: Path, data: bytes, needed: Sequence[str] = ()) -> dict[str, NDArray[Any]]:
    """Do what `read_arrays` does with the bytes of a file; the path is for messages."""
    try:
        tree = _load(data)
    except DAMAGE as error:
        raise refusal(path, f'no pickle of plain arrays: {shown(str(error))}') from error
    if not isinstance(tree, dict):
        raise refusal(path, 'need a mapping of arrays')
    found = {
        key: value.value
        for key, value in tree.items()
        if isinstance(key, str)
        and isinstance(value, _Array)
        and isinstance(value.value, np.ndarray)
    }
    for name in needed:
        if name in tree and name not in found:
            raise refusal(path, f'{name} is no array of numbers')
    return found


def read_npz_tree(path: Path, name: str) -> dict[str, dict[str, Any]]:
    """Read a mapping of mappings that somebody gave to numpy.savez.

    Args:
        path: Of the .npz file.
        name: Of the array in it: one object, which is a pickle.

    Returns:
        Outer key -> inner key -> an array of numbers, or a tuple of such arrays; entries of other
        kinds are left out.

    Raises:
        InputError: Missing, too large, damaged, or something else.

    """
    require_size(path, MAX_BYTES)
    try:
        with zipfile.ZipFile(path) as archive:
            member = archive.getinfo(f'{name}.npy')
            if member.file_size > MAX_UNPACKED_BYTES:
                raise refusal(path, f'{name} unpacks to {member.file_size} bytes: too many')
            with archive.open(member) as file:
                if np.lib.format.read_magic(file) != (1, 0):
                    raise refusal(path, f'{name} is no array of one object')
                # The header is left unread: numpy reads it as Python, and nothing of it is needed.
                (n_bytes,) = struct.unpack('<H', file.read(2))
                file.read(n_bytes)
                tree = _load(file.read())
    except ARCHIVE_DAMAGE as error:
        raise refusal(path, f'no {name}: {shown(str(error))}') from error
    tree = tree.value if isinstance(tree, _Array) else None
    if not isinstance(tree, dict):
        raise refusal(path, f'{name} is no mapping')
    inner = {key: entries for key, entries in tree.items() if isinstance(entries, dict)}
    return {
        outer: {name: _plain(value) for name, value in _named(path, outer, entries)}
        for outer, entries in _named(path, name, inner)
    }


def _named(path: Path, place: str, entries: dict[Any, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the entries of a mapping by names that can be told apart and printed."""
    seen = set()
    for key, value in entries.items():
        name = str(key)
        if not name.isprintable():
            raise refusal(path, f'in {shown(place)}, {shown(name)} is no name')
        if name in seen:
            raise refusal(path, f'{shown(place)} has {shown(name)} twice')
        seen.add(name)
        yield name, value


def _plain(value: Any) -> Any:
    """Return the array, or the tuple of arrays, of an entry; None for other things."""
    if isinstance(value, list | tuple):
        return tuple(_plain(part) for part in value if isinstance(part, _Array))
    found = value.value if isinstance(value, _Array) else None
    return found if isinstance(found, np.ndarray) else None
