"""Any values as parameters of either node: accepted together, or refused with a reason."""

from __future__ import annotations

import array
import math
from typing import Any

import fuzz
import numpy as np
import pytest

from mfpcc_controller.parameters import TABLE as CONTROLLER
from pmsm_sim.parameters import TABLE as PLANT
from pwm_node import schedule
from pwm_node.parameters import ParameterError, Table
from pwm_node.schedule import ScheduleError


def any_value(rng: np.random.Generator, table: Table, name: str) -> Any:
    """A value of any type for a parameter; often one of its own type, and often a good one."""
    parameter = table[name]
    if rng.random() < 0.4:
        return table.validate(fuzz.legal_values(table, rng, 0.05)).get(name, parameter.default)
    kind = rng.integers(10)
    if kind == 0:
        return fuzz.any_float(rng)
    if kind == 1:
        return (-1) ** int(rng.integers(2)) * fuzz.any_integer(rng) ** int(rng.integers(1, 30))
    if kind == 2:
        return bool(rng.integers(2))
    if kind == 3:
        return "".join(map(chr, rng.integers(0, 0x800, int(rng.integers(0, 40)))))
    if kind == 4:
        return array.array("d", [fuzz.any_float(rng) for _ in range(rng.integers(0, 5))])
    if kind == 5:
        return [fuzz.any_float(rng) for _ in range(rng.integers(0, 200))]
    if kind == 6:
        return ["x" * int(rng.integers(0, 9)) for _ in range(rng.integers(0, 5))]
    if kind == 7:
        return (None, [], {}, b"\x00", object, [None], [[1.0]], 1j)[rng.integers(8)]
    if kind == 8:
        return [math.nan, True, "1"][: rng.integers(0, 4)]
    return parameter.choices[0] + " " if parameter.choices else parameter.default


@pytest.mark.parametrize("table", [CONTROLLER, PLANT], ids=["controller", "plant"])
def test_any_values_are_accepted_together_or_refused_with_a_reason(table: Table) -> None:
    known = list(table)
    accepted = 0
    current = table.defaults()
    for rng in fuzz.cases(1500):
        names = rng.choice(known, int(rng.integers(1, 4)), replace=False).tolist()
        changes = {name: any_value(rng, table, name) for name in names}
        if rng.random() < 0.1:
            changes["n" + names[0]] = 1.0
        before = dict(current)
        running = rng.random() < 0.7
        taken, refusal = fuzz.outcome(
            ParameterError, table.validate, changes, current if running else None
        )
        assert current == before and len(refusal) < 5_000
        if refusal:
            continue
        accepted += 1
        assert set(taken) == set(changes)
        for name, value in taken.items():
            parameter = table[name]
            assert not (running and parameter.read_only)
            assert parameter.validate(value) == value
            numbers = value if isinstance(value, list) else [value]
            for number in numbers:
                if isinstance(number, float):
                    assert math.isfinite(number)
                    assert parameter.minimum is None or number >= parameter.minimum
                    assert parameter.maximum is None or number <= parameter.maximum
        if running:
            current.update(taken)
            assert table.validate({}, current) == {}, "the values contradict each other"
    assert accepted


@pytest.mark.parametrize("table", [CONTROLLER, PLANT], ids=["controller", "plant"])
def test_any_schedule_is_understood_or_refused(table: Table) -> None:
    words = [*table, "0.1", "-1", "nan", "1e400", "5e-324", "true", "[1, 2]", "{", "*x", "'", "\0"]
    words += ["mbpcc", "1e999", "!!python/object:x", "0x10", "2024-99-99", "1_0", "&a [*a]", "é"]
    for rng in fuzz.cases(700):
        entry = " ".join(rng.choice(words, int(rng.integers(0, 5))))
        if rng.random() < 0.6:
            name = str(rng.choice(list(table)))
            value = fuzz.legal_values(table, rng, 0.1).get(name, entry)
            entry = f"{rng.uniform(0, 1)} {name} {value}"
        due, refusal = fuzz.outcome(ScheduleError, schedule.parse, [entry], table, 1e-4)
        if refusal:
            assert entry in refusal
            continue
        ((period, changes),) = due
        assert period >= 0 and changes
