# SPDX-License-Identifier: Apache-2.0
"""Plots of many sequences beside each other, as one HTML page. Needs the extra `report`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.io.atomic import write_atomic

# Told apart by people who see no red or no green, too (Okabe and Ito), and by their marks.
STYLES = (
    ('#000000', 'line-ew-open'), ('#d55e00', 'triangle-up-open'), ('#0072b2', 'circle-open'),
    ('#009e73', 'x-thin-open'), ('#cc79a7', 'square-open'),
)  # fmt: skip
PANEL_PX = 360
MAX_NAMES = 60  # more sequences have no room for theirs below the axis; the mouse shows it


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One plot: some figures of each sequence.

    Attributes:
        title: What is measured, with its unit.
        lines: (N,) values by what is compared, in the order of `STYLES`; NaN = none.
        levels: Published means that are drawn across, by what is compared.

    """

    title: str
    lines: Mapping[str, Array]
    levels: Mapping[str, float] = field(default_factory=dict)


def check_library() -> None:
    """Refuse where a page could not be made, before the work.

    Raises:
        InputError: BAD_PARAMETER. The library is not installed; the message says how to.

    """
    if find_spec('plotly') is None:
        msg = "plots need plotly, not installed here: pip install 'rpgd_ros[report]'"
        raise InputError(Reason.BAD_PARAMETER, msg)


def write_plots(path: Path, title: str, names: Sequence[str], panels: Sequence[Panel]) -> None:
    """Write the plots below each other, sequences from left to right.

    Args:
        path: Of the page; it needs no network.
        title: Of the page.
        names: (N,) of the sequences.
        panels: What to plot.

    Raises:
        InputError: NOT_WRITABLE, or the library is missing.

    """
    check_library()
    from plotly.subplots import make_subplots  # noqa: PLC0415

    page = make_subplots(
        rows=len(panels), cols=1, shared_xaxes=True, vertical_spacing=0.3 / (len(panels) + 1),
        subplot_titles=[panel.title for panel in panels],
    )  # fmt: skip
    shown: set[str] = set()
    numbers = list(range(1, len(names) + 1))
    for row, panel in enumerate(panels, 1):
        for (label, values), (colour, mark) in zip(panel.lines.items(), STYLES, strict=False):
            page.add_scatter(
                x=numbers, y=[float(v) if v > 0.0 else None for v in values], name=label,
                text=list(names), mode='markers', hovertemplate='%{text}: %{y:.4g}',
                marker={'color': colour, 'symbol': mark, 'size': 9, 'line': {'width': 1.5}},
                legendgroup=label, showlegend=label not in shown, row=row, col=1,
            )  # fmt: skip
            shown.add(label)
            if label in panel.levels:
                name = f'{label}, published'
                page.add_scatter(
                    x=[0.5, len(names) + 0.5], y=[panel.levels[label]] * 2, name=name,
                    mode='lines', line={'color': colour, 'dash': 'dot', 'width': 1},
                    hovertemplate=f'{name}: %{{y:.4g}}<extra></extra>', row=row, col=1,
                )  # fmt: skip
        # Ten times the error is one step up, whatever the method.
        page.update_yaxes(type='log', row=row, col=1)
    page.update_layout(title=title, template='plotly_white', height=PANEL_PX * len(panels) + 120)
    if len(names) <= MAX_NAMES:
        page.update_xaxes(tickvals=numbers, ticktext=list(names), row=len(panels), col=1)
    write_atomic(path, page.to_html(include_plotlyjs=True, full_html=True))
