"""What actions of a launch file share while it runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ros2_standin.launching.processes import Supervisor


class LaunchError(Exception):
    """A launch file cannot be run; the text says why."""


@dataclass
class LaunchContext:
    """
    State of a launch.

    Parameters
    ----------
    launch_configurations : dict
        Values of the arguments.
    supervisor : Supervisor
        Runs the processes.
    prefix : list of str
        Goes before every command.
    """

    launch_configurations: dict[str, str]
    supervisor: Supervisor
    prefix: list[str] = field(default_factory=list)


def log(level: str, name: str, message: str) -> None:
    """Print a line as the real launch does."""
    print(f"[{level}] [{name}]: {message}", flush=True)
