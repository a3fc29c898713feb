"""The progress of a sweep: how much is done, how fast, and how long it still takes."""

from __future__ import annotations

from types import TracebackType

from rich import progress
from rich.console import Console


class _Rate(progress.ProgressColumn):
    """Runs per second."""

    def render(self, task: progress.Task) -> str:  # type: ignore[override]
        return f"{task.speed:,.0f} runs/s" if task.speed else ""


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
            progress.TimeRemainingColumn(elapsed_when_finished=True),
            console=self._console,
            speed_estimate_period=60.0,
        )
        self._task = self._bar.add_task("sweep", total=rows, completed=done)

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
