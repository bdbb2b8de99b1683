# SPDX-License-Identifier: Apache-2.0
"""Pickles of arrays: what is read from them, and what is never run."""

from __future__ import annotations

import io
import os
import pickle
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rpgd_ros.core.errors import InputError
from rpgd_ros.datasets import pickles
from rpgd_ros.datasets.pickles import read_arrays
from rpgd_ros.simulation.dataset_pickle import pickled

ARRAYS: dict[str, NDArray[Any]] = {
    'keypoints2d': np.arange(24, dtype=np.float32).reshape(2, 3, 4),
    'timestamps': np.arange(3, dtype=np.int64),
    'scale': np.array(2.5),
    'turned': np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    'swapped': np.arange(3, dtype='>i4'),
}


def saved(path: Path, data: bytes) -> Path:
    """Write bytes and return where."""
    path.write_bytes(data)
    return path


@pytest.mark.parametrize('protocol', [2, 3, 4, 5])
def test_arrays_are_read_as_pickle_would(protocol: int, tmp_path: Path) -> None:
    """All protocols with binary data, both byte orders, both memory orders, scalars."""
    written = ARRAYS | {'number': np.float32(0.5)}
    found = read_arrays(saved(tmp_path / 'a.pkl', pickle.dumps(written, protocol)))
    assert found.pop('number') == 0.5
    assert found.keys() == ARRAYS.keys()
    for name, values in ARRAYS.items():
        assert found[name].dtype == values.dtype
        np.testing.assert_array_equal(found[name], values)


def test_arrays_of_numpy_1_are_read(tmp_path: Path) -> None:
    """The official files name numpy.core, which numpy 2 calls numpy._core."""
    data = pickle.dumps(ARRAYS, 4)
    old = data.replace(b'\x8c\x16numpy._core.multiarray', b'\x8c\x15numpy.core.multiarray')
    # A shorter name leaves the frame's length wrong: it is given anew.
    old = old[:3] + (len(old) - 11).to_bytes(8, 'little') + old[11:]
    assert b'numpy.core.multiarray' in old
    found = read_arrays(saved(tmp_path / 'a.pkl', old))
    np.testing.assert_array_equal(found['keypoints2d'], ARRAYS['keypoints2d'])


def test_written_pickles_are_those_of_numpy(tmp_path: Path) -> None:
    """Python's own pickle reads what the writer of the twins puts together, and so do we."""
    data = pickled({'a': ARRAYS['keypoints2d'], 'b': ARRAYS['timestamps']})
    theirs = pickle.loads(data)  # noqa: S301
    ours = read_arrays(saved(tmp_path / 'a.pkl', data))
    for name, source in (('a', 'keypoints2d'), ('b', 'timestamps')):
        np.testing.assert_array_equal(theirs[name], ARRAYS[source])
        np.testing.assert_array_equal(ours[name], ARRAYS[source])
        assert theirs[name].dtype == ours[name].dtype == ARRAYS[source].dtype


class Calls:
    """Pickles as a call of a function."""

    def __init__(self, function: Any, *arguments: object) -> None:
        """Say what is called."""
        self.call = (function, arguments)

    def __reduce__(self) -> tuple[Any, tuple[object, ...]]:
        """Tell pickle so."""
        return self.call


def crafted(marker: Path) -> dict[str, bytes]:
    """Return pickles that would create the marker file, or worse, if they were obeyed."""
    command = f'touch {marker}'
    system = Calls(os.system, command)
    inside = np.empty(1, dtype=object)
    inside[0] = system
    inst = f"(S'{command}'\nios\nsystem\n.".encode()
    return {
        'system': pickle.dumps(system),
        'value': pickle.dumps({'keypoints2d': system}),
        'key': pickle.dumps(OrderedDict([(1, system)])),
        'object array': pickle.dumps({'keypoints2d': inside}),
        'eval': pickle.dumps(Calls(eval, f'open({str(marker)!r}, "w")')),
        'open': pickle.dumps(Calls(io.open, str(marker), 'w')),
        'instance': inst,
        'protocol 0': f"cposix\nsystem\n(S'{command}'\ntR.".encode(),
        'nested name': b'\x80\x04\x8c\x05numpy\x8c\x10os.system\x93.',
        'extension': b'\x80\x02\x82\x01.',
        'persistent': b'\x80\x02Pmarker\n.',
        'array of objects': (
            b'\x80\x02}(X\x01\x00\x00\x00acnumpy.core.multiarray\n_reconstruct\n'
            b'cnumpy\nndarray\nK\x00\x85C\x01b\x87R(K\x01J\x00\x00\x00\x40\x85'
            b'cnumpy\ndtype\nX\x02\x00\x00\x00O8\x89\x88\x87R\x89]tbu.'
        ),
    }


@pytest.mark.threat('S1')
@pytest.mark.parametrize('name', sorted(crafted(Path('x'))))
def test_crafted_pickle_runs_nothing(name: str, tmp_path: Path) -> None:
    """It is refused with its path, and what it would have made is not there."""
    marker = tmp_path / 'marker'
    path = saved(tmp_path / 'a.pkl', crafted(marker)[name])
    with pytest.raises(InputError, match=r'a\.pkl: no pickle of plain arrays'):
        read_arrays(path)
    assert not marker.exists()


@pytest.mark.threat('S1')
def test_place_beyond_the_data_is_refused(tmp_path: Path) -> None:
    """Five bytes that would have the unpickler lay out 32 GiB of places."""
    bomb = b'\x80\x02}r\xff\xff\xff\x7f.'
    with pytest.raises(InputError, match='place 2147483647 of 2 is not allowed'):
        read_arrays(saved(tmp_path / 'a.pkl', bomb))


@pytest.mark.threat('S1')
def test_functions_of_the_reader_cannot_be_changed(tmp_path: Path) -> None:
    """A file that sets attributes of what it names would spoil the reading of the next one."""
    build = b'\x80\x02cnumpy\ndtype\nN}X\x05\x00\x00\x00arrayK\x01s\x86b.'
    with pytest.raises(InputError, match='a function has no state'):
        read_arrays(saved(tmp_path / 'a.pkl', build))
    found = read_arrays(saved(tmp_path / 'b.pkl', pickle.dumps(ARRAYS)))
    np.testing.assert_array_equal(found['timestamps'], ARRAYS['timestamps'])


@pytest.mark.threat('S1')
def test_shape_beyond_the_data_is_refused(tmp_path: Path) -> None:
    """A few bytes cannot claim a terabyte."""
    data = pickled({'a': np.zeros(3)})
    shape = b'(J\x03\x00\x00\x00t'
    assert shape in data
    bomb = data.replace(shape, b'(J\xff\xff\xff\x7fJ\xff\xff\xff\x7ft')
    with pytest.raises(InputError, match='no pickle of plain arrays'):
        read_arrays(saved(tmp_path / 'a.pkl', bomb))


def test_what_is_no_mapping_is_refused(tmp_path: Path) -> None:
    """A list of arrays is another format."""
    path = saved(tmp_path / 'a.pkl', pickle.dumps([1, 2]))
    with pytest.raises(InputError, match='need a mapping of arrays'):
        read_arrays(path)


def test_large_and_missing_files_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before a byte is read."""
    path = saved(tmp_path / 'a.pkl', pickle.dumps(ARRAYS))
    monkeypatch.setattr(pickles, 'MAX_BYTES', 10)
    with pytest.raises(InputError, match='such files have at most 10'):
        read_arrays(path)
    with pytest.raises(InputError, match=r'b\.pkl: cannot be read: No such file'):
        read_arrays(tmp_path / 'b.pkl')


@settings(derandomize=True, max_examples=150, deadline=None)
@given(st.data())
def test_damage_is_refused_or_read(data: st.DataObject) -> None:
    """Flipped and missing bytes end in numbers or in our error, never in another."""
    whole = bytearray(pickle.dumps(ARRAYS, data.draw(st.sampled_from([2, 4, 5]))))
    for _ in range(data.draw(st.integers(1, 3))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    cut = whole[: data.draw(st.integers(1, len(whole)))]
    try:
        found = pickles.arrays_of(Path('a.pkl'), bytes(cut))
    except InputError:
        return
    assert all(values.dtype.kind in 'biuf' for values in found.values())
