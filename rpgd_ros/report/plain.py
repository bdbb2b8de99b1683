# SPDX-License-Identifier: Apache-2.0
"""Foreign text as it may be shown: what it does is not up to it."""

from __future__ import annotations

from unicodedata import category


def plain(text: str) -> str:
    r"""Return a text with everything that cannot be seen as an escape, as `\x1b` or `\u202e`.

    Names in recordings are anybody's: they could move the cursor of a terminal, or turn the
    direction of a sentence. Spaces and ends of lines stay.
    """
    if text.isprintable():
        return text
    return ''.join(c if _is_plain(c) else ascii(c)[1:-1] for c in text)


def _is_plain(character: str) -> bool:
    return character.isprintable() or character in '\n\t' or category(character) == 'Zs'
