# SPDX-License-Identifier: Apache-2.0
"""Pickles and archives that would crash, hang or fill a reader, or name what nobody could."""

from __future__ import annotations

import io
import os
import pickle
import resource
import struct
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rpgd_ros.core.errors import InputError
from rpgd_ros.datasets.pickles import arrays_of, read_npz_tree

# A key of nested tuples: `hash` of it ends in a segmentation fault.
DEEP = b'N' + b'\x85' * 1_000_000
# (t, t) of (t, t) of ...: 60 levels take 2**60 steps to hash, and as many characters to print.
WIDE = b'Nq\x00' + b''.join(b'h%c\x86q%c' % (i, i + 1) for i in range(60))
SKELETON = np.zeros((3, 32, 3))


def said_in_a_process(folder: Path, call: str, *, mib: int = 1024) -> str:
    """Return what a reader complains of in a process with limits: what may kill or hang it."""
    program = (
        'import sys\n'
        'from pathlib import Path\n'
        'from rpgd_ros.core.errors import InputError\n'
        'from rpgd_ros.datasets import pickles\n'
        f'try:\n    pickles.{call}\n'
        'except InputError as error:\n    sys.stdout.write(error.message)\n'
    )

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (mib * 2**20,) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    done = subprocess.run(
        [sys.executable, '-c', program],
        capture_output=True,
        text=True,
        check=False,
        timeout=60.0,
        cwd=folder,
        env=os.environ | {'PYTHONPATH': str(Path(__file__).parents[1])},
        preexec_fn=limit,
    )
    assert done.returncode == 0, done.stderr[-300:]
    return done.stdout


def npz(path: Path, data: bytes, *, method: int = zipfile.ZIP_DEFLATED) -> Path:
    """Write an archive whose positions_3d is a pickle of one object."""
    with io.BytesIO() as header:
        layout: dict[str, Any] = {'descr': '|O', 'fortran_order': False, 'shape': ()}
        np.lib.format.write_array_header_1_0(header, layout)
        with zipfile.ZipFile(path, 'w', method) as archive:
            archive.writestr('positions_3d.npy', header.getvalue() + data)
    return path


def pickled(tree: dict[Any, Any]) -> bytes:
    """Return the pickle of an array of one object."""
    return pickle.dumps(np.array(tree, dtype=object), 4)


@pytest.mark.threat('S1')
@pytest.mark.parametrize('key', [DEEP, WIDE], ids=['deep', 'wide'])
def test_tuples_in_tuples_are_no_keys(key: bytes, tmp_path: Path) -> None:
    """Python's own hash of them ends in a segmentation fault, or never."""
    (tmp_path / 'a.pkl').write_bytes(b'\x80\x02}' + key + b'Ns.')
    (tmp_path / 'b.pkl').write_bytes(b'\x80\x02}(' + key + b'Nu.')
    for name in ('a.pkl', 'b.pkl'):
        said = said_in_a_process(tmp_path, f'read_arrays(Path({name!r}))')
        assert 'a key of type tuple is not allowed in data' in said
    whole = pickled({'S9': {'a': SKELETON}})
    assert whole.count(b'\x8c\x01a') == 1
    npz(tmp_path / 'a.npz', whole.replace(b'\x8c\x01a', key))
    said = said_in_a_process(tmp_path, "read_npz_tree(Path('a.npz'), 'positions_3d')")
    assert said.startswith('a.npz: no positions_3d')


@pytest.mark.threat('S1')
def test_type_that_is_a_wide_tuple_is_not_shown(tmp_path: Path) -> None:
    """Its text would fill the memory."""
    dtype = b'X\x01\x00\x00\x00acnumpy\ndtype\n' + WIDE + b'\x85Rs.'
    (tmp_path / 'a.pkl').write_bytes(b'\x80\x02}' + dtype)
    said = said_in_a_process(tmp_path, "read_arrays(Path('a.pkl'))")
    assert 'values of type tuple are no numbers' in said


@pytest.mark.threat('S1')
def test_millions_of_empty_mappings_are_refused(tmp_path: Path) -> None:
    """Each byte of them would become 72; compressed, they take a thousandth."""
    npz(tmp_path / 'a.npz', b'\x80\x02](' + b'}' * 2**24 + b'e.')
    assert (tmp_path / 'a.npz').stat().st_size < 20_000
    call = "read_npz_tree(Path('a.npz'), 'positions_3d')"
    said = said_in_a_process(tmp_path, call, mib=768)
    assert 'more than 1048576 instructions' in said


@pytest.mark.threat('S1')
def test_text_is_not_encoded_again_and_again(tmp_path: Path) -> None:
    """A megabyte, encoded anew by five bytes each, would fill the memory."""
    text = b'X' + struct.pack('<I', 2**20) + b'a' * 2**20
    first = b'c_codecs\nencode\nq\x00' + text + b'X\x06\x00\x00\x00latin1\x86q\x01R'
    (tmp_path / 'a.pkl').write_bytes(b'\x80\x02](' + first + b'h\x00h\x01R' * 5000 + b'e.')
    said = said_in_a_process(tmp_path, "read_arrays(Path('a.pkl'))")
    assert 'more bytes than the data have' in said


@pytest.mark.parametrize('text', ['(1,f8', '(+)f8,f8', 'f8,f8', 'U9', 'm8[1/0s]', 'f8(', 'f99'])
def test_type_of_something_else_than_numbers_is_refused(text: str) -> None:
    """What numpy would take for a type, or choke on."""
    data = text.encode()
    made = b'acnumpy\ndtype\nX' + struct.pack('<I', len(data)) + data + b'\x89\x88\x87Rs.'
    with pytest.raises(InputError, match=r'a\.pkl: no pickle of plain arrays'):
        arrays_of(Path('a.pkl'), b'\x80\x02}X\x01\x00\x00\x00' + made)


@pytest.mark.parametrize('header', [b"{'descr': (", b'"""', b'\x00', b'(' * 300])
def test_header_of_an_array_of_one_object_is_not_run(header: bytes, tmp_path: Path) -> None:
    """What it says is not needed: the pickle behind it is what is read, or refused."""
    with zipfile.ZipFile(tmp_path / 'a.npz', 'w') as archive:
        start = b'\x93NUMPY\x01\x00' + struct.pack('<H', len(header)) + header
        archive.writestr('positions_3d.npy', start + pickled({'S9': {'a': SKELETON}}))
    found = read_npz_tree(tmp_path / 'a.npz', 'positions_3d')
    np.testing.assert_array_equal(found['S9']['a'], SKELETON)


@pytest.mark.parametrize('method', [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2, zipfile.ZIP_DEFLATED])
def test_damage_of_every_compression_is_refused(method: int, tmp_path: Path) -> None:
    """Flipped bytes end in arrays or in our error."""
    path = npz(tmp_path / 'a.npz', pickled({'S9': {'a': SKELETON}}), method=method)
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    n_refused = 0
    for _ in range(200):
        bad = bytearray(whole)
        for place in rng.integers(0, len(bad), rng.integers(1, 4)):
            bad[place] ^= 1 << int(rng.integers(0, 8))
        path.write_bytes(bad)
        try:
            read_npz_tree(path, 'positions_3d')
        except InputError:
            n_refused += 1
    assert n_refused > 50


@pytest.mark.parametrize(
    ('actions', 'message'),
    [
        ({1: 0, '1': 1}, "'S9' has '1' twice"),
        ({'a\x1b[31m': 0}, r"'a\\x1b\[31m' is no name"),
        ({'\ud800': 0}, r"'\\ud800' is no name"),
    ],
)
def test_names_that_nobody_could_tell_apart_or_print_are_refused(
    actions: dict[Any, int], message: str, tmp_path: Path
) -> None:
    """They become names of sequences, of files, and cells of tables."""
    entries = {name: np.full((3, 32, 3), float(value)) for name, value in actions.items()}
    path = npz(tmp_path / 'a.npz', pickled({'S9': entries}))
    with pytest.raises(InputError, match=message):
        read_npz_tree(path, 'positions_3d')
