"""Jobs on the cores of this machine: one process for each, and a new one for one that dies."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol

from mfpcc_experiments.sweeping.errors import SweepError

# A job that so many workers died of is not their fault.
_ATTEMPTS = 3


class Job(Protocol):
    """
    What a worker process can do, here or elsewhere; it can be pickled.

    Attributes
    ----------
    number : int
        By which its result is known.
    """

    @property
    def number(self) -> int: ...

    def run(self) -> Any:
        """Do it, and return its result."""


class _Worker:
    """One process, and the job that it is at."""

    def __init__(self) -> None:
        self.pipe, theirs = Pipe()
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "mfpcc_experiments.sweeping.worker", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                start_new_session=True,  # the terminal's Ctrl-C is not for it
            )
        self.job: Job | None = None

    def begin(self, job: Job) -> None:
        """Give it a job."""
        self.job = job
        self.pipe.send(job)

    def end(self) -> None:
        """End it, whatever it is at: what it has not given back is nowhere."""
        self.pipe.close()
        self.process.kill()
        self.process.wait()


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


class Pool:
    """
    Worker processes, which last from the first job on until `end`.

    Parameters
    ----------
    workers : int
        How many.
    """

    def __init__(self, workers: int) -> None:
        self._size = workers
        self._workers: dict[Connection, _Worker] = {}

    @property
    def processes(self) -> list[int]:
        """Their numbers."""
        return [worker.process.pid for worker in self._workers.values()]

    def end(self) -> None:
        """End all of them."""
        for worker in self._workers.values():
            worker.end()
        self._workers.clear()

    def run(self, jobs: Iterator[Job]) -> Iterator[tuple[int, Any]]:
        """
        Do jobs.

        Parameters
        ----------
        jobs : iterator of Job
            Taken one by one.

        Yields
        ------
        number, result : int, Any
            Of each job, as they are done.

        Raises
        ------
        SweepError
            If a job cannot be done, or every worker dies of it.
        """
        attempts: dict[int, int] = {}
        again: list[Job] = []

        def busy(worker: _Worker) -> None:
            worker.job = None
            job = again.pop() if again else next(jobs, None)
            if job is not None:
                worker.begin(job)

        while len(self._workers) < self._size:
            self._hire()
        for worker in self._workers.values():
            busy(worker)
        while working := [pipe for pipe, worker in self._workers.items() if worker.job]:
            for pipe in wait(working):
                worker = self._workers[pipe]  # type: ignore[index]
                job = worker.job
                assert job is not None
                try:
                    number, result, complaint = worker.pipe.recv()
                except (EOFError, ConnectionResetError):
                    del self._workers[worker.pipe]
                    attempts[job.number] = attempts.get(job.number, 0) + 1
                    if attempts[job.number] >= _ATTEMPTS:
                        raise SweepError(
                            f"chunk {job.number}: {_ATTEMPTS} workers died of it, the last with "
                            f"exit code {worker.process.wait()}; --resume goes on after the others"
                        ) from None
                    worker.end()
                    again.append(job)
                    busy(self._hire())
                    continue
                if complaint:
                    raise SweepError(complaint)
                worker.job = None
                yield number, result
                busy(worker)

    def _hire(self) -> _Worker:
        worker = _Worker()
        self._workers[worker.pipe] = worker
        return worker


@contextmanager
def pool(workers: int) -> Iterator[Pool]:
    """Worker processes, which end with the `with` block."""
    found = Pool(workers)
    try:
        yield found
    finally:
        found.end()
