# SPDX-License-Identifier: Apache-2.0
"""Damages bytes and plain data as fuzzers do: at random, repeatably, with a liking for edges."""

from __future__ import annotations

import copy
import random
import re
import struct
from collections.abc import Callable, Sequence
from typing import Any

NUMBERS = (0, 1, 2, 7, 127, 128, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63, -1)
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 1e308, -1e308, float('nan'), float('inf'), 2**70, '', ' ', 'a',
    'cam0', 'm', '1e400', '\x00', '\u202e', 'x' * 300, [], [[]], [1, 2, 3],
    [0] * 400, {}, {'a': 1},
    {'xyz': [0, 0, 0], 'quat_xyzw': [0, 0, 0, 0]},
)  # fmt: skip

TAGS = ('!!int', '!!float', '!!bool', '!!null', '!!timestamp', '!!binary', '!!set', '!!omap', '!x')


def damage(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return bytes after one to four kinds of damage.

    Args:
        data: Whole.
        others: What pieces are taken from.
        rng: Chooses.

    """
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        rng.choice(KINDS)(out, others, rng)
    return bytes(out)


def _flip(out: bytearray, _others: Sequence[bytes], rng: random.Random) -> None:
    for _ in range(rng.choice((1, 1, 3, 20))):
        if out:
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)


def _number(out: bytearray, _others: Sequence[bytes], rng: random.Random) -> None:
    code = rng.choice(('<B', '<H', '<I', '<Q', '>I'))
    size = struct.calcsize(code)
    if len(out) >= size:
        place = rng.randrange(len(out) - size + 1)
        out[place : place + size] = struct.pack(code, rng.choice(NUMBERS) % 256**size)


def _cut(out: bytearray, _others: Sequence[bytes], rng: random.Random) -> None:
    if out:
        start = rng.randrange(len(out))
        del out[start : start + rng.choice((1, 4, 8, 100, len(out)))]


def _insert(out: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    other = rng.choice(others)
    start = rng.randrange(len(other) + 1)
    piece = other[start : start + rng.choice((1, 4, 30, 500))]
    place = rng.randrange(len(out) + 1)
    out[place:place] = piece


def _repeat(out: bytearray, _others: Sequence[bytes], rng: random.Random) -> None:
    if out:
        start = rng.randrange(len(out))
        piece = out[start : start + rng.choice((1, 8, 64, 1000))]
        out[start:start] = piece * rng.choice((1, 2, 50))


def _digits(out: bytearray, _others: Sequence[bytes], rng: random.Random) -> None:
    """Replace a number that is written out."""
    found = list(re.finditer(rb'-?\d+(\.\d+)?', bytes(out)))
    if found:
        match = rng.choice(found)
        new = str(rng.choice((*NUMBERS, '1e400', '.nan', '.inf', '0x1F', '~'))).encode()
        out[match.start() : match.end()] = new


KINDS: tuple[Callable[[bytearray, Sequence[bytes], random.Random], None], ...] = (
    _flip, _number, _cut, _insert, _repeat, _digits,
)  # fmt: skip


def damage_tree(tree: Any, rng: random.Random) -> Any:
    """Return plain data with up to four values replaced, removed, renamed or doubled."""
    out = copy.deepcopy(tree)
    for _ in range(rng.choice((1, 1, 2, 4))):
        places = list(_places(out))
        if not places:
            return out
        holder, key = rng.choice(places)
        kind = rng.randrange(4)
        if kind == 0:
            holder[key] = copy.deepcopy(rng.choice(VALUES))
        elif kind == 1:
            del holder[key]
        elif isinstance(holder, list):
            holder.insert(key, copy.deepcopy(holder[key]))
        elif kind == 2:
            holder[f'{key}x'] = holder.pop(key)
        else:
            other, name = rng.choice(places)
            holder[key] = copy.deepcopy(other[name] if other is not holder else holder[key])
    return out


def tagged(text: str, rng: random.Random) -> str:
    """Return YAML with a tag before one value, and perhaps an empty text in its place."""
    ends = [match.end() for match in re.finditer(r'(: |- |\[|, )(?=\S)', text)]
    if not ends:
        return text
    at = rng.choice(ends)
    value = rng.choice(('', '"" #', '"-" #'))
    return f'{text[:at]}{rng.choice(TAGS)} {value}{text[at:]}'


def _places(tree: Any) -> Any:
    """Yield every holder and key of plain data."""
    keys = list(tree) if isinstance(tree, dict) else range(len(tree))
    for key in keys:
        yield tree, key
        if isinstance(tree[key], dict | list):
            yield from _places(tree[key])
