"""
A sweep on the workers of a Dask scheduler, which runs by itself, on one machine or on a cluster.

Each worker is asked first what it computes with. One with other code, other arithmetic, or without
the packages would give other rows, so it gets no work, and is named.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from mfpcc_experiments.sweeping import work
from mfpcc_experiments.sweeping.errors import SweepError, needs
from mfpcc_experiments.sweeping.work import Job

# Jobs that wait at each thread of a worker: it never idles, and little is done again if it dies.
_WAITING = 2
# How long to wait for a scheduler, and for the first worker that is of use (s).
_PATIENCE = 30.0
# How often to look for workers that have come or gone (s).
_LOOK_EVERY = 1.0


class _Crew:
    """
    The workers of a scheduler, and which of them are of use.

    Parameters
    ----------
    client : distributed.Client
    say : callable
        Told who is refused, and why.
    """

    def __init__(self, client: Any, say: Callable[[str], None]) -> None:
        self._client, self._say = client, say
        self._own = work.fingerprint()
        self._known: dict[str, bool] = {}
        self.threads: dict[str, int] = {}

    def look(self) -> None:
        """Find out who has come, and who has gone."""
        there = self._client.scheduler_info(n_workers=-1)["workers"]
        new = [address for address in there if address not in self._known]
        if new:
            answers = self._client.run(work.fingerprint, workers=new, on_error="return")
            for address in new:
                if address in answers:
                    why = _difference(self._own, answers[address])
                    self._known[address] = not why
                    if why:
                        name = there[address].get("name", address)
                        self._say(f"worker {name} ({address}) gets no work: {why}")
        self.threads = {
            address: worker["nthreads"]
            for address, worker in there.items()
            if self._known.get(address)
        }


def _difference(own: Mapping[str, str], answer: Any) -> str:
    """Why a worker is of no use; empty if it is."""
    if isinstance(answer, ModuleNotFoundError):
        return f"it has no package '{answer.name}'"
    if isinstance(answer, BaseException):
        return f"it cannot run: {type(answer).__name__}: {answer}"
    if not isinstance(answer, dict) or answer.get("code") != own["code"]:
        return "it has another version of the code"
    if answer.get("arithmetic") != own["arithmetic"]:
        return "the arithmetic of its processor gives other digits"
    return ""


def run(
    jobs: Iterator[Job],
    address: str | None,
    scheduler_file: Path | None,
    say: Callable[[str], None],
) -> Iterator[tuple[int, bytes]]:
    """
    Do jobs.

    Parameters
    ----------
    jobs : iterator of Job
        Taken as there is room for them.
    address, scheduler_file : str, Path, optional
        Where the scheduler is: one of the two.
    say : callable
        Told what is to be known while it runs.

    Yields
    ------
    number, data : int, bytes
        Of each chunk, as they are done.

    Raises
    ------
    SweepError
        If there is no scheduler, or no worker that is of use, or a row cannot be run.
    """
    needs("distributed")
    from distributed import CancelledError, Client, KilledWorker
    from distributed.client import wait

    where = str(address or scheduler_file)
    if scheduler_file is not None and not scheduler_file.is_file():
        raise SweepError(f"{scheduler_file}: there is no such file")
    try:
        client = Client(address, scheduler_file=scheduler_file, timeout=_PATIENCE)
    except (OSError, TimeoutError, ValueError) as error:
        raise SweepError(f"{where}: no Dask scheduler answers there ({error})") from None
    with client:
        crew = _Crew(client, say)
        waiting: dict[Any, tuple[Job, frozenset[str]]] = {}
        again: list[Job] = []
        alone_since, looked = time.monotonic(), -_LOOK_EVERY
        while True:
            now = time.monotonic()
            if now - looked >= _LOOK_EVERY:
                looked = now
                crew.look()
                for future, (job, workers) in list(waiting.items()):
                    if not workers & crew.threads.keys():
                        # all of those that it may go to are gone
                        future.cancel()
                        del waiting[future]
                        again.append(job)
            if crew.threads:
                alone_since = now
            elif now - alone_since > _PATIENCE:
                raise SweepError(
                    f"{where}: the scheduler has no worker that is of use; --resume goes on when "
                    "it has"
                )
            room = _WAITING * sum(crew.threads.values())
            while len(waiting) < room:
                job_ = again.pop() if again else next(jobs, None)
                if job_ is None:
                    break
                workers = frozenset(crew.threads)
                future = client.submit(Job.run, job_, workers=sorted(workers), pure=False)
                waiting[future] = job_, workers
            if not waiting:
                if crew.threads:
                    return
                time.sleep(0.1)
                continue
            try:
                wait(list(waiting), timeout=_LOOK_EVERY, return_when="FIRST_COMPLETED")
            except TimeoutError:
                continue
            for future in [future for future in waiting if future.done()]:
                job, _ = waiting.pop(future)
                try:
                    data = future.result()
                except CancelledError:
                    again.append(job)
                    continue
                except KilledWorker as error:
                    raise SweepError(
                        f"chunk {job.number}: workers die of it ({error}); --resume goes on after "
                        "the others"
                    ) from None
                yield job.number, data
