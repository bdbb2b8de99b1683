# SPDX-License-Identifier: Apache-2.0
"""What sections of a report are made of. To add a section, write a function that returns one."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

LONGEST = 80  # characters of a foreign name that are shown

Traces = Sequence[Mapping[str, Any]]


class Link(NamedTuple):
    """A sentence that leads to a place of the page.

    Attributes:
        text: The sentence.
        target: Key of a section or block; '' = none.

    """

    text: str
    target: str = ''


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph."""

    text: str
    kind: str = 'text'


@dataclass(frozen=True, slots=True)
class Bullets:
    """Sentences, one below the other."""

    items: tuple[Link, ...]
    kind: str = 'bullets'


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of words and numbers; all but the first `n_words` columns are set as numbers.

    Attributes:
        head: Names of the columns.
        rows: Cells.
        n_words: Columns that are words.
        marked: Numbers of the rows that a reader should look at.

    """

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    n_words: int = 1
    marked: frozenset[int] = frozenset()
    kind: str = 'table'


@dataclass(frozen=True, slots=True)
class Code:
    """Text to paste elsewhere, with a button that copies it."""

    label: str
    text: str
    note: str = ''
    kind: str = 'code'


@dataclass(frozen=True, slots=True)
class Figure:
    """A plot, as data and layout of Plotly.

    Colours that begin with `@` are names of the page's palette, which follows its theme.

    Attributes:
        key: Name within the page.
        caption: What it shows.
        traces: Plotly's data.
        layout: Plotly's layout.
        height: Pixels, at most where a ratio is given.
        ratio: Width over height of an image; 0 = the height is fixed.

    """

    key: str
    caption: str
    traces: Traces
    layout: Mapping[str, Any]
    height: int = 320
    ratio: float = 0.0
    kind: str = 'figure'


@dataclass(frozen=True, slots=True)
class Side:
    """Blocks beside each other, where the page is wide enough."""

    blocks: tuple[Figure | Table | Code, ...]
    kind: str = 'side'


Block = Text | Bullets | Table | Code | Figure | Side


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the page.

    Attributes:
        key: Name within the page.
        title: Heading.
        blocks: What stands in it.
        level: 2, or 3 for a part of the section before.
        is_marked: Whether a reader should look here first.

    """

    key: str
    title: str
    blocks: tuple[Block, ...]
    level: int = 2
    is_marked: bool = False


def rounded(values: NDArray[Any], digits: int = 1) -> list[Any]:
    """Return an array as nested lists of rounded numbers; what is none becomes None."""
    if values.dtype.kind in 'iub':
        plain: list[Any] = values.tolist()
        return plain
    table = np.round(values.astype(np.float64), digits)
    whole = table.astype(object)
    whole[~np.isfinite(table)] = None
    out: list[Any] = whole.tolist()
    return out


def label(text: str) -> str:
    """Return foreign text for a plot, whose labels would otherwise read tags in it."""
    short = text if len(text) <= LONGEST else f'{text[: LONGEST - 1]}…'
    return short.replace('&', '&amp;').replace('<', '&lt;').replace('>', '&gt;')


def labels(names: Sequence[str]) -> list[str]:
    """Return labels of one axis; names that are cut to the same text get their numbers."""
    cut = [label(name) for name in names]
    times = Counter(cut)
    return [text if times[text] == 1 else f'{text} ({i})' for i, text in enumerate(cut, 1)]


def number(value: float, digits: int = 2, unit: str = '') -> str:
    """Set a number with its unit; a dash where there is none."""
    if not math.isfinite(value):
        return '–'  # noqa: RUF001
    text = f'{value:.{digits}f}'.replace('-', '\N{MINUS SIGN}')
    return f'{text}\N{NO-BREAK SPACE}{unit}' if unit else text


def percent(share: float) -> str:
    """Set a share."""
    return number(100.0 * share, 1, '%')
