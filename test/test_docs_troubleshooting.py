# SPDX-License-Identifier: Apache-2.0
"""The page of troubleshooting has every code, and what it explains is what the package says."""

from __future__ import annotations

import ast
import re
from dataclasses import fields
from functools import cache

import pytest
from pages import PAGES, ROOT

from rpgd_ros.core import Calibration, CalibrationConfig, Reason
from rpgd_ros.core.config import settings_of
from rpgd_ros.messages import NO_HEADER
from rpgd_ros.messages.layout import Drop
from rpgd_ros.pairing import JointStream, PairCounts
from rpgd_ros.ros.parameters import parameters

PAGE = (ROOT / 'docs' / 'troubleshooting.md').read_text()
# Functions whose sentences reach people as warnings or health, and how many they say at least.
SPEAKERS = {
    'core/agreement.py': ('sentence',),
    'core/questions.py': ('focal_sentences', 'size_sentence'),
    'core/report.py': ('_camera_warnings', 'with_excluded'),
    'core/settle.py': ('_clocks',),
    'core/drift.py': ('sentence',),
    'session/watch.py': ('complaint_of', 'common_complaint'),
    'session/snapshot.py': ('solve',),
    'session/camera_facts.py': ('problems', '_unplaced'),
    'ros/health.py': ('_input_status',),
    'ros/inputs.py': ('_problem', '_on_incompatible'),
    'ros/intake.py': ('_problem',),
    'ros/message_classes.py': ('not_installed',),
    'io/recording.py': ('__post_init__',),
    'importing/skeleton.py': ('settle',),
    'importing/plan.py': ('_check_pixels',),
}
# Of these functions: parts of a sentence, and refusals, which have codes.
SILENT = (
    'its parent there is', 'TF has not named it', 'holds no messages at all', 'no position at all',
    'give --keypoint-units', 'no shares of the image', 'focal length of camera {} looks',
    'all keypoints are missing',
)  # fmt: skip
STAGES = ('ransac', 'refine', 'time', 'rig', 'accept')
TABLES = ('Warnings of a calibration', 'Inputs, in /diagnostics', 'Attention: the watch')


def section(title: str) -> str:
    """Return the text below a heading up to the next of its rank."""
    return PAGE.split(f'\n## {title}\n')[1].split('\n## ')[0]


def told() -> list[str]:
    """Return the pieces of sentences that the tables explain."""
    rows = [
        row.split(' | ')[0].lstrip('| ')
        for title in TABLES
        for row in section(title).splitlines()
        if row.startswith('| `')
    ]
    return [piece for row in rows for piece in re.findall(r'`([^`]+)`', row)]


@cache
def said() -> str:
    """Return all literal text of the package's functions, pieces joined as they are written."""
    found = []
    for path in sorted((ROOT / 'rpgd_ros').rglob('*.py')):
        found += [_literal(node) for node in ast.walk(ast.parse(path.read_text()))]
    return '\n'.join(found)


def _literal(node: ast.AST) -> str:
    """Return the text of a string; {} stands where a value is put in."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return ''.join(_literal(p) if isinstance(p, ast.Constant) else '{}' for p in node.values)
    return ''


@pytest.mark.parametrize('reason', list(Reason))
def test_every_reason_has_its_section(reason: Reason) -> None:
    """With words that say more than the code."""
    found = re.search(rf'^### {reason}\n\n(.*?)(?=^##)', PAGE, re.DOTALL | re.MULTILINE)
    assert found, reason
    assert len(found[1].split()) > 8


def test_no_section_is_about_a_reason_that_does_not_exist() -> None:
    """Codes that were renamed are noticed."""
    assert set(re.findall(r'^### (\w+)$', PAGE, re.MULTILINE)) == {str(r) for r in Reason}


@pytest.mark.parametrize('piece', told())
def test_sentence_that_is_explained_is_one_that_the_package_says(piece: str) -> None:
    """Word for word, as somebody would search for it."""
    assert piece in said(), piece


@pytest.mark.parametrize(
    ('module', 'function'), [(m, f) for m, names in SPEAKERS.items() for f in names]
)
def test_every_sentence_that_people_are_told_is_explained(module: str, function: str) -> None:
    """Each sentence of the functions that warn has a piece in one of the tables."""
    sentences = sentences_of(module, function)
    assert sentences, function
    pieces = told()
    for sentence in sentences:
        assert any(piece in sentence for piece in pieces), sentence


def sentences_of(module: str, function: str) -> list[str]:
    """Return the sentences that a function makes: strings of at least four words."""
    tree = ast.parse((ROOT / 'rpgd_ros' / module).read_text())
    found: list[str] = []
    for body in ast.walk(tree):
        if isinstance(body, ast.FunctionDef) and body.name == function:
            nodes = list(ast.walk(body))[1:]
            formatted = [node for node in nodes if isinstance(node, ast.JoinedStr)]
            parts = {id(part) for node in formatted for part in node.values}
            doc = ast.get_docstring(body, clean=False)
            texts = [_literal(node) for node in nodes if id(node) not in parts]
            found += [text for text in texts if text != doc]
    long = [text for text in found if len(re.findall(r'[a-z]{2,}', text)) >= 4]
    return [text for text in long if not any(part in text for part in SILENT)]


def test_every_count_of_dropped_messages_is_explained() -> None:
    """Those of the decoder, of the store and of the pairing."""
    rows = set(re.findall(r'`(\w+)`', section('Why messages are dropped')))
    stream = JointStream(10, 1.0, n_joints=1, n_values=2)
    counted = {str(drop) for drop in Drop} | set(stream.counts) | {NO_HEADER, 'no_match'}
    assert 'no_match' in PairCounts._fields
    assert counted - {'received', 'kept'} <= rows


def test_every_program_of_the_page_of_the_method_exists() -> None:
    """The method names the modules that hold it."""
    text = (ROOT / 'docs' / 'method.md').read_text()
    core = ROOT / 'rpgd_ros' / 'core'
    for name in re.findall(r'`(\w+)\.py`', text):
        assert (core / f'{name}.py').is_file(), name
    for module, name in re.findall(r'`(ransac|refine|calibrate)\.(\w+)`', text):
        source = (core / f'{module}.py').read_text()
        assert name == 'py' or re.search(rf'^def {name}\(', source, re.MULTILINE), name
    assert [int(n) for n in re.findall(r'\\tag\{(\d)\}', text)] == list(range(1, 8))


def test_parameters_that_the_pages_name_exist() -> None:
    """`stage.name` is a parameter of the node, or a setting from Python."""
    known = {p.name for p in parameters(['cam0'])}
    config = CalibrationConfig()
    for f in fields(config):
        stage = getattr(config, f.name)
        if f.name in STAGES:
            known |= {f'{f.name}.{s.name}' for s, _ in settings_of(stage)}
    written = re.compile(rf'`((?:{"|".join(STAGES)}|sync|buffer|auto)\.[a-z_]+)\b(?!\.)')
    for page in PAGES:
        named = set(written.findall(page.read_text())) - {'rig.yaml'}
        assert {name for name in named - known if not is_function(name)} == set(), page.name


def is_function(name: str) -> bool:
    """Whether `module.name` is a function of the core."""
    module, _, function = name.partition('.')
    path = ROOT / 'rpgd_ros' / 'core' / f'{module}.py'
    return path.is_file() and f'\ndef {function}(' in path.read_text()


def test_what_the_pages_name_of_a_calibration_is_there() -> None:
    """Attributes of the result, and what CONTRIBUTING.md tells people to change."""
    attributes = {f.name for f in fields(Calibration)}
    trust = (ROOT / 'docs' / 'trust.md').read_text()
    named = {'covariance', 'covariance_over_time', 'joint_offset_m', 'time_offset_s', 'clock_rate',
             'focal_error', 'skeleton_scale', 'disagreements', 'drift'}  # fmt: skip
    assert named <= attributes & set(re.findall(r'`(\w+)`', trust))
    files = [p for folder in ('rpgd_ros', 'test') for p in (ROOT / folder).rglob('*.py')]
    sources = '\n'.join(path.read_text() for path in files)
    contributing = (ROOT / 'CONTRIBUTING.md').read_text()
    for name in re.findall(r'`(\w{4,})(?:\([^`]*)?`', contributing):
        assert re.search(rf'\b{name}\b', sources), name
