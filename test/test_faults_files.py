# SPDX-License-Identifier: Apache-2.0
"""Files and messages under fire: kills in the middle of a save, damage anywhere."""

from __future__ import annotations

import ast
import random
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import fuzzing
import pytest
from bags import Message, write_bag
from fault_report import Measured, repeats, within
from harness import REPOSITORY
from studio import Studio, bits, feed, make_studio

from rpgd_ros.apps import calibrate_bag
from rpgd_ros.io.atomic import remove_leftovers
from rpgd_ros.io.result_file import read_result
from rpgd_ros.io.rig import write_rig
from rpgd_ros.messages import POINT_CLOUD2, encode_point_cloud2
from rpgd_ros.session import MOCAP, Session

SAVE_LOOP = """
import sys
sys.path.insert(0, sys.argv[2])
from test_io_result_file import make_calibration
from rpgd_ros.io.result_file import write_result
found = make_calibration()
print('ready', flush=True)
n = 0
while True:
    n += 1
    write_result(sys.argv[1], found, world_frame='w', mocap_frame='m', stamp_ns=n)
"""
TEST = Path(__file__).parent


@pytest.fixture(scope='module')
def studio() -> Studio:
    """Return two cameras and a person who walks through the room."""
    return make_studio(2)


@pytest.mark.fault(3)
def test_killed_saves_leave_a_whole_result(tmp_path: Path, measured: Measured) -> None:
    """At any moment: the file and its backups are whole, and leftovers go at the next start."""
    path = tmp_path / 'result.yaml'
    rng = random.Random(0)  # noqa: S311
    n_kills = repeats(60, 6)
    newest = 0
    for _ in range(n_kills):
        arguments = [sys.executable, '-c', SAVE_LOOP, str(path), str(TEST)]
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, cwd=REPOSITORY) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b'ready\n'
            # Until anywhere in the loop, which is what a kill is about; nothing is waited for.
            threading.Event().wait(rng.uniform(0.0, 0.3))
            process.send_signal(signal.SIGKILL)
        for file in tmp_path.glob('*.yaml'):
            newest = max(newest, read_result(file).stamp_ns)
    assert newest > 1
    remove_leftovers(path)
    measured('unreadable', 0, n=n_kills)
    assert not [p for p in tmp_path.iterdir() if p.name.endswith('.tmp')]


@pytest.mark.fault(10)
def test_malformed_messages_leave_the_result_bit_for_bit(
    studio: Studio, measured: Measured
) -> None:
    """Cut, of other joints, of nothing: each is counted, none changes anything."""
    whole = feed(Session(studio.rig), studio.messages)
    rng = random.Random(1)  # noqa: S311
    session = Session(studio.rig)
    expected: dict[str, int] = {}
    for i, message in enumerate(studio.messages):
        feed(session, [message])
        if i % 10 or message[0] != MOCAP:
            continue
        reason, bad = malformed(message[1], rng)
        expected[reason] = expected.get(reason, 0) + 1
        session.add(MOCAP, POINT_CLOUD2, [bad], [message[2]])
    counts = session.counts(MOCAP)
    measured('counted by reason', n=sum(expected.values()))
    assert sum(expected.values()) > 50
    assert {reason: counts[reason] for reason in expected} == expected
    assert bits(session.snapshot()) == bits(whole.snapshot())


def malformed(payload: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Return a reason, and a message that is to be dropped for it."""
    stamp_ns = 1_700_000_000_000_000_000
    n_joints = rng.choice((11, 13, 1))
    rows = [[1.0, 2.0, 3.0]] * n_joints
    return rng.choice((
        ('malformed', payload[: rng.randrange(len(payload))]),
        ('malformed', rng.randbytes(rng.randrange(100))),
        ('wrong_joints', encode_point_cloud2(stamp_ns, 'vicon', rows)),  # type: ignore[arg-type]
        ('oversized', bytes(300_000)),
    ))  # fmt: skip


def recorded(folder: Path, studio: Studio, storage: str) -> tuple[Path, Path]:
    """Write a recording and its rig file."""
    topics = {MOCAP: '/mocap/skeleton'}
    topics |= {c.name: f'/{c.keypoints_topic}' for c in studio.rig.cameras}
    # A third of it: enough for a result, and quick to solve a hundred times.
    part = studio.messages[: len(studio.messages) // 3]
    messages = [Message(topics[s], POINT_CLOUD2, at, payload) for s, payload, at in part]
    path = write_bag(folder / 'walk', messages, storage=storage)
    rig = folder / 'rig.yaml'
    write_rig(rig, studio.rig)
    return path, rig


@pytest.mark.fault(22)
@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize('damage', ['cut', 'flip'])
def test_damaged_bag_gives_a_result_or_a_reason(
    tmp_path: Path,
    studio: Studio,
    storage: str,
    damage: str,
    measured: Measured,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Wherever the damage is: an exit code with a meaning, no traceback, no hang."""
    path, rig = recorded(tmp_path, studio, storage)
    (file,) = (p for p in path.iterdir() if p.suffix != '.yaml')
    data = file.read_bytes()
    rng = random.Random(2)  # noqa: S311
    n = repeats(50, 4)
    codes: dict[int, int] = {}
    for _ in range(n):
        place = rng.randrange(len(data))
        broken = bytearray(data[:place] if damage == 'cut' else data)
        if damage == 'flip':
            broken[place] ^= 1 << rng.randrange(8)
        file.write_bytes(broken)
        start = time.monotonic()
        code = calibrate_bag.main([str(path), '--rig', str(rig)])
        measured('end', time.monotonic() - start, 's', n=n)
        assert time.monotonic() - start < within(30.0)
        said = ''.join(capsys.readouterr())
        assert 'Traceback' not in said
        codes[code] = codes.get(code, 0) + 1
        if code == 3:
            assert re.search(r'\d+\s+of\s+\d+\s+messages', said), said
    assert set(codes) <= {0, 1, 2, 3}
    for code, count in codes.items():
        measured(f'{damage} {storage}: {count} x exit {code}', n=n)
    if damage == 'cut':
        assert 0 not in codes


@pytest.mark.fault(22)
def test_bag_without_metadata_and_empty_bag_are_told_apart(
    tmp_path: Path, studio: Studio, capsys: pytest.CaptureFixture[str]
) -> None:
    """The one is used and called partial, the other is bad input."""
    path, rig = recorded(tmp_path, studio, 'mcap')
    (path / 'metadata.yaml').unlink()
    assert calibrate_bag.main([str(path), '--rig', str(rig)]) == 3
    shutil.rmtree(path)
    path.mkdir()
    assert calibrate_bag.main([str(path), '--rig', str(rig)]) == 2
    assert 'Traceback' not in ''.join(capsys.readouterr())


TARGETS: dict[str, tuple[tuple[object, ...], Callable[[Path], fuzzing.Target], int]] = {
    'messages': ((10,), lambda _: fuzzing.decoder(), 2000),
    'rig file': ((23, 'S2'), lambda _: fuzzing.rig_file(), 200),
    'result file': ((23, 'S2'), fuzzing.result_file, 150),
    'recording': ((22,), fuzzing.bag, 150),
}


@pytest.mark.parametrize(
    'name', [pytest.param(name, marks=pytest.mark.fault(*TARGETS[name][0])) for name in TARGETS]
)
def test_fuzzed_input_is_read_or_refused(tmp_path: Path, name: str, measured: Measured) -> None:
    """A thousand damaged inputs; `long_fuzz.py` tries for ten minutes each."""
    _, make, n = TARGETS[name]
    done = fuzzing.fuzz(make(tmp_path), 0, n_inputs=repeats(10 * n, n))
    measured(f'slowest {name}', done.slowest_s, 's', n=done.n_inputs)


@pytest.mark.threat('S10')
def test_every_dependency_is_bounded(measured: Measured) -> None:
    """What pip installs with the package has a lowest version and a highest one."""
    tree = ast.parse((REPOSITORY / 'setup.py').read_text())
    texts = [n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)]
    names = re.compile(r'[A-Za-z][\w.-]*(\[\w+\])?(>=|==)[\d.]+(,<[\d.]+)?')
    needed = [t for t in texts if isinstance(t, str) and names.fullmatch(t)]
    assert len(needed) > 10
    unbounded = [t for t in needed if '==' not in t and ',<' not in t]
    assert unbounded in ([], ['distributed>=2024.1'])  # numbered by the calendar
    measured('dependencies bounded', n=len(needed))
