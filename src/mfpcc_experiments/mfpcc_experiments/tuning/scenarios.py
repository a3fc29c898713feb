"""The file of a tuning: what an optimiser may move of each scheme, and the drives that judge."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from mfpcc_controller.parameters import TABLE
from mfpcc_experiments.sweeping import space
from mfpcc_experiments.sweeping import spec as specs
from mfpcc_experiments.sweeping.errors import SweepError
from mfpcc_experiments.sweeping.space import Space
from mfpcc_experiments.sweeping.spec import Spec
from pwm_node import yaml_files
from pwm_node.names import unknown
from pwm_node.parameters import ParameterError

#: Seeds of one repeat lie so far from those of the next.
_SEEDS_APART = 1000

Choice = dict[str, Any]


def _check_ranges(ranges: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    for scheme, parameters in ranges.items():
        specs.known_scheme(scheme)
        if not parameters:
            raise ValueError(f"'{scheme}' has nothing to be moved")
        for name, given in parameters.items():
            found = space.parse(name, given)
            if found.kind not in ("uniform", "log_uniform"):
                raise ValueError(f"'{name}' needs a range: uniform or log_uniform")
            if name not in TABLE:
                raise ValueError(unknown("parameter", name, TABLE))
            for value in found.values:
                try:
                    TABLE[name].validate(value)
                except ParameterError as error:
                    raise ValueError(str(error)) from None
    return ranges


class RandomDrives(BaseModel):
    """Draws of a sweep that `survived` judges."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    sweep: str
    runs: int = Field(ge=1)
    seed: int = Field(ge=0)

    @property
    def spec(self) -> Spec:
        """The sweep, of these draws."""
        found = specs.load(yaml_files.find("sweeps", self.sweep))
        return found.model_copy(update={"runs": self.runs, "seed": self.seed})


class Drives(BaseModel):
    """
    A set of drives.

    Attributes
    ----------
    steady : list of Spec
        Their distortion and their prediction error count.
    steps : list of Spec
        The reference of the current steps where the window begins: how long it takes until the
        current stays there, and the errors of current and prediction.
    disturbed : list of Spec
        Something else changes where the window begins: the error of the current.
    mismatched : list of Spec
        The model is wrong: the error of the current.
    random : RandomDrives
        How many do not survive.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    steady: list[Spec] = Field(min_length=1)
    steps: list[Spec] = Field(min_length=1)
    disturbed: list[Spec] = Field(min_length=1)
    mismatched: list[Spec] = Field(min_length=1)
    random: RandomDrives


class Scenarios(BaseModel):
    """
    All that a tuning is made of.

    Attributes
    ----------
    ranges : dict
        By scheme and parameter: `{uniform: [a, b]}` or `{log_uniform: [a, b]}`.
    tuned_on, judged_on : Drives
        What the optimiser sees, and what its choice is judged by.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    description: str = ""
    ranges: Annotated[dict[str, dict[str, Any]], AfterValidator(_check_ranges)]
    tuned_on: Drives
    judged_on: Drives

    def spaces(self, scheme: str) -> dict[str, Space]:
        """
        What of a scheme may be moved.

        Raises
        ------
        SweepError
            If there is nothing.
        """
        if scheme not in self.ranges:
            known = ", ".join(self.ranges)
            raise SweepError(
                f"'{scheme}' has no parameters to be tuned: there are ranges for {known}"
            )
        return {name: space.parse(name, given) for name, given in self.ranges[scheme].items()}


def load(path: Path) -> Scenarios:
    """
    Read the file of a tuning.

    Raises
    ------
    pwm_node.yaml_files.FileError
        With the file, the key, what is wrong and what is expected.
    """
    return yaml_files.load(path, Scenarios)


def of_repeat(spec: Spec, choice: Choice, repeat: int) -> Spec:
    """A sweep with what was chosen, and with the draws and the noise of a repeat."""
    return spec.model_copy(
        update={"set": {**spec.set, **choice}, "seed": spec.seed + _SEEDS_APART * repeat}
    )
