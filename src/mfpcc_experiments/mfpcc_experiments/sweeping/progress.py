"""The progress of many jobs: how much is done, how fast, and how long it still takes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich import progress
from rich.console import Console

from pwm_node import interrupts


class _Rate(progress.ProgressColumn):
    """How many per second since the start, and the time that the rest takes at that rate."""

    def render(self, task: progress.Task) -> str:  # type: ignore[override]
        done = task.completed - task.fields["before"]
        if not done or not task.elapsed:
            return ""
        rate = done / task.elapsed
        left = round(((task.total or 0.0) - task.completed) / rate)
        shown = f"{rate:,.1f}" if rate < 100.0 else f"{rate:,.0f}"
        return f"{shown} {task.description}/s, {timedelta(seconds=left)} left"


class Progress:
    """
    What there is to be told while the work lasts.

    Parameters
    ----------
    bar : rich.progress.Progress
        Where it is shown.
    unit : str
        What is counted.
    total, done : int
        How many there are, and how many were there before.
    """

    def __init__(self, bar: progress.Progress, unit: str, total: int, done: int) -> None:
        self.done = done
        self._bar = bar
        self._task = bar.add_task(unit, total=total, completed=done, before=done)

    def add(self, count: int) -> None:
        """So many more are done."""
        self.done += count
        self._bar.update(self._task, completed=self.done)

    def say(self, text: str) -> None:
        """Say something above the bar."""
        self._bar.console.print(text, highlight=False, soft_wrap=True)


@contextmanager
def counted(name: str, unit: str, total: int, done: int) -> Iterator[Progress]:
    """Show a progress bar on stderr while the work lasts; an interrupt takes it away."""
    columns = (
        progress.TextColumn(name),
        progress.BarColumn(),
        progress.TaskProgressColumn(),
        progress.TextColumn("{task.completed:,.0f} of {task.total:,.0f}"),
        _Rate(),
    )
    with interrupts.undone(), progress.Progress(*columns, console=Console(stderr=True)) as bar:
        yield Progress(bar, unit, total, done)
