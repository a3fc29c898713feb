"""Runs a launch file."""

from __future__ import annotations

import shlex
import signal
import tempfile
import traceback
from pathlib import Path

from ros2_standin.launching.actions import load
from ros2_standin.launching.context import LaunchContext
from ros2_standin.launching.output import log
from ros2_standin.launching.supervisor import Supervisor


def launch(path: Path, arguments: dict[str, str], *, prefix: str = "", debug: bool = False) -> int:
    """
    Run a launch file until all its processes have ended.

    Parameters
    ----------
    path : Path
        The launch file.
    arguments : dict
        Values of its arguments.
    prefix : str
        Command to run every process with.
    debug : bool
        Print the traceback of an error in the launch file.

    Returns
    -------
    int
        1 if the launch file has an error, else 0.
    """
    with tempfile.TemporaryDirectory(prefix="launch_") as folder:
        supervisor = Supervisor(Path(folder))
        context = LaunchContext(arguments, supervisor, shlex.split(prefix))
        kinds = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        before = [signal.signal(kind, supervisor.ask) for kind in kinds]
        code = 0
        try:
            load(path).visit(context)
        except Exception as error:  # noqa: BLE001 (launch files are anybody's code)
            if debug:
                traceback.print_exc()
            log("ERROR", "launch", f"Caught exception in launch (see debug for traceback): {error}")
            code = 1
            supervisor.shut_down()
        finally:
            supervisor.run()
            for kind, handler in zip(kinds, before, strict=True):
                signal.signal(kind, handler)
    return code
