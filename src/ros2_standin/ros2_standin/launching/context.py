"""What actions of a launch file share while it runs."""

from __future__ import annotations

from dataclasses import dataclass, field

from ros2_standin.launching.supervisor import Supervisor


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
