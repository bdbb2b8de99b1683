# SPDX-License-Identifier: Apache-2.0
"""What is fuzzed: each target takes damaged input, and may return or raise our own error only."""

from __future__ import annotations

import contextlib
import random
import resource
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import peers
import yaml
from bags import mcap_bytes, walk, write_bag, write_humble_bag
from mutation import damage, damage_tree, tagged
from studio import make_rig
from test_io_result_file import save
from test_messages_camera_info import payload as camera_info

from rpgd_ros.core.errors import InputError
from rpgd_ros.io.bag import open_bag
from rpgd_ros.io.result_file import read_result
from rpgd_ros.io.rig import parse_rig, rig_text
from rpgd_ros.messages import JOINT_TYPES, decode_camera_info, decode_joints

EXAMPLE_RIG = Path(__file__).parents[1] / 'config' / 'rigs' / 'example_rig.yaml'
MAX_SECONDS = 20.0  # for one input, on a busy machine: a hang takes longer
MAX_GROWTH_MIB = 300.0  # of the peak of the whole run

Target = Callable[[random.Random], None]


class Fuzzed(NamedTuple):
    """How a run of a target went.

    Attributes:
        n_inputs: How many were tried.
        slowest_s: The longest time for one.
        growth_mib: By how much the peak of the memory rose.

    """

    n_inputs: int
    slowest_s: float
    growth_mib: float


def decoder() -> Target:
    """Return a target that decodes messages of joints and intrinsics."""
    n = 4
    rows = np.zeros(n, [('x', 'f8'), ('y', 'f8'), ('z', 'f8'), ('confidence', 'f4')])
    rows['x'], rows['z'] = np.arange(n), 2.0
    pixels = np.ones(n, [('u', 'f4'), ('v', 'f4'), ('confidence', 'f4')])
    poses = np.random.default_rng(0).normal(size=(n, 7))
    messages = [peers.point_cloud2(rows), peers.point_cloud2(pixels), peers.pose_array(poses)]
    whole = [
        peers.serialise(m, little_endian=little) for m in messages for little in (True, False)
    ]
    infos = [camera_info(), camera_info(d=[0.1] * 8, distortion_model='rational_polynomial')]

    def run(rng: random.Random) -> None:
        if rng.random() < 0.2:
            with contextlib.suppress(InputError):
                info = damage(rng.choice(infos), infos, rng)
                decode_camera_info(info).camera('cam0', None, is_rectified=rng.random() < 0.5)
            return
        batch = [damage(rng.choice(whole), whole, rng) for _ in range(rng.choice((1, 1, 5)))]
        n_values: Literal[2, 3] = 2 if rng.random() < 0.5 else 3
        decoded = decode_joints(rng.choice(JOINT_TYPES), batch, n_joints=n, n_values=n_values)
        n_used = 0
        if decoded.batch is not None:
            n_used = len(decoded.batch.stamp_ns)
            assert decoded.batch.values.shape == (n_used, n, n_values)
            assert not np.isinf(decoded.batch.values).any()
        assert n_used + sum(decoded.dropped.values()) == len(batch)

    return run


def text_target(tree: Any, text: str, read: Callable[[str], object]) -> Target:
    """Return a target that reads YAML, damaged as text or as plain data.

    Args:
        tree: Plain data.
        text: The same with comments and in another layout.
        read: Returns, or raises our error.

    """
    texts = [text.encode(), yaml.safe_dump(tree).encode()]

    def run(rng: random.Random) -> None:
        if rng.random() < 0.5:
            spoilt = damage(rng.choice(texts), texts, rng).decode(errors='replace')
        else:
            spoilt = yaml.safe_dump(damage_tree(tree, rng))
        if rng.random() < 0.1:
            spoilt = tagged(spoilt, rng)
        with contextlib.suppress(InputError):
            read(spoilt)

    return run


def rig_file() -> Target:
    """Return a target that reads rig files; what it takes must read back the same."""
    text = EXAMPLE_RIG.read_text()

    def read(spoilt: str) -> None:
        rig = parse_rig(spoilt)
        again = parse_rig(rig_text(rig))
        assert again.mocap == rig.mocap
        for one, other in zip(rig.cameras, again.cameras, strict=True):
            assert (one.name, one.pairs) == (other.name, other.pairs)
            if one.extrinsics is not None and other.extrinsics is not None:
                delta = one.extrinsics.matrix - other.extrinsics.matrix
                assert np.abs(delta).max() <= 1e-12 * np.abs(one.extrinsics.matrix).max()

    trees = {'example': yaml.safe_load(text), 'studio': yaml.safe_load(rig_text(make_rig(2)))}
    targets = [text_target(tree, text, read) for tree in trees.values()]
    return lambda rng: rng.choice(targets)(rng)


def result_file(folder: Path) -> Target:
    """Return a target that reads result files; what it takes is a pose."""
    path = folder / 'result.yaml'
    save(path)
    text = path.read_text()

    def read(spoilt: str) -> None:
        path.write_text(spoilt)
        stored = read_result(path)
        assert np.isfinite(stored.world_T_mocap.matrix).all()
        assert np.isfinite(stored.covariance).all()

    return text_target(yaml.safe_load(text), text, read)


def bag(folder: Path) -> Target:
    """Return a target that reads recordings of every storage and compression."""
    messages = walk(6)
    makers: dict[str, Callable[[Path], Path]] = {
        'mcap': lambda p: write_bag(p, messages),
        'chunks': lambda p: write_bag(p, messages, compression='chunk'),
        'sqlite3': lambda p: write_bag(p, messages, storage='sqlite3'),
        'humble': lambda p: write_humble_bag(p, messages),
        'humble_messages': lambda p: write_humble_bag(p, messages, compression='message'),
        'humble_file': lambda p: write_humble_bag(p, messages, compression='file'),
    }
    folders = [make(folder / name) for name, make in makers.items()]
    scanned = folder / 'scanned'
    scanned.mkdir()
    for name in ('', 'lz4', 'zstd'):
        (scanned / f'{name}.mcap').write_bytes(mcap_bytes(messages, compression=name))
    files = [file for place in (*folders, scanned) for file in place.iterdir()]
    whole = {file: file.read_bytes() for file in files}

    def run(rng: random.Random) -> None:
        file = rng.choice(files)
        alike = [data for other, data in whole.items() if other.suffix == file.suffix]
        file.write_bytes(damage(whole[file], alike, rng))
        is_part = file.parent != scanned and rng.random() < 0.8
        try:
            with open_bag(file.parent if is_part else file) as opened:
                n_read = sum(1 for _ in opened.stream(opened.topics))
                assert n_read == opened.n_read
        except InputError:
            pass
        finally:
            file.write_bytes(whole[file])

    return run


def fuzz(target: Target, seed: int, *, n_inputs: int = 0, seconds: float = 0.0) -> Fuzzed:
    """Run a target on many inputs; fail with the number of the input that it does not bear.

    Args:
        target: What to run.
        seed: Of the first input; input i has seed + i.
        n_inputs: How many, or 0 for as many as fit into
        seconds: that time.

    """
    end = time.monotonic() + seconds
    warnings.simplefilter('error', RuntimeWarning)  # numpy's, of numbers that went wrong
    slowest_s, before_mib = 0.0, peak_mib()
    for i in numbers(n_inputs):
        start = time.monotonic()
        if not n_inputs and start > end:
            break
        try:
            target(random.Random(seed + i))  # noqa: S311 (nothing secret)
        except BaseException as error:
            error.add_note(f'input {seed + i}')
            raise
        slowest_s = max(slowest_s, time.monotonic() - start)
    done = Fuzzed(i, slowest_s, peak_mib() - before_mib)
    assert done.slowest_s < MAX_SECONDS, done
    assert done.growth_mib < MAX_GROWTH_MIB, done
    return done


def numbers(n: int) -> Iterator[int]:
    """Count to n, or without end where that is 0."""
    i = 0
    while not n or i <= n:
        yield i
        i += 1


def peak_mib() -> float:
    """Return the most memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
