# SPDX-License-Identifier: Apache-2.0
"""Nothing that is read is written over, no output by another, and no work is done in vain."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from bags import walk, write_bag

from rpgd_ros.apps import calibrate_bag

Refusal = Callable[..., str]


@pytest.fixture
def refusal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Refusal:
    """Return a function that runs the program in a folder of its own and gives its complaint."""
    write_bag(tmp_path / 'bag', walk())
    (tmp_path / 'rig.yaml').write_text('nobody comes this far')

    def refusal(*words: object, bag: Path = tmp_path / 'bag') -> str:
        before = contents(tmp_path)
        code = calibrate_bag.main(
            [str(bag), '--rig', str(tmp_path / 'rig.yaml'), *map(str, words)]
        )
        said = capsys.readouterr().err
        assert 'Traceback' not in said
        assert code == calibrate_bag.EXIT_BAD_INPUT
        assert contents(tmp_path) == before
        assert '(not_writable)' in said
        return said

    return refusal


def contents(folder: Path) -> dict[str, bytes]:
    """Read all files below a folder."""
    files = (path for path in folder.rglob('*') if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.mark.parametrize('option', ['--output', '--report', '--write-rig', '--export'])
@pytest.mark.parametrize('name', ['bag', 'bag/metadata.yaml', 'bag/bag.mcap', 'rig.yaml'])
def test_what_is_read_is_not_written_over(
    refusal: Refusal, tmp_path: Path, option: str, name: str
) -> None:
    """The recording and the rig file stay as they are."""
    assert (tmp_path / name).exists()
    refusal(option, tmp_path / name)


@pytest.mark.parametrize('bag', ['bag.mcap', 'metadata.yaml'])
@pytest.mark.parametrize('name', ['bag.mcap', 'metadata.yaml'])
def test_a_bag_that_is_given_as_a_file_is_not_written_over(
    refusal: Refusal, tmp_path: Path, bag: str, name: str
) -> None:
    """Nor what lies beside it and belongs to it."""
    folder = tmp_path / 'bag'
    said = refusal('--report', folder / name, bag=folder / bag)
    assert 'this is read, it would be lost: choose another name' in said


def test_another_name_of_the_same_file_is_no_way_around(refusal: Refusal, tmp_path: Path) -> None:
    """A hard link, a folder that is a link, a path with .. in it."""
    (tmp_path / 'hard.html').hardlink_to(tmp_path / 'bag' / 'bag.mcap')
    (tmp_path / 'linked').symlink_to(tmp_path / 'bag')
    for name in ('hard.html', 'linked/bag.mcap', 'bag/../bag/bag.mcap'):
        assert 'this is read' in refusal('--report', tmp_path / name)


def test_the_parameter_file_and_the_rig_file_that_it_names_are_read_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As those of the command line."""
    rig, params = tmp_path / 'rig.yaml', tmp_path / 'params.yaml'
    rig.write_text('a rig')
    settings = {'/**': {'ros__parameters': {'rig_file': str(rig)}}}
    params.write_text(yaml.safe_dump(settings))
    for path in (rig, params):
        words = ['nowhere', '--params', params, '--output', path]
        assert calibrate_bag.main([str(word) for word in words]) == 2
        assert f'--output {path}: this is read' in capsys.readouterr().err


def test_two_outputs_do_not_share_a_place(refusal: Refusal, tmp_path: Path) -> None:
    """The later one would replace the earlier one."""
    place = tmp_path / 'one'
    said = refusal('--output', place, '--report', tmp_path / 'bag' / '..' / 'one')
    assert 'this is what --output writes' in said
    assert 'this is what --annotated writes' in refusal('--annotated', place, '--overlay', place)


@pytest.mark.parametrize('option', ['--output', '--report', '--write-rig', '--overlay'])
def test_a_folder_a_pipe_and_a_link_are_no_place_for_a_file(
    refusal: Refusal, tmp_path: Path, option: str
) -> None:
    """Said before the work; a link may point nowhere."""
    suffix = '.mp4' if option == '--overlay' else '.yaml'
    (tmp_path / f'folder{suffix}').mkdir()
    os.mkfifo(tmp_path / f'pipe{suffix}')
    (tmp_path / f'link{suffix}').symlink_to(tmp_path / 'nowhere')
    assert 'is a folder' in refusal(option, tmp_path / f'folder{suffix}')
    assert 'is no file' in refusal(option, tmp_path / f'pipe{suffix}')
    assert 'is a symbolic link' in refusal(option, tmp_path / f'link{suffix}')
    assert (tmp_path / f'link{suffix}').is_symlink()


def test_no_name_is_no_place_for_a_file(refusal: Refusal) -> None:
    """As a script gives it whose variable is empty."""
    assert 'is a folder' in refusal('--output', '')


@pytest.mark.parametrize('option', ['--export', '--overlay'])
def test_a_file_is_no_place_for_a_folder(refusal: Refusal, tmp_path: Path, option: str) -> None:
    """Neither is a link that points nowhere."""
    (tmp_path / 'file').write_text('mine')
    (tmp_path / 'link').symlink_to(tmp_path / 'nowhere')
    for name in ('file', 'link'):
        assert 'is no folder: choose another name' in refusal(option, tmp_path / name)


@pytest.mark.parametrize('name', ['a', 'a.mcap'])
def test_an_annotated_recording_does_not_replace_a_link(
    refusal: Refusal, tmp_path: Path, name: str
) -> None:
    """Not even one that points nowhere."""
    (tmp_path / name).symlink_to(tmp_path / 'nowhere')
    assert 'exists already' in refusal('--annotated', tmp_path / name)


@pytest.mark.parametrize(
    'option', ['--output', '--report', '--write-rig', '--annotated', '--export', '--overlay']
)
def test_a_name_that_is_too_long_is_said_before_the_work(
    refusal: Refusal, tmp_path: Path, option: str
) -> None:
    """In the words of the operating system; of a folder above it as well."""
    long = 'x' * 300
    assert 'File name too long' in refusal(option, tmp_path / f'{long}.yaml')
    assert 'File name too long' in refusal(option, tmp_path / long / 'a.yaml')
