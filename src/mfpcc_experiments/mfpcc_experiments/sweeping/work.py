"""
One chunk of a sweep: from a job to the bytes of a Parquet file, on whatever machine.

A job is all that is needed, so that a worker reads nothing but its own code.
"""

from __future__ import annotations

import functools
import hashlib
import io
import json
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_controller.protection import FAULTS as OF_CONTROLLER
from mfpcc_experiments.running import Scenario, scenario
from mfpcc_experiments.running.batch import FIGURES, OUTCOME, Batch, drive_of
from mfpcc_experiments.sweeping.drives import Drives, place
from mfpcc_experiments.sweeping.errors import SweepError
from mfpcc_experiments.sweeping.plan import Plan
from pmsm_sim.motor import MotorPars
from pmsm_sim.parts.protection import FAULTS as OF_PLANT
from pwm_node import bits


@dataclass(frozen=True)
class Job:
    """
    One chunk of a sweep.

    Attributes
    ----------
    number : int
        Of the chunk.
    sweep : str
        What is the same in all chunks, as JSON: `base`, `motors`, `vary`, `survived`, `metrics`.
    scheme : str
        Who controls.
    first : int
        Number of its first row.
    columns : dict
        What varies in its rows, by name, and their seeds.
    """

    number: int
    sweep: str
    scheme: str
    first: int
    columns: dict[str, NDArray[Any]]

    def run(self) -> bytes:
        """
        Run its rows, as `outcomes`.

        Returns
        -------
        bytes
            A Parquet file.
        """
        import pyarrow
        from pyarrow import parquet

        sweep, outcome = _sweep(self.sweep), outcomes(self)
        n = len(outcome)
        table: dict[str, Any] = {
            "row": np.arange(self.first, self.first + n),
            "scheme": pyarrow.array([self.scheme] * n).dictionary_encode(),
            **{name: self.columns[name] for name in sweep["vary"] if name != "seed"},
            "seed": self.columns["seed"],
            "survived": survived(outcome, sweep["survived"]),
            "steady": pyarrow.array(outcome["steady"] == 1, mask=outcome["steady"] < 0),
            "i_peak": outcome["i_peak"],
            "i_peak_over_limit": outcome["i_peak_over_limit"],
            "faults": pyarrow.array(_faults(outcome)).dictionary_encode(),
            "fell_back": outcome["fell_back"],
            "ran_away": outcome["ran_away"],
        }
        for name in dict.fromkeys(
            [*sweep["metrics"], *filter(FIGURES.__contains__, sweep["survived"])]
        ):
            # what there is not is null, as in metrics.json
            figure = np.ascontiguousarray(outcome["figures"][:, FIGURES.index(name)])
            table[name] = pyarrow.array(figure, from_pandas=True)
        file = io.BytesIO()
        parquet.write_table(pyarrow.table(table), file, compression="zstd", version="2.6")
        return file.getvalue()


def shared(plan: Plan) -> dict[str, Any]:
    """What is the same in all chunks of a sweep."""
    return {
        "base": plan.base.model_dump(mode="json"),
        "motors": {name: motor.model_dump(mode="json") for name, motor in plan.motors.items()},
        "vary": list(plan.spec.vary),
        "survived": plan.spec.survived,
        "metrics": plan.spec.metrics,
    }


def jobs(plan: Plan, chunks: Iterable[int] | None = None) -> Iterator[Job]:
    """The chunks of a sweep, or some of them, to be done."""
    text = json.dumps(shared(plan))
    for number in range(plan.chunks) if chunks is None else chunks:
        scheme, start, stop = plan.chunk(number)
        yield Job(number, text, scheme, start, plan.columns(start, stop))


def outcomes(job: Job, look: Callable[[Batch, float], None] | None = None) -> NDArray[np.void]:
    """
    Run the rows of a chunk.

    Parameters
    ----------
    job : Job
        The chunk.
    look : callable, optional
        Told after each run the batch, whose `signals` are those of the run, and the motor's current
        limit (A).

    Returns
    -------
    structured array of `batch.OUTCOME`, shape (n,)

    Raises
    ------
    SweepError
        If a row is none that can be run, with its number.
    """
    drives, batch = _prepared(job.sweep, job.scheme, threading.get_ident())
    columns = {name: values.tolist() for name, values in job.columns.items()}
    n = len(columns["seed"])
    found = np.zeros(n, OUTCOME)
    for k in range(n):
        try:
            drive = drives.drive({name: values[k] for name, values in columns.items()})
        except SweepError as error:
            raise SweepError(f"row {job.first + k}: {error}") from None
        batch.one(drive, found[k : k + 1])
        if look is not None:
            look(batch, drive.controller_motor.i_max)
    return found


def survived(outcome: NDArray[np.void], limits: Mapping[str, float]) -> NDArray[np.bool_]:
    """Whether each row kept all limits, with no fault, and with its own scheme to the end."""
    good = (outcome["faults_plant"] == 0) & (outcome["faults_controller"] == 0)
    good &= ~outcome["fell_back"] & ~outcome["ran_away"]
    for name, limit in limits.items():
        known = FIGURES.index(name) if name in FIGURES else None
        values = outcome[name] if known is None else outcome["figures"][:, known]
        good &= np.abs(values) < limit  # false where there is none
    return good


def _faults(outcome: NDArray[np.void]) -> list[str]:
    """The codes of the latched faults of each row."""

    @functools.cache
    def codes(of_plant: int, of_controller: int) -> str:
        pairs = ((OF_PLANT.codes, of_plant), (OF_CONTROLLER.codes, of_controller))
        found = [c for known, latched in pairs for bit, c in enumerate(known) if latched >> bit & 1]
        return " ".join(dict.fromkeys(found))

    return [
        codes(*pair)
        for pair in zip(
            outcome["faults_plant"].tolist(), outcome["faults_controller"].tolist(), strict=True
        )
    ]


@functools.lru_cache(maxsize=2)
def _sweep(text: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(text)
    return found


@functools.lru_cache(maxsize=64)
def _prepared(text: str, scheme: str, thread: int) -> tuple[Drives, Batch]:
    """What is the same in all rows of a scheme; each thread has a room of its own to run in."""
    sweep = _sweep(text)
    base = Scenario.model_validate(sweep["base"])
    motors = {name: MotorPars.model_validate(motor) for name, motor in sweep["motors"].items()}
    drives = Drives(base, scheme, {name: place(base, name) for name in sweep["vary"]}, motors)
    plant, _ = base.node_parameters(scheme, 0)
    return drives, Batch(base.periods, base.window_s, base.pwm_frequency, plant["oversampling"])


# What a row comes from: packages, and rooms of this one.
_CODE = (
    "pwm_node",
    "pmsm_sim",
    "mfpcc_controller",
    "mfpcc_experiments.running",
    "mfpcc_experiments.measuring",
    "mfpcc_experiments.sweeping",
)
_LIBRARIES = ("numpy", "scipy", "numba", "llvmlite", "pyarrow")


@functools.cache
def fingerprint() -> dict[str, str]:
    """
    What has to be equal for two machines to give the same rows.

    Returns
    -------
    dict
        `code`: digest of our files and of the versions of what they are built on; `arithmetic`:
        digest of what short runs give, which the processor has a part in.
    """
    digest = hashlib.sha256(f"{sys.version_info[:2]}".encode())
    for library in _LIBRARIES:
        digest.update(f"{library} {metadata.version(library)}\n".encode())
    for name in _CODE:
        spec = find_spec(name)
        assert spec is not None and spec.origin is not None
        folder = Path(spec.origin).parent
        for path in sorted(folder.rglob("*.py")):
            digest.update(f"{name}/{path.relative_to(folder)}\n".encode() + path.read_bytes())
    found = hashlib.sha256()
    base = scenario.changed(
        scenario.load("steady_750_2"), ["duration=0.02", "window_s=[0.01,0.02]"]
    )
    batch = Batch(base.periods, base.window_s, base.pwm_frequency, 0)
    for scheme, dead_time in (("mls_mfpcc", 0.0), ("mls_mfpcc_paper", 2e-6)):
        plant, controller = base.node_parameters(scheme, 1)
        drive = drive_of({**plant, "inverter.dead_time": dead_time}, controller)
        found.update(bits.of(batch.run([drive])))
    return {"code": digest.hexdigest()[:16], "arithmetic": found.hexdigest()[:16]}
