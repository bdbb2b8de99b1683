# SPDX-License-Identifier: Apache-2.0
"""Sets a report as one HTML page that needs no network. Needs the extra `report`."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.io.atomic import write_atomic
from rpgd_ros.report.blocks import Block, Figure, Section, Side
from rpgd_ros.report.case import Case
from rpgd_ros.report.measure import Measured, measure
from rpgd_ros.report.plain import plain
from rpgd_ros.report.sections import SECTIONS
from rpgd_ros.report.verdict import Verdict, is_of_nothing, judge

PAGE = Path(__file__).parent / 'page'
NEEDED = {'plotly': 'plotly', 'jinja2': 'Jinja2'}  # modules and what pip calls them


def check_libraries() -> None:
    """Refuse where a page could not be made, before the work.

    Raises:
        InputError: BAD_PARAMETER. A library is not installed; the message says how to.

    """
    missing = [name for module, name in NEEDED.items() if find_spec(module) is None]
    if missing:
        msg = (
            f'a report needs {" and ".join(missing)}, not installed here: '
            "pip install 'rpgd_ros[report]'"
        )
        raise InputError(Reason.BAD_PARAMETER, msg)


def write_report(path: Path | str, case: Case) -> Verdict:
    """Write the page of a run, whole or not at all.

    Args:
        path: File. The folder must exist.
        case: The run, accepted or refused.

    Returns:
        The verdict that the page begins with.

    Raises:
        InputError: NOT_WRITABLE, or a library is missing.

    """
    measured = measure(case)
    verdict = judge(measured)
    write_atomic(path, page_of(measured, verdict))
    return verdict


def page_of(measured: Measured, verdict: Verdict) -> str:
    """Return the page as text; arguments as `measure` and `judge` give them."""
    check_libraries()
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415

    # All values are escaped by the library; only our own files and scripts are not.
    environment = Environment(
        loader=FileSystemLoader(PAGE),
        autoescape=True,
        finalize=_plain,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    sections = [section for make in SECTIONS for section in make(measured)]
    case = measured.case
    c = case.calibration
    when = datetime.fromtimestamp(case.stamp_ns // NS_PER_S, UTC).strftime('%Y-%m-%d %H:%M UTC')
    return environment.get_template('report.html').render(
        verdict=verdict,
        case=case,
        calibration=c,
        warnings=[] if is_of_nothing(measured) else _not_said(case, verdict),
        asides=_not_said(case, verdict) if is_of_nothing(measured) else [],
        when=when,
        sections=sections,
        figures=[_script(figure) for figure in _figures(sections)],
        plotly=_packed_plotly(),
        style=(PAGE / 'report.css').read_text(),
        script=(PAGE / 'report.js').read_text(),
    )


def _plain(value: object) -> object:
    """Return what a place of the page is filled with; our own markup is a type of its own."""
    return plain(value) if type(value) is str else value


def _not_said(case: Case, verdict: Verdict) -> list[str]:
    """Return the warnings that are not among the places to look at already."""
    said = {place.text for place in verdict.places}
    warnings = [warning.replace('+-', '±') for warning in case.warnings]
    return [warning for warning in warnings if warning not in said]


def _figures(sections: Sequence[Section]) -> Iterator[Figure]:
    def within(blocks: Sequence[Block]) -> Iterator[Figure]:
        for block in blocks:
            if isinstance(block, Figure):
                yield block
            elif isinstance(block, Side):
                yield from within(block.blocks)

    for section in sections:
        yield from within(section.blocks)


def _script(figure: Figure) -> tuple[str, str]:
    """Key and content of a figure, the latter so that it may stand within a <script>."""
    content = {'data': figure.traces, 'layout': figure.layout}
    text = json.dumps(content, allow_nan=False, separators=(',', ':'))
    return figure.key, text.replace('<', '\\u003c').replace('>', '\\u003e')


def _packed_plotly() -> str:
    """Plotly's script, compressed: 2 MB of the page instead of 5."""
    from plotly.offline import get_plotlyjs  # noqa: PLC0415

    script: str = get_plotlyjs()
    return base64.b64encode(gzip.compress(script.encode(), 9, mtime=0)).decode()
