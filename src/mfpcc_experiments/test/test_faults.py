"""The matrix of faults: survived as a whole, and able to fail."""

from __future__ import annotations

import pytest

from mfpcc_experiments import faults
from pmsm_sim.injection import UNITS


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


def test_without_the_reaction_there_is_damage() -> None:
    cases = [case for case in faults.cases() if case.unit == "encoder"]
    verdicts = faults.judge_all(cases, react=False)
    assert max(verdict.current for verdict in verdicts) > faults.DAMAGE
