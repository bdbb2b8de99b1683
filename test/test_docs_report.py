# SPDX-License-Identifier: Apache-2.0
"""What docs/report.md says is what the programs do: its commands run, its keys are printed."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

from rpgd_ros.apps import calibrate_bag, simulate
from rpgd_ros.apps.bag_json import bag_json
from rpgd_ros.report.verdict import HEADLINES

pytest.importorskip('plotly')
pytest.importorskip('jinja2')

PAGE = (Path(__file__).resolve().parents[1] / 'docs' / 'report.md').read_text()
PROGRAMS = {'simulate': simulate.main, 'calibrate_bag': calibrate_bag.main}


def commands() -> list[list[str]]:
    """Return the commands of the page, word by word, in its order."""
    lines = '\n'.join(re.findall(r'```bash\n(.*?)```', PAGE, re.DOTALL)).splitlines()
    return [shlex.split(line.split(' | ')[0], comments=True) for line in lines if line.strip()]


def test_every_command_of_the_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One after the other, as somebody would type them, and leaves what it promises."""
    monkeypatch.chdir(tmp_path)
    for program, *words in commands():
        assert PROGRAMS[program](words) == 0, words
    tree = json.loads(capsys.readouterr().out.rpartition('\n{\n')[2].join(['{', '']))
    assert tree['status'] == 'accepted'
    assert {path.name for path in tmp_path.iterdir()} == {
        'demo', 'report.html', 'overlay', 'walk.mp4', 'annotated.mcap', 'result.yaml'
    }  # fmt: skip
    assert len(list((tmp_path / 'overlay').glob('cam0_*.jpg'))) == 50


def test_the_keys_of_the_table_are_those_that_are_printed() -> None:
    """In their order."""
    section = PAGE.split('## For scripts')[1].split('##')[0]
    told = re.findall(r'^\| `(\w+)` \|', section, re.MULTILINE)
    assert told == list(json.loads(bag_json('bad_input', 2)))


def test_first_lines_that_are_explained_are_said() -> None:
    """Every refusal of the table is one that the report has words for."""
    told = re.findall(r'^\| Refused: (.*?) \|', PAGE, re.MULTILINE)
    assert len(told) >= 4
    assert set(told) <= set(HEADLINES.values())
