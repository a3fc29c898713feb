"""A progress bar for work of several steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

#: Told now and then how much of a step is done, in the step's own unit.
Tell = Callable[[float], None]


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], Tell]]:
    """
    Show progress on stderr while the work lasts.

    Yields
    ------
    callable
        Begins a step: `step(name, total)` returns what is to be told how much of the total is
        done. The step before is finished with it.
    """
    from rich import progress
    from rich.console import Console

    from pwm_node import interrupts

    columns = (
        progress.TextColumn("{task.description:<12}"),
        progress.BarColumn(),
        progress.TaskProgressColumn(),
        progress.TimeElapsedColumn(),
    )
    # an interrupt gives the terminal its cursor back
    with interrupts.undone(), progress.Progress(*columns, console=Console(stderr=True)) as bar:

        def step(name: str, total: float) -> Tell:
            for task in bar.tasks:
                bar.update(task.id, completed=task.total)
            identity = bar.add_task(name, total=total)

            def tell(done: float) -> None:
                interrupts.check()
                bar.update(identity, completed=done)

            return tell

        yield step
        for task in bar.tasks:
            bar.update(task.id, completed=task.total)
