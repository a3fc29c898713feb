"""The progress of a sweep: how much is done, how fast, and how long it still takes."""

from __future__ import annotations

from datetime import timedelta
from types import TracebackType

from rich import progress
from rich.console import Console


class _Rate(progress.ProgressColumn):
    """Runs per second since the start, and the time that the rest takes at that rate."""

    def render(self, task: progress.Task) -> str:  # type: ignore[override]
        done = task.completed - task.fields["before"]
        if not done or not task.elapsed:
            return ""
        rate = done / task.elapsed
        left = round(((task.total or 0.0) - task.completed) / rate)
        return f"{rate:,.0f} runs/s, {timedelta(seconds=left)} left"


class Progress:
    """
    A progress bar on stderr.

    Parameters
    ----------
    rows, done : int
        How many there are, and how many were there before.
    """

    def __init__(self, rows: int, done: int) -> None:
        self.done = done
        self._console = Console(stderr=True)
        self._bar = progress.Progress(
            progress.TextColumn("sweep"),
            progress.BarColumn(),
            progress.TaskProgressColumn(),
            progress.TextColumn("{task.completed:,.0f} of {task.total:,.0f}"),
            _Rate(),
            console=self._console,
        )
        self._task = self._bar.add_task("sweep", total=rows, completed=done, before=done)

    def __enter__(self) -> Progress:
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.stop()

    def add(self, rows: int) -> None:
        """So many more are done."""
        self.done += rows
        self._bar.update(self._task, completed=self.done)

    def say(self, text: str) -> None:
        """Say something above the bar."""
        self._console.print(text, highlight=False, soft_wrap=True)
