"""Experiments with the drive, and the command mfpcc.

For scripts and notebooks: `run` and `load` give a `Result`, `Experiment` describes a run::

    from mfpcc_experiments import run
    result = run("steady_750_2", scheme="mls_mfpcc", controller={"mismatch.inductance": 2.0})
    result.metrics["thd_percent"]["oversampled"]
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mfpcc_experiments.front_door import front_door

if TYPE_CHECKING:
    from mfpcc_experiments.results import Result, load, run
    from mfpcc_experiments.running import Scenario as Experiment

__all__ = ["Experiment", "Result", "load", "run"]

_find = front_door(__name__, {"results": ("Result", "load", "run"), "running": ("Scenario",)})


def __getattr__(name: str) -> Any:
    return _find("Scenario" if name == "Experiment" else name)
