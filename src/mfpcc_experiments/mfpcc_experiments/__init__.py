"""Experiments with the drive, and the command mfpcc.

For scripts and notebooks: `run` and `load` give a `Result`, `Experiment` describes a run::

    from mfpcc_experiments import run
    result = run("steady_750_2", scheme="mls_mfpcc", controller={"mismatch.inductance": 2.0})
    result.metrics["thd_percent"]["oversampled"]
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mfpcc_experiments.results import Result, load, run
    from mfpcc_experiments.running.scenario import Scenario as Experiment

__all__ = ["Experiment", "Result", "load", "run"]

_WHERE = {"Experiment": ("running.scenario", "Scenario")}


def __getattr__(name: str) -> Any:
    """Import what is asked for only then: the command line is there at once without it."""
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    module, attribute = _WHERE.get(name, ("results", name))
    return getattr(importlib.import_module(f"{__name__}.{module}"), attribute)
