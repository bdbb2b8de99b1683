# SPDX-License-Identifier: Apache-2.0
"""The page is whole in itself, takes no orders from names, and says what is not there."""

from __future__ import annotations

import html
import importlib.util
import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scenes
import yaml

from rpgd_ros.core import CalibrationError, InputError, Reason, RigidTransform, View, calibrate
from rpgd_ros.report import Case, Photo, StreamCount, check_libraries, settle, write_report
from rpgd_ros.report.blocks import label, number, rounded
from rpgd_ros.report.forms import forms
from rpgd_ros.report.measure import measure

needs_libraries = pytest.mark.skipif(
    not all(map(importlib.util.find_spec, ('plotly', 'jinja2'))), reason='needs the extra report'
)
EVIL = '<script>alert(1)</script>'


def case_of(name: str = 'cam', *, refusal: CalibrationError | None = None) -> Case:
    """Calibrate from a small scene and wrap it up."""
    scene = scenes.perfect(frames=60)
    cameras = tuple(replace(c, name=f'{name}{i}') for i, c in enumerate(scene.cameras))
    observations = replace(
        scene.observations,
        joint_names=tuple(f'{name}{j}' for j in range(scene.observations.n_joints)),
    )
    return Case(
        name=name,
        world_frame=f'world {name}',
        mocap_frame=f'mocap {name}',
        stamp_ns=1_700_000_000_000_000_000,
        cameras=cameras,
        observations=observations,
        calibration=calibrate(cameras, observations),
        refusal=refusal,
        moved_m=3.0,
        streams=(StreamCount(name, f'/{name}', 5, 4, None, {'nan': 3}),),
        notes=(f'note {name}',),
        photos={cameras[0].name: (Photo(30, np.full((90, 160, 3), 127, np.uint8)),)},
    )


@needs_libraries
def test_names_of_files_topics_and_joints_never_become_markup(tmp_path: Path) -> None:
    """A camera named <script> is a camera with a strange name, wherever it is told of."""
    write_report(tmp_path / 'evil.html', case_of(EVIL))
    write_report(tmp_path / 'good.html', case_of('cam'))
    evil, good = ((tmp_path / f'{n}.html').read_text() for n in ('evil', 'good'))
    assert EVIL not in evil
    assert html.escape(EVIL) in evil
    assert evil.count('<script') == good.count('<script')
    for content in re.findall(r'data-figure="[^"]*">(.*?)</script>', evil, re.DOTALL):
        figure = json.loads(content)
        assert '<' not in json.dumps(figure['data']).replace('<br>', '').replace('<extra>', ''
            ).replace('</extra>', '')  # fmt: skip


@needs_libraries
def test_the_page_names_no_address_to_load_from(tmp_path: Path) -> None:
    """No src, no href outside the page, no import, and a policy that allows none."""
    write_report(tmp_path / 'report.html', case_of())
    page = (tmp_path / 'report.html').read_text()
    assert set(re.findall(r'href="(.)', page)) == {'#'}
    assert not re.search(r'\ssrc=|@import|url\(', page)
    assert "default-src 'none'" in page
    assert '<link' not in page


@needs_libraries
def test_every_link_of_the_page_leads_somewhere(tmp_path: Path) -> None:
    """And no two places have the same name."""
    refusal = CalibrationError(Reason.DEGENERATE_MOTION, 'the person moved 0.0 m')
    write_report(tmp_path / 'report.html', case_of(refusal=refusal))
    page = (tmp_path / 'report.html').read_text()
    ids = re.findall(r'\sid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'href="#([^"]+)"', page)) <= set(ids)
    assert set(re.findall(r'data-figure="([^"]+)"', page)) <= set(ids)


@needs_libraries
def test_a_run_that_ended_before_any_pair_has_a_page_too(tmp_path: Path) -> None:
    """What came in is all there is to show, and is shown."""
    refusal = CalibrationError(Reason.NO_DATA, 'no usable messages of mocap')
    verdict = write_report(
        tmp_path / 'report.html',
        Case('walk', 'world', 'mocap', 0, refusal=refusal,
             streams=(StreamCount('mocap', '/mocap', 7, 0, None, {'malformed': 7}),)),
    )  # fmt: skip
    assert verdict.headline == 'Refused: skeletons and keypoints never came together'
    page = (tmp_path / 'report.html').read_text()
    assert '7 malformed' in page
    assert 'static_transform_publisher' not in page


@needs_libraries
def test_a_refusal_without_a_pose_still_shows_walk_and_keypoints(tmp_path: Path) -> None:
    """In the frame of the MoCap, as no other is known."""
    refusal = CalibrationError(Reason.AMBIGUOUS, 'two different poses explain the data')
    case = replace(case_of(refusal=refusal), calibration=None)
    verdict = write_report(tmp_path / 'report.html', case)
    page = (tmp_path / 'report.html').read_text()
    assert verdict.headline == 'Refused: two different transforms explain the recording'
    assert 'Seen in the frame mocap cam' in page
    assert 'id="camera-0-coverage"' in page
    assert 'id="camera-0-residuals"' not in page


@needs_libraries
def test_cameras_that_saw_nothing_or_look_away_have_a_place_too(tmp_path: Path) -> None:
    """One without a single frame, one whose pose puts the person behind it."""
    case = case_of()
    assert case.observations is not None
    views = list(case.observations.views)
    first = views[0]
    views[0] = View(np.zeros(0, np.int64), first.x_mocap[:0], first.uv[:0])
    cameras = list(case.cameras)
    pose = cameras[1].camera_T_world
    assert pose is not None
    about = RigidTransform(np.diag([-1.0, 1.0, -1.0]), np.zeros(3))
    cameras[1] = replace(cameras[1], camera_T_world=about @ pose)
    observations = replace(case.observations, views=tuple(views))
    write_report(
        tmp_path / 'r.html', replace(case, observations=observations, cameras=tuple(cameras))
    )
    page = (tmp_path / 'r.html').read_text()
    assert 'It saw no joint of the skeleton at any instant.' in page
    assert 'id="camera-1-coverage"' in page
    assert 'id="camera-1-residuals"' not in page
    assert 'id="camera-2-residuals"' in page


def test_without_the_libraries_the_pip_command_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before any work."""
    monkeypatch.setattr('rpgd_ros.report.html.find_spec', lambda _name: None)
    with pytest.raises(InputError, match=r"pip install 'rpgd_ros\[report\]'") as refused:
        check_libraries()
    assert 'plotly and Jinja2' in refused.value.message


def test_all_forms_carry_the_same_transform() -> None:
    """Each read back by a reader of its own."""
    scene = scenes.perfect(frames=10)
    truth = scene.truth.world_T_mocap
    codes = {
        code.label: code.text
        for code in forms(truth, scene.cameras, world_frame='a b', mocap_frame='mocap')
    }
    tree = yaml.safe_load(codes['YAML'])
    assert tree['world_frame'] == 'a b'
    stored = tree['world_T_mocap']
    np.testing.assert_allclose(
        RigidTransform.from_quat_xyzw(stored['xyz'], stored['quat_xyzw']).matrix, truth.matrix
    )
    np.testing.assert_allclose(json.loads(codes['Matrix']), truth.matrix)
    numbers = [float(n) for n in re.findall(r'--q?[xyzw] (\S+)', codes['TF'])]
    np.testing.assert_allclose(numbers, [*truth.translation, *truth.quat_xyzw])
    assert "--frame-id 'a b' --child-frame-id mocap" in codes['TF']
    origin = re.fullmatch(r'<origin xyz="(.*?)" rpy="(.*?)"/>', codes['URDF'])
    assert origin is not None
    np.testing.assert_allclose([float(n) for n in origin[1].split()], truth.translation)
    vicon = yaml.safe_load(codes['vicon_receiver'])['vicon_receiver']['ros__parameters']
    np.testing.assert_allclose(vicon['map_xyz'], truth.translation)
    assert [float(n) for n in origin[2].split()] == vicon['map_rpy']
    cameras = tomllib.loads(codes['TOML'])
    for camera in scene.cameras:
        assert camera.camera_T_world is not None
        camera_T_mocap = camera.camera_T_world @ truth
        np.testing.assert_allclose(cameras[camera.name]['translation'], camera_T_mocap.translation)


def test_a_recording_settles_towards_the_result_of_all() -> None:
    """The last step is the result itself, the one before is near."""
    scene = scenes.perfect(frames=120)
    whole = calibrate(scene.cameras, scene.observations)
    steps = settle(scene.cameras, scene.observations, whole)
    assert [step.seconds for step in steps] == sorted(step.seconds for step in steps)
    assert (steps[-1].apart_deg, steps[-1].apart_m) == (0.0, 0.0)
    assert steps[-2].apart_m < 1e-3


def test_residuals_of_a_true_pose_are_none_and_all_agree() -> None:
    """The page measures what the solve does."""
    case = case_of()
    measured = measure(case)
    for look in measured.looks:
        assert np.nanmax(look.error_px) < 1e-2
        assert look.lost_ratio == 0.0
    assert not measured.lost
    np.testing.assert_array_equal(np.abs(measured.up).sum(), 1.0)


def test_numbers_and_names_are_set_for_reading() -> None:
    """A true minus, a dash for nothing, no tags, no page of a name."""
    assert number(-1.234, 1, 'mm') == '\N{MINUS SIGN}1.2\N{NO-BREAK SPACE}mm'
    assert number(float('nan')) == '–'  # noqa: RUF001
    assert rounded(np.array([[1.26, np.nan], [np.inf, 2.0]])) == [[1.3, None], [None, 2.0]]
    assert label('<b>&') == '&lt;b&gt;&amp;'
    assert len(label('x' * 500)) == 80
