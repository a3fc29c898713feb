"""Runs processes until all have ended; it knows nothing of launch files."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import yaml

from ros2_standin.launching.output import LaunchError, log

#: Time from each signal to the next harder one (s).
PATIENCE = 5.0
_ESCALATION = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


class Process:
    """
    A running process.

    Parameters
    ----------
    command : list of str
    label : str
        Name in the output, without its number.
    folder : str or None
        Where to run.
    environment : dict
        Added to the environment.
    on_exit : callable
        Called with the label when it has ended.
    """

    def __init__(
        self,
        command: list[str],
        label: str,
        *,
        folder: str | None,
        environment: dict[str, str],
        on_exit: Callable[[str], None],
    ) -> None:
        self.command = command
        self.label = label
        self.on_exit = on_exit
        self._folder = folder
        self._environment = {**os.environ, **environment}
        self._popen: subprocess.Popen[str] | None = None

    def start(self, ended: queue.Queue[Process]) -> None:
        """Run; put itself into `ended` at the end."""
        try:
            self._popen = subprocess.Popen(
                self.command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                cwd=self._folder,
                env=self._environment,
                # Ctrl-C in the terminal is for the launch, which passes it on once.
                start_new_session=True,
            )
        except OSError as error:
            raise LaunchError(f"{self.command[0]}: {error.strerror}") from None
        log("INFO", self.label, f"process started with pid [{self._popen.pid}]")
        threading.Thread(target=self._watch, args=(ended,), daemon=True).start()

    def _watch(self, ended: queue.Queue[Process]) -> None:
        """Print the output until there is no more."""
        assert self._popen is not None and self._popen.stdout is not None
        for line in self._popen.stdout:
            print(f"[{self.label}] {line.rstrip()}", flush=True)
        self._popen.wait()
        ended.put(self)

    def send(self, kind: signal.Signals) -> None:
        """Send a signal."""
        assert self._popen is not None
        log("INFO", self.label, f"sending signal '{kind.name}' to process[{self.label}]")
        self._popen.send_signal(kind)

    def report(self) -> None:
        """Print how it ended."""
        assert self._popen is not None
        pid, code = self._popen.pid, self._popen.returncode
        if code == 0:
            log("INFO", self.label, f"process has finished cleanly [pid {pid}]")
        else:
            command = " ".join(self.command)
            log(
                "ERROR",
                self.label,
                f"process has died [pid {pid}, exit code {code}, cmd '{command}'].",
            )


class Supervisor:
    """
    Starts processes, and runs until all have ended.

    Parameters
    ----------
    folder : Path
        For parameter files.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.started: list[Process] = []
        self._files = 0
        self._running: list[Process] = []
        self._ended: queue.Queue[Process] = queue.Queue()
        self._stage = 0  # of the escalation
        self._next_stage_at = float("inf")
        self._asked: list[signal.Signals] = []

    def write_parameters(self, content: Any) -> str:
        """Write a parameter file of its own, and return its path."""
        self._files += 1
        path = self.folder / f"launch_params_{self._files}.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return str(path)

    def start(self, process: Process) -> None:
        """Start a process, unless all are being ended."""
        if self._stage or self._asked:
            return
        self.started.append(process)
        process.label += f"-{len(self.started)}"
        process.start(self._ended)
        self._running.append(process)

    def shut_down(self) -> None:
        """Ask all processes to end."""
        if self._stage == 0:
            self._escalate()

    def ask(self, number: int, frame: FrameType | None) -> None:
        """Note a signal that came; `run` acts on it."""
        self._asked.append(signal.Signals(number))

    def run(self) -> None:
        """Wait until all have ended."""
        while self._running:
            with contextlib.suppress(queue.Empty):
                self._handle(self._ended.get(timeout=0.1))
            while self._asked:
                self._interrupted(self._asked.pop(0))
            if time.monotonic() > self._next_stage_at:
                self._escalate()

    def _interrupted(self, kind: signal.Signals) -> None:
        how = "ctrl-c (SIGINT)" if kind == signal.SIGINT else kind.name
        if self._stage:
            log("WARNING", "launch", f"user interrupted with {how} again, ignoring...")
        else:
            log("WARNING", "launch", f"user interrupted with {how}")
            self.shut_down()

    def _handle(self, process: Process) -> None:
        """A process has ended."""
        self._running.remove(process)
        process.report()
        process.on_exit(process.label)

    def _escalate(self) -> None:
        """Send the next signal to all that still run."""
        kind = _ESCALATION[min(self._stage, len(_ESCALATION) - 1)]
        for process in reversed(self._running):
            if self._stage:
                before = _ESCALATION[min(self._stage, len(_ESCALATION) - 1) - 1].name
                log(
                    "ERROR",
                    process.label,
                    f"process[{process.label}] failed to terminate '{PATIENCE:g}' seconds after "
                    f"receiving '{before}', escalating to '{kind.name}'",
                )
            process.send(kind)
        self._stage += 1
        self._next_stage_at = time.monotonic() + PATIENCE
