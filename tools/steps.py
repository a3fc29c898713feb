"""Steps of the set-up: programs that are run, shown if they fail, and never left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

Command = Sequence[str | Path]


class SetUpError(Exception):
    """What is wrong, and what to do about it: for a person."""


class StepError(SetUpError):
    """A step that failed; `output` is all that it said."""

    def __init__(self, step: str, command: Command, why: str, output: str) -> None:
        super().__init__(
            f"the step '{step}' {why}; above is its output. What it left is not used: when the "
            "cause is mended, call make again.\n"
            f"  {' '.join(str(argument) for argument in command)}"
        )
        self.output = output


class Steps:
    """Run programs, one step after the other.

    Parameters
    ----------
    folder : Path
        Where they run.
    lock : file
        They inherit it, so that, should this process be killed, the next one waits for their end.
    """

    def __init__(self, folder: Path, lock: IO[str]) -> None:
        self._folder = folder
        self._lock = lock

    def run(self, step: str, *commands: Command, environment: Mapping[str, str]) -> None:
        """Run the commands of one step at the same time.

        Raises
        ------
        StepError
            If one of them fails; the others are ended, and what it said has been printed.
        """
        print(f"  {step} ...", end="", flush=True)
        begin = time.monotonic()
        running: list[tuple[Command, subprocess.Popen[bytes], IO[str]]] = []
        try:
            for command in commands:
                output: IO[str] = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115
                running.append((command, self._start(command, output, environment), output))
            failed = [item for item in running if item[1].wait() != 0]
        except BaseException as error:
            print(" broken off", flush=True)
            if isinstance(error, OSError):
                why = f"cannot be run: {error.strerror}"
                raise StepError(step, command, why, f"{why}\n") from None
            raise
        finally:
            for _, process, _ in running:
                _end(process)
        if not failed:
            print(f" {time.monotonic() - begin:.0f} s", flush=True)
            return
        print(" failed", flush=True)
        command, process, said = failed[0]
        said.seek(0)
        raise StepError(step, command, f"failed with exit code {process.returncode}", said.read())

    def _start(
        self, command: Command, output: IO[str], environment: Mapping[str, str]
    ) -> subprocess.Popen[bytes]:
        # In a process group of its own, so that nothing of it is left when it is broken off.
        return subprocess.Popen(
            [str(argument) for argument in command],
            cwd=self._folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            pass_fds=(self._lock.fileno(),),
        )


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a step and all that it started, some of which may outlive it."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def show(error: StepError) -> None:
    """Print what a step said that failed."""
    sys.stdout.write(error.output)
    sys.stdout.flush()
