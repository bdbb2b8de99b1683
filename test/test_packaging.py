# SPDX-License-Identifier: Apache-2.0
"""The package as users get it: installed by pip, built and tested by colcon."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

import rpgd_ros

ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = ('calibrate_bag', 'calibrator', 'evaluate', 'import_recording', 'simulate')
# What a build leaves behind, and what is far too large to copy.
LEFTOVERS = shutil.ignore_patterns(
    '.git', '.venv*', '.*_cache', '.hypothesis', '__pycache__', '*.egg-info', 'build', 'install',
    'log', 'dist', 'demo_output',
)  # fmt: skip
MARKER = Path('share/ament_index/resource_index/packages/rpgd_ros')
INSTALL_TIMEOUT_S = 300.0  # 10 s on two idle cores


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
    """Run a command in a folder and return what it prints; its output becomes the failure."""
    done = subprocess.run(
        command,
        cwd=cwd,
        env=os.environ | environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=INSTALL_TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 0, f'{command}\n{done.stdout}\n{done.stderr}'
    return done.stdout


def is_executable(path: Path) -> bool:
    """Whether a program is there and may be started."""
    return path.is_file() and os.access(path, os.X_OK)


@pytest.fixture(scope='module')
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the source tree to a workspace, clean of what earlier builds left."""
    source = tmp_path_factory.mktemp('workspace') / 'src' / 'rpgd_ros'
    shutil.copytree(ROOT, source, ignore=LEFTOVERS)
    return source


@pytest.fixture(scope='module')
def venv(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install a wheel of the tree into a new venv; its dependencies come from this one's."""
    if importlib.util.find_spec('setuptools') is None:
        pytest.skip('setuptools is not installed')
    folder = tmp_path_factory.mktemp('pip')
    pip = [sys.executable, '-m', 'pip', '--disable-pip-version-check', '--no-input']
    offline = ['--no-index', '--no-deps']
    copy = shutil.copytree(tree, folder / 'tree')  # a build writes beside its source
    run(*pip, 'wheel', *offline, '--no-build-isolation', '-w', folder, copy, cwd=folder)
    new = folder / 'venv'
    run(sys.executable, '-m', 'venv', '--without-pip', new, cwd=folder)
    (wheel,) = folder.glob('*.whl')
    run(*pip, '--python', new / 'bin/python', 'install', *offline, wheel, cwd=folder)
    (packages,) = new.glob('lib/python*/site-packages')
    (packages / 'dependencies.pth').write_text(sysconfig.get_path('purelib'))
    return new


@pytest.fixture(scope='module')
def colcon(tree: Path) -> Path:
    """Build the tree in its workspace and return the command; installed programs lie beside."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get('PATH', '')])
    command = shutil.which('colcon', path=path)
    if command is None or importlib.util.find_spec('colcon_ros') is None:
        pytest.skip('colcon with colcon-ros is not installed')
    run(command, 'build', '--packages-select', 'rpgd_ros', cwd=tree.parents[1])
    return Path(command)


def test_versions_agree() -> None:
    """package.xml, setup.py and the module name one version."""
    manifest = re.search('<version>(.*)</version>', (ROOT / 'package.xml').read_text())
    script = re.search("version='(.*)'", (ROOT / 'setup.py').read_text())
    assert manifest
    assert script
    assert manifest[1] == script[1] == rpgd_ros.__version__


@pytest.mark.packaging
@pytest.mark.parametrize('name', PROGRAMS)
def test_pip_puts_the_program_into_bin(venv: Path, name: str) -> None:
    """A venv's programs are found on its path."""
    assert is_executable(venv / 'bin' / name)


@pytest.mark.packaging
def test_pip_installs_the_ament_index_and_the_files_to_copy(venv: Path) -> None:
    """`ros2` finds the package by its marker, users find the files that they start from."""
    files = ['package.xml', *(f'{p.relative_to(ROOT)}' for p in (ROOT / 'config').rglob('*.*'))]
    assert (venv / MARKER).is_file()
    assert not [name for name in files if not (venv / 'share/rpgd_ros' / name).exists()]


@pytest.mark.packaging
@pytest.mark.parametrize('name', ['calibrate_bag', 'evaluate', 'import_recording', 'simulate'])
def test_installed_offline_program_explains_itself(venv: Path, tmp_path: Path, name: str) -> None:
    """The wheel holds every module that the program needs, and the program starts."""
    assert 'usage:' in run(venv / 'bin' / name, '--help', cwd=tmp_path, PYTHONPATH='')


@pytest.mark.packaging
def test_installed_package_is_typed_and_alone(venv: Path) -> None:
    """The wheel brings the type marker and no other top-level package, such as the tests."""
    (packages,) = venv.glob('lib/python*/site-packages')
    assert (packages / 'rpgd_ros/py.typed').is_file()
    for name in ('report.html', 'report.css', 'report.js'):
        assert (packages / 'rpgd_ros/report/page' / name).is_file()
    found = {p.name for p in packages.iterdir() if p.is_dir()}
    assert {name for name in found if '.dist-info' not in name} == {'rpgd_ros'}


@pytest.mark.packaging
def test_colcon_takes_it_for_an_ament_package(tree: Path, colcon: Path) -> None:
    """A fault in package.xml would silently make a plain Python package of it."""
    assert '(ros.ament_python)' in run(colcon, 'list', cwd=tree.parents[1])


@pytest.mark.packaging
@pytest.mark.parametrize('name', PROGRAMS)
@pytest.mark.usefixtures('colcon')
def test_colcon_puts_the_program_where_ros2_run_looks(tree: Path, name: str) -> None:
    """`ros2 run` looks in lib/<package> of the prefix that the ament index names."""
    prefix = tree.parents[1] / 'install/rpgd_ros'
    assert (prefix / MARKER).is_file()
    assert is_executable(prefix / 'lib/rpgd_ros' / name)


@pytest.mark.packaging
@pytest.mark.parametrize('name', ['calibrate_bag', 'evaluate', 'import_recording', 'simulate'])
@pytest.mark.usefixtures('colcon')
def test_program_of_a_sourced_workspace_explains_itself(tree: Path, name: str) -> None:
    """The program starts from the workspace once that is sourced."""
    line = f'. install/local_setup.sh && exec install/rpgd_ros/lib/rpgd_ros/{name} --help'
    assert 'usage:' in run('sh', '-c', line, cwd=tree.parents[1])


@pytest.mark.packaging
def test_colcon_test_runs_the_tests(tree: Path, colcon: Path) -> None:
    """Without pytest among the extras colcon runs nothing and is content."""
    workspace = tree.parents[1]
    one = 'test/test_layers.py::test_every_room_is_known'
    run(colcon, 'test', '--pytest-args', one, cwd=workspace)
    summary = run(colcon, 'test-result', '--all', cwd=workspace)
    assert 'Summary: 1 test, 0 errors, 0 failures, 0 skipped' in summary


@pytest.mark.parametrize('target', ['test', 'test-oldest', 'demo'])
def test_make_keeps_a_sourced_ros_out_of_its_venv(tmp_path: Path, target: str) -> None:
    """The venv has its own ROS; paths of another, and how to reach its network, stay outside."""
    if shutil.which('make') is None:
        pytest.skip('make is not installed')
    python = tmp_path / 'bin/python'
    python.parent.mkdir()
    python.write_text('#!/bin/sh\nenv\n')
    python.chmod(0o755)
    (tmp_path / '.ready').touch()
    sourced = dict.fromkeys(
        ('AMENT_PREFIX_PATH', 'LD_LIBRARY_PATH', 'PYTHONPATH', 'RMW_IMPLEMENTATION',
         'ROS_DISCOVERY_SERVER', '_ROS_WHEELS_BOOTSTRAP_COMPLETE'), 'of-another-ros',
    )  # fmt: skip
    folders = [f'VENV={tmp_path}', f'VENV_OLDEST={tmp_path}']
    seen = run('make', '-s', target, *folders, cwd=ROOT, **sourced)
    assert 'of-another-ros' not in seen
    assert 'ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST' in seen.splitlines()
