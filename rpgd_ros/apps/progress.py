# SPDX-License-Identifier: Apache-2.0
"""One progress bar on the terminal, with rate and time left; nothing where there is none."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from threading import Event

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from rpgd_ros.apps.stopping import Stopped

Tell = Callable[[str, float], None]


class RateColumn(ProgressColumn):
    """How fast it goes: things a second where things are counted, else per cent a second."""

    def render(self, task: Task) -> Text:
        """Return the rate, nothing before there is one."""
        if task.speed is None:
            return Text('')
        count, unit = task.fields.get('things') or (100.0, '%')
        rate = count * task.speed
        text = f'{rate:,.3g} {unit}/s' if rate >= 1.0 else f'{60.0 * rate:.3g} {unit}/min'
        return Text(text, style='progress.data.speed')


def bar_columns() -> tuple[ProgressColumn, ...]:
    """Return what every bar of the programs shows: stage, share, rate and time left."""
    return (
        TextColumn('{task.description:>12}'),
        BarColumn(),
        TextColumn('{task.percentage:>3.0f} %'),
        RateColumn(),
        TimeRemainingColumn(),
    )


@contextmanager
def one_bar(
    console: Console, stop: Event, things: Mapping[str, tuple[int, str]] | None = None
) -> Iterator[Tell]:
    """Show one bar, named after the stage that reports; end the run after a signal.

    Args:
        console: Where; a file or pipe gets nothing.
        stop: Set by a signal.
        things: Number and name of what a stage works through, where known.

    Yields:
        What is told a stage and the share of it that is done.

    """
    with Progress(*bar_columns(), console=console, transient=True) as progress:
        task = progress.add_task('', total=1.0)
        current = ''

        def tell(stage: str, share: float) -> None:
            nonlocal current
            if stop.is_set():
                raise Stopped
            if stage != current:
                # A rate is that of one stage.
                progress.reset(
                    task, total=1.0, description=stage, things=(things or {}).get(stage)
                )
                current = stage
            progress.update(task, completed=share)

        yield tell
