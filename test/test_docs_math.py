# SPDX-License-Identifier: Apache-2.0
"""Equations of the pages are written as GitHub sets them: the forms that Markdown leaves alone."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pages import PAGES, name_of

BLOCK = re.compile(r'^```math\n(.*?)^```', re.DOTALL | re.MULTILINE)
FENCE = re.compile(r'^```.*?^```', re.DOTALL | re.MULTILINE)
INLINE = re.compile(r'\$`([^`]*)`\$')
# Set by MathJax with base and ams alone; whoever adds one looks at it there first.
MACROS = frozenset(
    re.findall(
        r'\w+',
        """Big Sigma alpha bar begin beta delta dot ell end exp frac gamma ge hat in lVert lambda
        left log lvert mathcal mathrel mathrm max mid nu omega partial pi qquad quad rVert rho
        right rvert sigma sim sqrt sum tag tau text tfrac theta times to top varepsilon""",
    )
)
WITH_EQUATIONS = [page for page in PAGES if '$`' in page.read_text()]


@pytest.mark.parametrize('page', WITH_EQUATIONS, ids=name_of)
def test_equations_are_in_the_forms_that_github_knows(page: Path) -> None:
    """Fenced as `math`, or between $` and `$ that touch no letter and end in their line."""
    text = FENCE.sub('', page.read_text())
    for found in INLINE.finditer(text):
        before, after = text[max(0, found.start() - 1) : found.start()], text[found.end() :][:1]
        assert not re.match(r'\w', before + ' '), found[0]
        assert not re.match(r'\w', after + ' '), found[0]
        assert '\n' not in found[1], found[0]
    rest = re.sub(r'`[^`\n]*`', '', INLINE.sub('', text))
    assert '$' not in rest
    rows = [line for line in text.splitlines() if line.startswith('|')]
    assert not [row for row in rows for found in INLINE.finditer(row) if '|' in found[1]]


@pytest.mark.parametrize('page', WITH_EQUATIONS, ids=name_of)
def test_equations_hold_no_macro_that_was_not_looked_at(page: Path) -> None:
    """GitHub refuses operatorname, newcommand, href and their like; braces are closed."""
    text = page.read_text()
    for equation in (*BLOCK.findall(text), *INLINE.findall(FENCE.sub('', text))):
        assert set(re.findall(r'\\([A-Za-z]+)', equation)) <= MACROS, equation
        plain = re.sub(r'\\[{}]', '', equation)
        assert plain.count('{') == plain.count('}'), equation
        opened = re.findall(r'\\begin\{(\w+)\}', equation)
        assert sorted(opened) == sorted(re.findall(r'\\end\{(\w+)\}', equation)), equation
        assert len(re.findall(r'\\left\b', equation)) == len(re.findall(r'\\right\b', equation))
