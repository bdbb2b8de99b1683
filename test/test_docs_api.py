# SPDX-License-Identifier: Apache-2.0
"""The page of the Python API is in step with the docstrings."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest
from pages import ROOT

import rpgd_ros.core


@pytest.fixture
def script() -> ModuleType:
    """Return the program that writes the page, as a module."""
    spec = importlib.util.spec_from_file_location('api_page', ROOT / 'docs' / 'api_page.py')
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_page_is_that_of_the_code(script: ModuleType) -> None:
    """After a change of a docstring: python docs/api_page.py."""
    assert (ROOT / 'docs' / 'api.md').read_text() == script.page()


def test_check_fails_on_a_page_of_other_code_and_writing_mends_it(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit 1 and what to run; after that, 0."""
    page = tmp_path / 'docs' / 'api.md'
    page.parent.mkdir()
    page.write_text('of last year')
    monkeypatch.setattr(script, 'PAGE', page)
    monkeypatch.setattr(sys, 'argv', ['api_page.py', '--check'])
    assert script.main() == 1
    monkeypatch.setattr(sys, 'argv', ['api_page.py'])
    assert script.main() == 0
    monkeypatch.setattr(sys, 'argv', ['api_page.py', '--check'])
    assert script.main() == 0


def test_everything_that_core_exports_is_on_the_page(script: ModuleType) -> None:
    """With its docstring, and its arguments one by one."""
    text = script.page()
    for name in rpgd_ros.core.__all__:
        assert f'### `{name}`' in text
    assert '- `should_stop`: Polled; True ends the run with CANCELLED.' in text
    assert ' at 0x' not in text
