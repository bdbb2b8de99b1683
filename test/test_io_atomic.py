# SPDX-License-Identifier: Apache-2.0
"""A file is written whole or not at all, whatever happens meanwhile."""

from __future__ import annotations

import os
import resource
import signal
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from rpgd_ros.core import InputError, Reason
from rpgd_ros.io.atomic import remove_leftovers, write_atomic

SAVE_LOOP = """
import sys
from rpgd_ros.io.atomic import write_atomic
print('ready', flush=True)
n = 0
while True:
    n += 1
    write_atomic(sys.argv[1], f'{n:06}' * 20000)
"""
KILLS = 12


def leftovers(folder: Path) -> list[str]:
    """Return the temporary files in a folder."""
    return sorted(p.name for p in folder.iterdir() if p.name.endswith('.tmp'))


def test_text_and_bytes_are_written_with_the_wanted_mode(tmp_path: Path) -> None:
    """Others may read the file, although temporary files are private."""
    path = tmp_path / 'a.yaml'
    write_atomic(path, 'früh')
    assert path.read_bytes() == 'früh'.encode()
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
    write_atomic(path, b'\x00\x01', mode=0o600)
    assert path.read_bytes() == b'\x00\x01'
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert leftovers(tmp_path) == []


@pytest.mark.threat('S4')
def test_link_as_target_is_refused(tmp_path: Path) -> None:
    """Neither the link nor what it points to changes."""
    (tmp_path / 'real').write_text('old')
    link = tmp_path / 'link'
    link.symlink_to(tmp_path / 'real')
    with pytest.raises(InputError, match='symbolic link') as refused:
        write_atomic(link, 'new')
    assert refused.value.reason is Reason.NOT_WRITABLE
    assert link.is_symlink()
    assert (tmp_path / 'real').read_text() == 'old'


def test_missing_folder_is_named(tmp_path: Path) -> None:
    """The message holds the path and the words of the operating system."""
    with pytest.raises(
        InputError, match=r'gone/a\.yaml cannot be written: No such file'
    ) as refused:
        write_atomic(tmp_path / 'gone' / 'a.yaml', 'x')
    assert refused.value.reason is Reason.NOT_WRITABLE


def test_folder_as_target_leaves_nothing_behind(tmp_path: Path) -> None:
    """The rename fails; the temporary file goes."""
    (tmp_path / 'folder' / 'x').mkdir(parents=True)
    with pytest.raises(InputError, match='cannot be written'):
        write_atomic(tmp_path / 'folder', 'x')
    assert leftovers(tmp_path) == []


@pytest.mark.fault(24)
def test_full_disk_keeps_the_old_file(tmp_path: Path) -> None:
    """With a limit on file sizes in place of a full disk."""
    path = tmp_path / 'a.yaml'
    write_atomic(path, 'old')
    code = (
        'import resource, signal, sys\n'
        'from rpgd_ros.core import InputError\n'
        'from rpgd_ros.io.atomic import write_atomic\n'
        'signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n'
        'resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n'
        'try:\n'
        '    write_atomic(sys.argv[1], "x" * 5000)\n'
        'except InputError as error:\n'
        '    sys.exit(0 if "File too large" in error.message else 1)\n'
        'sys.exit(2)\n'
    )
    assert resource.RLIMIT_FSIZE is not None
    done = subprocess.run([sys.executable, '-c', code, str(path)], check=False, timeout=30)
    assert done.returncode == 0
    assert path.read_text() == 'old'
    assert leftovers(tmp_path) == []


@pytest.mark.fault(24)
def test_failure_of_any_kind_removes_the_temporary_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also Ctrl-C in the middle of the write, which no handler of ours may swallow."""

    def interrupted(descriptor: int) -> None:
        del descriptor
        raise KeyboardInterrupt

    monkeypatch.setattr(os, 'fsync', interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_atomic(tmp_path / 'a.yaml', 'x')
    assert list(tmp_path.iterdir()) == []


@pytest.mark.fault(3)
def test_killed_writers_leave_a_whole_file(tmp_path: Path) -> None:
    """SIGKILL at many moments of a loop of saves; leftovers go at the next start."""
    path = tmp_path / 'result.yaml'
    for kill in range(KILLS):
        with subprocess.Popen(
            [sys.executable, '-c', SAVE_LOOP, str(path)], stdout=subprocess.PIPE
        ) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b'ready\n'
            # No wait is long enough to be at one point of the loop: each kill comes at another.
            threading.Event().wait(0.003 * (kill + 1))
            process.send_signal(signal.SIGKILL)
        if path.exists():
            text = path.read_text()
            assert len(text) == 120_000
            assert text == text[:6] * 20_000
    assert path.exists()
    remove_leftovers(path)
    assert leftovers(tmp_path) == []


def test_leftovers_of_living_writers_stay(tmp_path: Path) -> None:
    """Only temporary files of this target, of processes that are gone, are removed."""
    alive = tmp_path / f'.a[1].yaml.{os.getpid()}.xyz.tmp'
    dead = tmp_path / '.a[1].yaml.99999999.xyz.tmp'
    backup = tmp_path / '.a[1].20260131T120509.123.yaml.99999999.xyz.tmp'
    names = ('.b.yaml.99999999.x', '.a[1].yaml.note', f'.a[1].yaml.{10**20}.x', '.a[1].yaml.1.x')
    others = [tmp_path / f'{name}.tmp' for name in names]
    for path in (alive, dead, backup, *others):
        path.touch()
    remove_leftovers(tmp_path / 'a[1].yaml')
    assert not dead.exists()
    assert not backup.exists()
    assert all(path.exists() for path in (alive, *others))


@pytest.mark.fault(25)
def test_readers_never_see_half_a_file(tmp_path: Path) -> None:
    """Four writers and a reader: each read is one whole version, the last writer wins."""
    path = tmp_path / 'a.yaml'
    write_atomic(path, '0' * 10_000)
    torn: list[str] = []
    is_over = threading.Event()

    def read() -> None:
        while not is_over.is_set():
            text = path.read_text()
            if text != text[:1] * 10_000:
                torn.append(text[:10])

    def write(letter: str) -> None:
        for _ in range(25):
            write_atomic(path, letter * 10_000)

    reader = threading.Thread(target=read)
    writers = [threading.Thread(target=write, args=(letter,)) for letter in 'abcd']
    for thread in (reader, *writers):
        thread.start()
    for thread in writers:
        thread.join()
    is_over.set()
    reader.join()
    assert torn == []
    assert path.read_text()[0] in 'abcd'
    assert leftovers(tmp_path) == []
