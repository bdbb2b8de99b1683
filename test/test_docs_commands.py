# SPDX-License-Identifier: Apache-2.0
"""What the pages tell people to type does what they say: it runs, or it is there."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from camera_files import opencv_text, toml_text
from pages import PAGES, ROOT, all_commands, anchors, blocks, commands, name_of
from shoot import Shoot, make_shoot
from shoot_files import write_bvh, write_labels, write_openpose, write_trc

from rpgd_ros.apps import calibrate_bag, evaluate, import_recording, simulate
from rpgd_ros.core import Camera, RigidTransform
from rpgd_ros.core.geometry import Array, nearest_rotation, rotation_angle, so3_exp
from rpgd_ros.importing.plan import ORDERS
from rpgd_ros.io.result_file import read_result
from rpgd_ros.skeletons import match_joints

PROGRAMS = {
    'simulate': simulate.main,
    'calibrate_bag': calibrate_bag.main,
    'evaluate': evaluate.main,
    'import_recording': import_recording.main,
}
LIBRARIES = ('plotly', 'jinja2', 'scipy', 'cdflib')  # of the extras that the pages install
# Not run here: `make` and `colcon` are in test_packaging.py, `ros2` in test_ros_docs.py.
OTHERS = frozenset({'make', 'ros2', 'git', 'cd', 'mkdir', 'pip', 'rosdep', 'colcon', 'source'})
RUN_ELSEWHERE = {'docs/report.md': 'test_docs_report.py'}
RUN = [
    page
    for page in PAGES
    if name_of(page) not in RUN_ELSEWHERE
    and any(c.program in PROGRAMS for c in commands(page))
]  # fmt: skip
FILES_PAGE = ROOT / 'docs' / 'tutorial_files.md'


@pytest.fixture(scope='module')
def studio(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a walk, as somebody with a rig would have recorded it."""
    folder = tmp_path_factory.mktemp('studio') / 'walk'
    words = ['--preset', 'studio', '--seconds', '8', '--output', str(folder)]
    assert simulate.main(words) == 0
    return folder


def prepare(page: str, folder: Path, studio: Path) -> None:
    """Put into a folder what the reader of a page has at hand."""
    if page == 'README.md':
        for recorded in ('walk', 'today'):
            shutil.copytree(studio / 'bag', folder / recorded)
        shutil.copy(studio / 'rig.yaml', folder)
        shutil.copy(ROOT / 'config' / 'calibrator.yaml', folder)
    elif page in {'docs/tutorial_files.md', 'docs/import.md'}:
        write_project(folder, make_shoot(seconds=6.0))
        write_kinect(folder, make_shoot('kinect'))


def write_project(folder: Path, shoot: Shoot) -> None:
    """Write a shoot as a Pose2Sim project; in its files it goes 1.2 times as fast, at 60 fps."""
    names = ORDERS['body25b']
    tables = np.full((*shoot.uv.shape[:2], len(names), 2), np.nan)
    for here, there in match_joints(shoot.keypoints, names):
        tables[:, :, there] = shoot.uv[:, :, here]
    write_folders(folder, shoot.cameras, tables, shoot.joints, shoot.x_mocap, 120.0)


def write_folders(
    folder: Path, cameras: tuple[Camera, ...], tables: Array, joints: tuple[str, ...],
    x_mocap: Array, fps: float,
) -> None:  # fmt: skip
    """Write cameras, keypoints and skeleton where a Pose2Sim project has them."""
    for name in ('calibration', 'mocap'):
        (folder / name).mkdir()
    named = [replace(camera, name=f'cam{i:02}') for i, camera in enumerate(cameras, 1)]
    (folder / 'calibration' / 'Calib_qualisys.toml').write_text(toml_text(named))
    write_trc(folder / 'mocap' / 'balancing.trc', joints, x_mocap, fps=fps)
    for i, table in enumerate(tables, 1):
        write_openpose(folder / 'pose' / f'cam{i}_json', table)


def write_kinect(folder: Path, shoot: Shoot) -> None:
    """Write a shoot as a Kinect's BVH and the labels of one video."""
    write_bvh(folder / 'kinect.bvh', shoot.joints, shoot.x_mocap * 100.0)
    write_labels(folder / 'video.json', shoot.uv[0], shoot.keypoints)
    (folder / 'camera.yml').write_text(opencv_text(shoot.cameras[0]))


def run_page(page: Path) -> None:
    """Run the offline commands of a page one after the other, in the present folder."""
    for command in commands(page):
        words = list(command.words[1:])
        if command.program == 'cp':
            shutil.copy(*words)
        if command.program in PROGRAMS:
            assert PROGRAMS[command.program](words) == command.exit_code, command.words


@pytest.mark.parametrize('page', RUN, ids=name_of)
def test_offline_commands_of_a_page_run_as_they_stand(
    page: Path, studio: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One after the other in an empty folder, with the exit code that the page gives."""
    for library in LIBRARIES:
        pytest.importorskip(library)
    prepare(name_of(page), tmp_path, studio)
    monkeypatch.chdir(tmp_path)
    run_page(page)
    after = AFTER.get(name_of(page))
    if after:
        after()


def after_the_tutorial() -> None:
    """The page of the last steps is there, and the Python lines read the result."""
    assert Path('report.html').read_text().count('Accepted')
    names = {'x_mocap': np.zeros((5, 3))}
    for _, code in blocks((ROOT / 'docs/tutorial.md').read_text(), frozenset({'python'})):
        exec(compile(code, 'tutorial.md', 'exec'), names)  # noqa: S102 - our own file
    found = read_result('result.yaml').world_T_mocap
    assert np.array_equal(names['x_world'], np.tile(found.translation, (5, 1)))


def after_the_page_of_trust() -> None:
    """The table holds what the commands give, to a factor of two."""
    text = (ROOT / 'docs/trust.md').read_text()
    rows = re.findall(
        r'^\| `(\w+)`.*?\| ([\d.]+) px \| ([\d.]+) mm \| ([\d.]+) mm', text, re.MULTILINE
    )
    assert [row[0] for row in rows] == ['clean', 'biased', 'crossed']
    for name, mpjpe_px, sigma_mm, error_mm in rows:
        stored = read_result(f'{name}.yaml')
        truth = yaml.safe_load((Path(name) / 'truth.yaml').read_text())['world_T_mocap']
        centre = np.array(yaml.safe_load(Path(f'{name}.yaml').read_text())['centroid_mocap'])
        true_pose = RigidTransform.from_matrix(truth['matrix'])
        error = 1e3 * np.linalg.norm(stored.world_T_mocap @ centre - true_pose @ centre)
        for told, found in (
            (mpjpe_px, stored.mpjpe_px),
            (sigma_mm, 1e3 * stored.sigma_position_m),
            (error_mm, error),
        ):
            assert 0.5 < found / float(told) < 2.0, (name, told, found)


def after_the_files() -> None:
    """The results that the page goes on with are there."""
    assert {p.name for p in Path().iterdir()} >= {
        'recording', 'result.yaml', 'report.html', 'placed.toml', 'overlay.mp4', 'labels'
    }  # fmt: skip


AFTER: dict[str, Callable[[], None]] = {
    'docs/tutorial.md': after_the_tutorial,
    'docs/trust.md': after_the_page_of_trust,
    'docs/tutorial_files.md': after_the_files,
}


def test_tutorial_of_files_finds_the_transform_of_recorded_footage(
    recording: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pose2Sim's own demo recording in its layout; the skeleton is moved by a known transform."""
    for library in LIBRARIES:
        pytest.importorskip(library)
    data = np.load(recording('pose2sim_balancing.npz'), allow_pickle=False)
    truth = RigidTransform(so3_exp([0.3, -0.2, 1.0]), np.array([0.4, -0.6, 0.2]))
    names = tuple(str(name) for name in data['joint_names'])
    width, height = (int(n) for n in data['image_size'])
    cameras = tuple(
        Camera('cam', k, d, (width, height), RigidTransform(nearest_rotation(r), t))
        for k, d, r, t in zip(data['K'], data['dist'], data['R_c'], data['t_c'], strict=True)
    )
    order = ORDERS['body25b']
    uv = data['keypoints2d']
    tables = np.full((*uv.shape[:2], len(order), 2), np.nan)
    tables[:, :, [order.index(name) for name in names]] = uv
    x_mocap = truth.inverse() @ data['joints3d']
    write_folders(tmp_path, cameras, tables, names, x_mocap, 60.0)
    monkeypatch.chdir(tmp_path)
    run_page(FILES_PAGE)
    after_the_files()
    found = read_result('result.yaml').world_T_mocap
    told = re.search(r'found to ([\d.]+) deg and\s(\d+) mm', FILES_PAGE.read_text())
    assert told
    turned = np.degrees(rotation_angle(found.rotation @ truth.rotation.T))
    centre = np.nanmean(x_mocap, axis=(0, 1))
    assert turned < 1.5 * float(told[1])
    assert 1e3 * np.linalg.norm(found @ centre - truth @ centre) < 1.5 * float(told[2])


def test_every_command_is_run_or_checked_somewhere() -> None:
    """A program that no test knows would be a command that nobody tried."""
    strange = [c for c in all_commands() if c.program not in {*PROGRAMS, *OTHERS, 'cp', 'python'}]
    assert not strange
    assert len([c for c in all_commands() if c.program in PROGRAMS]) > 25


def test_python_programs_of_the_pages_run() -> None:
    """`python docs/...` is run as it stands."""
    for command in all_commands():
        if command.program == 'python':
            done = subprocess.run(
                [sys.executable, *command.words[1:]], cwd=ROOT, check=False, capture_output=True
            )
            assert done.returncode == 0, done.stderr.decode()


def test_make_targets_extras_and_tests_that_are_named_exist() -> None:
    """`make x`, `pip install '.[x]'` and `test/test_x.py` name what is there."""
    text = '\n'.join(page.read_text() for page in PAGES)
    makefile = (ROOT / 'Makefile').read_text()
    targets = {c.words[1] for c in all_commands() if c.program == 'make'}
    for target in targets | set(re.findall(r'`make ([a-z-]+)', text)):
        assert re.search(rf'^{target}:', makefile, re.MULTILINE), target
    setup = (ROOT / 'setup.py').read_text()
    extras = set(re.findall(r"^        '(\w+)': \[", setup, re.MULTILINE))
    for named in re.findall(r"pip install '(?:\.|rpgd_ros)\[([\w,]+)\]'", text):
        assert set(named.split(',')) <= extras, named
    for test in re.findall(r'(?:test/)?\b(test_\w+\.py)', text):
        assert (ROOT / 'test' / test).is_file(), test
    for path in re.findall(r'`((?:rpgd_ros|config|docs|test)/[\w./-]+)`', text):
        assert (ROOT / path).exists(), path


@pytest.mark.parametrize('page', PAGES, ids=name_of)
def test_every_link_of_a_page_leads_somewhere(page: Path) -> None:
    """Files exist, and headings have the anchors that are linked."""
    for path, anchor in re.findall(r'\]\((?!http)([^)#\s]*)#?([^)\s]*)\)', page.read_text()):
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), path
        if anchor:
            assert anchor in anchors(target.read_text()), f'{path}#{anchor}'


def test_index_links_every_page() -> None:
    """Nobody has to guess a file's name."""
    index = (ROOT / 'docs/README.md').read_text()
    linked = set(re.findall(r'\]\(([\w./-]+)', index))
    pages = {p.name for p in (ROOT / 'docs').glob('*.md')} - {'README.md'}
    assert pages <= linked
    assert '](docs/README.md)' in (ROOT / 'README.md').read_text()
