"""The matrix of faults: survived as a whole, and able to fail."""

from __future__ import annotations

import inspect
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mfpcc_controller.protection
import pmsm_sim.parts.inverter
import pmsm_sim.parts.protection
from mfpcc_experiments import cli
from mfpcc_experiments.proofs import fault_cases, faults, needed
from mfpcc_experiments.running import closed_loop
from pmsm_sim.parts.injection import UNITS


def test_there_are_cases_of_every_unit_and_type() -> None:
    cases = fault_cases.cases()
    assert len(cases) >= 200
    assert {(case.unit, case.kind) for case in cases} == {
        (unit, kind) for unit, kinds in UNITS.items() for kind in kinds
    }


@pytest.mark.parametrize("point", fault_cases.POINTS, ids=str)
def test_every_fault_is_survived(point: fault_cases.Point) -> None:
    verdicts = faults.judge_all(fault_cases.cases([point]))
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
    cases = [case for case in fault_cases.cases() if case.unit == "encoder"]
    verdicts = faults.judge_all(cases, react=False)
    assert max(verdict.current for verdict in verdicts) > faults.DAMAGE


def test_every_fault_of_both_nodes_is_a_check_that_can_be_removed() -> None:
    """`mfpcc faults --needed` shows that each of them is needed; it takes a minute or more."""
    checks: list[needed.Check] = []
    for module in (
        mfpcc_controller.protection,
        pmsm_sim.parts.protection,
        pmsm_sim.parts.inverter,
    ):
        needed.removable(module.__name__, inspect.getsource(module), checks)
    codes = {(check.node, check.what.split(" ")[0]) for check in checks}
    own = {("inverter", code) for code in pmsm_sim.parts.protection.FAULTS.codes}
    own |= {("controller", code) for code in mfpcc_controller.protection.FAULTS.codes}
    # how long a step took, the node measures
    assert own - codes == {("controller", "SCHEME")}
    bounds = [check for check in checks if check.what.startswith("sample: ")]
    assert len(bounds) == 9
    assert len({check.number for check in checks}) == len(checks) == 30


@pytest.mark.parametrize("code", ["OVERCURRENT", "CURRENT_SUM", "STALL"])
def test_the_matrix_does_not_pass_without_a_limit(code: str) -> None:
    """The limit out of reach is as good as the check removed."""
    far = {"OVERCURRENT": "fault.overcurrent", "CURRENT_SUM": "fault.current_sum"}
    cases = [case for case in fault_cases.cases() if any(code in name for name in case.finds)]
    assert cases and all(verdict.survived for verdict in faults.judge_all(cases))
    name, value = (far[code], 100.0) if code in far else ("fault.stall_time", 100.0)
    of_controller = [case for case in cases if not any("inverter" in n for n in case.finds)]
    blind = [replace(case, controller=((name, value),)) for case in of_controller]
    assert not any(verdict.survived for verdict in faults.judge_all(blind))


@pytest.mark.parametrize(
    ("told", "code", "said"),
    [
        ("", 1, "ended with exit code 1"),
        ('{"done": 1, "of": 2}', 137, "ended with exit code 137"),
        ('{"node": "inverter", "check": "OVERCURRENT", "cases": ["a"]}', 3, "exit code 3"),
        ('{"error": "no such motor"}', 1, "no such motor"),
    ],
)
def test_a_table_of_checks_that_was_cut_is_an_error(
    told: str,
    code: int,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """As where its process is killed: what it had told until then is not shown for the whole."""
    program = tmp_path / "python"
    lines = ["#!/bin/sh", *([f"echo '{told}'"] if told else []), f"exit {code}", ""]
    program.write_text("\n".join(lines))
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    assert cli.run(["faults", "--needed"]) == 1
    shown = capsys.readouterr()
    (line,) = [line for line in shown.err.splitlines() if "mfpcc: " in line]
    assert said in line and "checks, " not in shown.out
