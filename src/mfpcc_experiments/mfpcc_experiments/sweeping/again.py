"""A row of a sweep as an experiment, to be run again with a full recording."""

from __future__ import annotations

from pathlib import Path

import yaml

import pmsm_sim.motor
from mfpcc_experiments.files import write_whole
from mfpcc_experiments.running import Scenario, scenario
from mfpcc_experiments.sweeping import folder as folders


def experiment(path: Path, row: int) -> tuple[Scenario, str, int]:
    """
    The run of a row.

    Where entries of the motor file vary, the row's motor is written beside the rows.

    Parameters
    ----------
    path : Path
        Folder of the sweep.
    row : int
        Number of the row.

    Returns
    -------
    experiment : Scenario
    scheme : str
        Who controls.
    seed : int
        Of all noise.

    Raises
    ------
    SweepError
        If there is no such sweep, or no such row.
    """
    plan = folders.load(path).plan
    scheme, values = plan.row(row)
    entries = {name[6:]: v for name, v in values.items() if name.startswith("motor.")}
    rest = {n: v for n, v in values.items() if n != "seed" and not n.startswith("motor.")}
    if entries:
        name = str(values.get("motor", plan.base.motor))
        motor = pmsm_sim.motor.load(name).model_dump() | entries
        motor["name"] = f"{motor['name']}_row_{row}"
        file = path / "motors" / f"row_{row}.yaml"
        file.parent.mkdir(exist_ok=True)
        write_whole(file, yaml.safe_dump(motor, sort_keys=False))
        rest["motor"] = str(file.resolve())
    wanted = scenario.varied(plan.base, rest)
    return (
        wanted.model_copy(update={"name": f"{plan.spec.name}_row_{row}"}),
        scheme,
        int(values["seed"]),
    )
