"""A sweep on the cores of this machine: one process for each, and a new one for one that dies."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait

from mfpcc_experiments.sweeping.errors import SweepError
from mfpcc_experiments.sweeping.work import Job

# A chunk that so many workers died of is not their fault.
_ATTEMPTS = 3


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


def run(jobs: Iterator[Job], workers: int) -> Iterator[tuple[int, bytes]]:
    """
    Do jobs.

    Parameters
    ----------
    jobs : iterator of Job
        Taken one by one.
    workers : int
        Processes.

    Yields
    ------
    number, data : int, bytes
        Of each chunk, as they are done.

    Raises
    ------
    SweepError
        If a row cannot be run, or every worker dies of a chunk.
    """
    attempts: dict[int, int] = {}
    again: list[Job] = []
    with ExitStack() as stack:
        pool: dict[Connection, _Worker] = {}

        def hire() -> _Worker:
            worker = _Worker()
            stack.callback(worker.end)
            pool[worker.pipe] = worker
            return worker

        def busy(worker: _Worker) -> None:
            job = again.pop() if again else next(jobs, None)
            if job is not None:
                worker.begin(job)

        for _ in range(workers):
            busy(hire())
        while any(worker.job for worker in pool.values()):
            for pipe in wait([pipe for pipe, worker in pool.items() if worker.job]):
                worker = pool[pipe]  # type: ignore[index]
                job = worker.job
                assert job is not None
                try:
                    number, data, complaint = worker.pipe.recv()
                except (EOFError, ConnectionResetError):
                    del pool[worker.pipe]
                    attempts[job.number] = attempts.get(job.number, 0) + 1
                    if attempts[job.number] >= _ATTEMPTS:
                        raise SweepError(
                            f"chunk {job.number}: {_ATTEMPTS} workers died of it, the last with "
                            f"exit code {worker.process.wait()}; --resume goes on after the others"
                        ) from None
                    again.append(job)
                    busy(hire())
                    continue
                if complaint:
                    raise SweepError(complaint)
                worker.job = None
                yield number, data
                busy(worker)
