# SPDX-License-Identifier: Apache-2.0
"""Writes docs/api.md, the page of the public Python API, from the docstrings of the code.

python docs/api_page.py            write it
python docs/api_page.py --check    exit 1 where the page is not that of the code
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from types import ModuleType
from typing import Any

PAGE = Path(__file__).with_name('api.md')
# What others may build on: the module, and what of it (nothing = all that it exports).
MODULES: dict[str, tuple[str, ...]] = {
    'rpgd_ros.core': (),
    'rpgd_ros.core.config': (
        'RansacConfig', 'RefineConfig', 'TimeConfig', 'RigConfig', 'AcceptConfig',
    ),
    'rpgd_ros.session': (),
    'rpgd_ros.session.snapshot_file': ('read_snapshot', 'write_snapshot'),
    'rpgd_ros.io.rig': ('read_rig', 'parse_rig', 'write_rig'),
    'rpgd_ros.io.result_file': ('read_result', 'write_result', 'StoredResult'),
    'rpgd_ros.io.recording': ('open_recording',),
    'rpgd_ros.io.camera_files': ('read_cameras', 'toml_text'),
    'rpgd_ros.skeletons': ('joint_names', 'match_joints', 'edges', 'mirror'),
    'rpgd_ros.simulation': ('twin', 'preset', 'build_scene', 'simulate', 'Scene', 'Twin'),
    'rpgd_ros.datasets': ('open_dataset', 'Dataset', 'DatasetSequence'),
}  # fmt: skip
TITLE = """\
# The Python API

Generated from the docstrings by `python docs/api_page.py`. All of it runs without ROS. Frames: the
transform `a_T_b` takes points of b to a. Metres, radians, seconds, pixels where no other unit is
said; `NaN` is missing. Errors carry a `reason`, see [troubleshooting](troubleshooting.md).
"""
SECTION = re.compile(r'^(Args|Attributes|Returns|Raises|Yields):$')


def main() -> int:
    """Write or check the page."""
    parser = argparse.ArgumentParser(description='Write docs/api.md from the docstrings.')
    parser.add_argument('--check', action='store_true', help='only compare, exit 1 if it differs')
    sys.path.insert(0, str(PAGE.parents[1]))  # of this tree, installed or not
    text = page()
    if parser.parse_args().check:
        if PAGE.is_file() and PAGE.read_text() == text:
            return 0
        sys.stderr.write('docs/api.md is not that of the code: run python docs/api_page.py\n')
        return 1
    PAGE.write_text(text)
    return 0


def page() -> str:
    """Return the text of the page."""
    parts = [TITLE]
    for name, wanted in MODULES.items():
        module = importlib.import_module(name)
        parts += [f'## `{name}`\n', *_module(module, wanted)]
    return '\n'.join(parts).rstrip() + '\n'


def _module(module: ModuleType, wanted: tuple[str, ...]) -> Iterator[str]:
    yield _text(module)
    for name in wanted or module.__all__:
        value = getattr(module, name)
        if inspect.isclass(value):
            yield from _class(name, value)
        elif inspect.isfunction(value):
            yield f'### `{name}`\n'
            yield f'```python\n{_signature(name, value)}\n```\n'
            yield _text(value)
        else:
            yield f'### `{name}`\n\n`{value!r}`\n'


def _class(name: str, value: type) -> Iterator[str]:
    yield f'### `{name}`\n'
    if issubclass(value, Enum):
        yield _text(value)
        yield ', '.join(f'`{member.value}`' for member in value) + '\n'
        return
    is_data = dataclasses.is_dataclass(value)
    if is_data or ('__init__' in vars(value) and not getattr(value, '_is_protocol', False)):
        yield f'```python\n{_fields(name, value) if is_data else _signature(name, value)}\n```\n'
    yield _text(value)
    for key, member in vars(value).items():
        if key.startswith('_'):
            continue
        if isinstance(member, property):
            yield f'- **`{key}`**: {_first_line(member)}'
        elif isinstance(member, classmethod | staticmethod):
            yield _method(f'{name}.{key}', member.__func__)
        elif inspect.isfunction(member):
            yield _method(key, member)
    yield ''


def _method(name: str, function: object) -> str:
    return f'- **`{_signature(name, function, one_line=True)}`**: {_first_line(function)}'


def _fields(name: str, value: Any) -> str:
    lines = []
    for f in dataclasses.fields(value):
        if not f.init:
            continue
        line = f'    {f.name}: {f.type}'
        if f.default is not dataclasses.MISSING:
            line += f' = {f.default!r}'
        elif f.default_factory is not dataclasses.MISSING:
            line += ' = ...'
        help_of = getattr(f.metadata.get('setting'), 'help', '')
        lines.append(f'{line},' + (f'  # {help_of}' if help_of else ''))
    return '\n'.join([f'{name}(', *lines, ')']) if lines else f'{name}()'


def _signature(name: str, function: Any, *, one_line: bool = False) -> str:
    found = inspect.signature(function)
    parameters = [p for p in found.parameters.values() if p.name not in {'self', 'cls'}]
    words, has_star = [], False
    for p in parameters:
        if p.kind is p.KEYWORD_ONLY and not has_star:
            words.append('*')
            has_star = True
        has_star = has_star or p.kind is p.VAR_POSITIONAL
        words.append(_parameter(p))
    returned = found.return_annotation
    shown = '' if returned in {inspect.Signature.empty, 'None'} else f' -> {_name(returned)}'
    line = f'{name}({", ".join(words)}){shown}'
    if one_line or len(line) <= 88:
        return line
    return '\n'.join([f'{name}(', *(f'    {word},' for word in words), f'){shown}'])


def _parameter(p: inspect.Parameter) -> str:
    stars = 2 if p.kind is p.VAR_KEYWORD else int(p.kind is p.VAR_POSITIONAL)
    text = '*' * stars + p.name
    if p.annotation is not p.empty:
        text += f': {_name(p.annotation)}'
    if p.default is not p.empty:
        shown = repr(p.default)
        text += f' = {shown if len(shown) <= 40 and not shown.startswith("<") else "..."}'
    return text


def _name(annotation: object) -> str:
    return annotation if isinstance(annotation, str) else str(inspect.formatannotation(annotation))


def _first_line(member: object) -> str:
    return (inspect.getdoc(member) or '').partition('\n\n')[0].replace('\n', ' ')


def _text(thing: object) -> str:
    """Return a docstring as Markdown: its sections become lists."""
    doc = inspect.getdoc(thing) or ''
    out: list[str] = []
    entry = ''
    section = ''
    for line in doc.splitlines():
        found = SECTION.match(line)
        if found:
            section, entry = found[1], ''
            out += [f'**{section}**', '']
        elif section and line.startswith('        '):
            out[-1] += f' {line.strip()}'
        elif section and line.startswith('    '):
            entry = line.strip()
            key, colon, rest = entry.partition(': ')
            is_named = bool(colon) and ' ' not in key and section in {'Args', 'Attributes'}
            continues = section in {'Returns', 'Yields'} and out[-1] != ''
            if continues:
                out[-1] += f' {entry}'
            else:
                out.append(f'- `{key}`: {rest}' if is_named else f'- {entry}')
        else:
            section = '' if line and not line.startswith(' ') else section
            out.append(line)
    return '\n'.join(out).strip() + '\n'


if __name__ == '__main__':
    sys.exit(main())
