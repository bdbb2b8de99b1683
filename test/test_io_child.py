# SPDX-License-Identifier: Apache-2.0
"""Reading in a process of its own: what arrives, whose fault it was, and what is left behind."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

from rpgd_ros.core.errors import InputError
from rpgd_ros.io.child import Content, read_in_child

# A reader that does what the file says.
READER = """
import numpy as np
import os, tempfile
def read(path):
    print('chatter of a library')
    with open(path) as file:
        exec(file.read(), globals())
    return {'name': os.path.basename(path)}, [np.arange(6.0).reshape(2, 3), np.zeros((0, 4))]
"""
DAMAGED = {
    'crash': ('os.abort()', 'cannot be read as text: damaged'),
    'error': ('raise RuntimeError("Unexpected section")', 'RuntimeError: Unexpected section'),
    'memory': ('bytearray(2**30)', 'it would take more than 512 MiB of memory'),
    'hang': ('while True: pass', 'within 3 s: it is damaged'),
    'disk': ('tempfile.TemporaryFile().truncate(2**30)', 'File too large'),
}


def read(folder: Path, **texts: str) -> list[Content]:
    """Write files, and have them read."""
    (folder / 'reader.py').write_text(READER)
    paths = [folder / name for name in texts]
    for path in paths:
        path.write_text(texts[path.name])
    return read_in_child(folder / 'reader.py', paths, what='text', seconds=3.0, memory=512 * 2**20)


def test_facts_and_arrays_arrive_in_the_order_of_the_files(tmp_path: Path) -> None:
    """Whatever the library prints; an array may be empty."""
    found = read(tmp_path, b='', a='')
    assert [content.facts for content in found] == [{'name': 'b'}, {'name': 'a'}]
    for content in found:
        np.testing.assert_array_equal(content.arrays[0], np.arange(6.0).reshape(2, 3))
        assert content.arrays[1].shape == (0, 4)


@pytest.mark.parametrize('what', sorted(DAMAGED))
def test_file_that_the_library_dies_of_is_named(what: str, tmp_path: Path) -> None:
    """Of those before it and behind it not a word."""
    does, message = DAMAGED[what]
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path, before='', bad=does, behind='')
    assert caught.value.message.startswith(f'{tmp_path / "bad"}: cannot be read as text')


def test_temporary_files_go_with_the_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where it was killed before it could remove them."""
    (tmp_path / 'here').mkdir()
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path / 'here'))
    with pytest.raises(InputError):
        read(tmp_path, bad='tempfile.mkstemp()\nos.abort()')
    assert list((tmp_path / 'here').iterdir()) == []
