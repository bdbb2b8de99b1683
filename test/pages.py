# SPDX-License-Identifier: Apache-2.0
"""The pages of the documentation, and the commands that they tell people to type."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGES = (ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'docs').glob('*.md')))
SHELLS = frozenset({'sh', 'bash', 'console'})
_FENCE = re.compile(r'^```(\w*)\n(.*?)^```', re.DOTALL | re.MULTILINE)
_EXIT = re.compile(r'# exit code (\d+)')


class Command(NamedTuple):
    """One command of a page.

    Attributes:
        page: Where it stands, from the root.
        words: As a shell would split them.
        exit_code: What the page says of it; 0 where it says nothing.

    """

    page: str
    words: tuple[str, ...]
    exit_code: int = 0

    @property
    def program(self) -> str:
        """What is called."""
        return self.words[0]


def name_of(page: Path) -> str:
    """Return the path of a page from the root."""
    return page.relative_to(ROOT).as_posix()


def blocks(text: str, languages: frozenset[str] = SHELLS) -> list[tuple[str, str]]:
    """Return language and text of the fenced blocks."""
    return [(found[1], found[2]) for found in _FENCE.finditer(text) if found[1] in languages]


def commands(page: Path) -> list[Command]:
    """Return the commands of a page in its order; `a && b` are two."""
    found = []
    for language, text in blocks(page.read_text()):
        for line in text.replace('\\\n', ' ').splitlines():
            if language == 'console' and not line.startswith('$ '):
                continue  # what the program answers
            said = _EXIT.search(line)
            words = shlex.split(line.removeprefix('$ '), comments=True)
            code = int(said[1]) if said else 0
            found += [Command(name_of(page), part, code) for part in _parts(words)]
    return found


def _parts(words: list[str]) -> list[tuple[str, ...]]:
    parts: list[list[str]] = [[]]
    for word in words:
        if word == '&&':
            parts.append([])
        else:
            parts[-1].append(word)
    return [tuple(part) for part in parts if part]


def all_commands() -> list[Command]:
    """Return the commands of all pages."""
    return [command for page in PAGES for command in commands(page)]


def anchors(text: str) -> set[str]:
    """Return the anchors that GitHub gives the headings of a page."""
    titles = re.findall(r'^#+ (.*)$', _FENCE.sub('', text), re.MULTILINE)
    plain = (re.sub(r'\[([^\]]*)\]\([^)]*\)', r'\1', title).lower() for title in titles)
    return {re.sub(r'[^\w\- ]', '', title).replace(' ', '-') for title in plain}
