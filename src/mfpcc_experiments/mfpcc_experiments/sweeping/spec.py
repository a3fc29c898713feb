"""
The file of a sweep: one experiment, and what varies.

A grid takes every combination of its values. What is drawn is drawn `runs` times, and each
combination gets the same draws; the noise of draw k has the seed `seed + k`. So schemes, and the
points of a grid, are compared on equal drives.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from mfpcc_controller.parameters import SCHEMES
from mfpcc_experiments.measuring.compiled import KEYS
from mfpcc_experiments.running.batch import FIGURES
from mfpcc_experiments.sweeping import space
from mfpcc_experiments.sweeping.errors import SweepError
from mfpcc_experiments.sweeping.space import Space
from pwm_node import yaml_files
from pwm_node.names import unknown

DRAWS = ("random", "by_number", "latin_hypercube", "sobol")

#: What a limit of `survived` can be put on, beside the figures.
OF_THE_RUN = ("i_peak", "i_peak_over_limit")

#: The largest number of rows that one sweep may have.
MOST_ROWS = 100_000_000


def known_scheme(name: str) -> None:
    """
    Look whether there is such a compiled scheme.

    Raises
    ------
    SweepError
        If there is none.
    """
    if name not in SCHEMES:
        raise SweepError(unknown("scheme", name, SCHEMES))


def _check_schemes(schemes: list[str]) -> list[str]:
    for scheme in schemes:
        known_scheme(scheme)
    return list(dict.fromkeys(schemes))


def _check_metrics(metrics: list[str]) -> list[str]:
    for name in metrics:
        if name not in FIGURES:
            raise ValueError(unknown("metric", name, FIGURES))
    return list(dict.fromkeys(metrics))


def _check_survived(limits: dict[str, float]) -> dict[str, float]:
    known = (*OF_THE_RUN, *FIGURES)
    for name, limit in limits.items():
        if name not in known:
            raise ValueError(unknown("figure", name, known))
        if not (math.isfinite(limit) and limit > 0.0):
            raise ValueError(f"the limit of '{name}' must be above 0, and is {limit:g}")
    return limits


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _check_name(name: str) -> str:
    if not re.fullmatch(r"[\w.+-]{0,100}", name) or name.startswith("."):
        raise ValueError("must be of at most 100 letters, digits, '_', '-', '+' and '.'")
    return name


def _check_vary(vary: dict[str, Any]) -> dict[str, Any]:
    for name, given in vary.items():
        found = space.parse(name, given)
        if not found.sign_of:
            continue
        if found.sign_of not in vary or found.sign_of == name:
            raise ValueError(
                f"'{name}': 'sign_of' names '{found.sign_of}', which is no other one that varies"
            )
        if not all(map(_is_number, space.parse(found.sign_of, vary[found.sign_of]).values)):
            raise ValueError(
                f"'{name}': 'sign_of' names '{found.sign_of}', whose values are no numbers"
            )
        if not all(map(_is_number, found.values)):
            raise ValueError(f"'{name}' has values that are no numbers, so they have no sign")
    return vary


class Spec(BaseModel):
    """
    One sweep.

    Attributes
    ----------
    name, description : str
        The file's name without its ending, unless it says otherwise; and one line for the report.
    experiment : str
        A name of `config/experiments`, or the path of a file.
    set : dict
        What of the experiment is otherwise in all runs: NAME: VALUE, as with `mfpcc run --set`, or
        `schedule[N].NAME`, or `schedule[N].at`.
    schemes : list of str
        Who controls; `--scheme` on the command line counts more.
    vary : dict
        By the name of a parameter of plant or controller, `motor.NAME` for an entry of the motor
        file, `speed_rpm`, `motor`, `seed`, or `schedule[N].NAME`: where its values come from.
    runs : int
        Draws for each combination of the grids.
    draw : str
        How: `random`; `by_number` (the same, but each draw by a generator of its own, so that it
        depends on its number alone); `latin_hypercube`; or `sobol` (`runs` is a power of two).
    seed : int
        Of the draws, and of the noise of the first.
    survived : dict
        Largest sizes of figures that a run may have to count as survived. It never has if a fault
        was latched, the scheme was replaced, or a figure of these is missing.
    metrics : list of str
        The figures to keep; without it all there are.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, AfterValidator(_check_name)] = ""
    description: str = ""
    experiment: str
    set: dict[str, Any] = {}
    schemes: Annotated[list[str], AfterValidator(_check_schemes)] = ["mls_mfpcc"]
    vary: Annotated[dict[str, Any], AfterValidator(_check_vary)] = {}
    runs: int = Field(
        default=1, ge=1, strict=True, description="draws for each combination of the grids"
    )
    draw: str = "random"
    seed: int = Field(default=0, ge=0, le=2**32 - 1, strict=True)
    survived: Annotated[dict[str, float], AfterValidator(_check_survived)] = {
        "i_peak_over_limit": 1.2
    }
    metrics: Annotated[list[str], AfterValidator(_check_metrics)] = Field(default=list(KEYS))

    @model_validator(mode="after")
    def _check_draws(self) -> Spec:
        if self.draw not in DRAWS:
            raise ValueError(unknown("draw", self.draw, DRAWS))
        if self.draw == "sobol" and self.runs & (self.runs - 1):
            below = 1 << (self.runs.bit_length() - 1)
            raise ValueError(
                f"'runs' must be a power of two for 'draw: sobol', such as {below} or "
                f"{2 * below}; it is {self.runs}"
            )
        if not self.schemes:
            raise ValueError("'schemes' names none")
        return self

    @property
    def spaces(self) -> dict[str, Space]:
        """Where the values of each parameter that varies come from."""
        return {name: space.parse(name, given) for name, given in self.vary.items()}


def load(path: Path) -> Spec:
    """
    Read a sweep.

    Raises
    ------
    pwm_node.yaml_files.FileError
        With the file, the key, what is wrong and what is expected.
    """
    found = yaml_files.load(path, Spec)
    return found if found.name else found.model_copy(update={"name": path.stem})
