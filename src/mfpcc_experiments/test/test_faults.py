"""The matrix of faults: survived as a whole, and able to fail."""

from __future__ import annotations

import numpy as np
import pytest

from mfpcc_experiments.proofs import faults
from mfpcc_experiments.running import closed_loop
from pmsm_sim.parts.injection import UNITS


def test_there_are_cases_of_every_unit_and_type() -> None:
    cases = faults.cases()
    assert len(cases) >= 200
    assert {(case.unit, case.kind) for case in cases} == {
        (unit, kind) for unit, kinds in UNITS.items() for kind in kinds
    }


@pytest.mark.parametrize("point", faults.POINTS, ids=str)
def test_every_fault_is_survived(point: faults.Point) -> None:
    verdicts = faults.judge_all(faults.cases([point]))
    failed = [(v.case.injection, v.codes, v.failures) for v in verdicts if not v.survived]
    assert failed == []


def test_a_hot_motor_gets_less_current_and_trips_only_where_that_is_not_enough() -> None:
    """A fan at 1200 r/min, whose losses would bring the winding to far more than 125 degC."""

    def run(**plant: float) -> closed_loop.Run:
        return closed_loop.run(
            "mls_mfpcc",
            0.3,
            rpm=1200.0,
            load=0.0,
            plant={
                "load.quadratic": 3.8e-4,  # 6 N m
                "drift.temperature": 60.0,
                "drift.thermal_resistance": 0.6,
                "drift.time_constant": 0.05,
                **plant,
            },
        )

    derated = run()
    assert derated.state["gates_on"].all() and derated.controller.faults() == []
    i_d, i_q = derated.state["i_dq"].T
    last = derated.rows(0.25)
    assert np.hypot(i_d, i_q).max() > 7.0
    assert np.hypot(i_d, i_q)[last].max() < 6.0
    assert 110.0 < derated.state["temperature"][last].max() < 120.0

    tripped = run(**{"fault.derating_temperature": 125.0})
    assert not tripped.state["gates_on"][-1]
    assert [code for code, _, _ in tripped.controller.faults()] == ["INVERTER"]


def test_without_the_reaction_there_is_damage() -> None:
    cases = [case for case in faults.cases() if case.unit == "encoder"]
    verdicts = faults.judge_all(cases, react=False)
    assert max(verdict.current for verdict in verdicts) > faults.DAMAGE
