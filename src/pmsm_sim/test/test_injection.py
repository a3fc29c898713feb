"""Injected faults: refused unless allowed, understood or explained, and gone when they end."""

from __future__ import annotations

import numpy as np
import pytest

from pmsm_sim.parameters import TABLE
from pmsm_sim.parts.injection import UNITS, InjectionError
from pwm_node.parameters import ParameterError


def test_refused_unless_allowed():
    with pytest.raises(ParameterError, match="fault_injection"):
        TABLE.complete({"injections": ["0.1 0.1 encoder off"]})


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("0.1 0.1 encodr off", "did you mean 'encoder'"),
        ("0.1 0.1 encoder of", "did you mean 'off'"),
        ("0.1 0.1 load reordered", "fault of load"),
        ("0.1 encoder off", "expected START DURATION UNIT TYPE"),
        ("x 0.1 encoder off", "must be numbers"),
        ("0.1 nan encoder off", "above 0"),
        ("-1 0.1 encoder off", "from 0"),
        ("0.1 0.1 encoder delayed 1000", "periods"),
        ("0.1 0.1 encoder garbage 1.0 1.5", "a whole one"),
        ("0.1 0.1 encoder garbage 1.0 -1", "from 0"),
    ],
)
def test_what_cannot_be_understood_is_explained(text, reason):
    with pytest.raises(ParameterError, match=reason):
        TABLE.complete({"fault_injection": True, "injections": [text]})


def _run(bench, *injections):
    drive = bench(
        fault_injection=True,
        injections=list(injections),
        initial_speed_rpm=500.0,
        fault_react=False,
    )
    return drive.run(60, (0.52, 0.5, 0.48))


def _columns(drive):
    names = ("i_a", "i_b", "i_c", "encoder_angle", "dc_voltage")
    return np.array([[row[name] for name in names] for row in drive.feedback])


@pytest.mark.parametrize("kind", UNITS["current_a"])
@pytest.mark.parametrize("channel", [0, 3])
def test_a_sensor_fails_alone_and_only_for_its_time(bench, kind, channel):
    unit = ("current_a", "", "", "encoder")[channel]
    healthy, faulty = _columns(_run(bench)), _columns(_run(bench, f"0.002 0.002 {unit} {kind}"))
    differs = np.any(healthy != faulty, axis=0)
    assert differs[channel] and differs.sum() == 1
    rows = np.flatnonzero(healthy[:, channel] != faulty[:, channel])
    assert rows.min() >= 20 and rows.max() < 40


@pytest.mark.parametrize("unit", ["leg_a", "dc_link", "load"])
@pytest.mark.parametrize("kind", ["off", "garbage", "wrong", "intermittent"])
def test_a_true_fault_changes_the_machine(bench, unit, kind):
    healthy, faulty = _run(bench), _run(bench, f"0.002 0.002 {unit} {kind}")
    before = slice(0, 20)
    name = "speed" if unit == "load" else "dc_current"
    if unit == "load":
        faulty = _run(bench, f"0.002 0.002 load {'wrong' if kind == 'off' else kind}")
    assert np.array_equal(healthy.column(name)[before], faulty.column(name)[before])
    assert not np.array_equal(healthy.column(name), faulty.column(name))
    assert np.isfinite(faulty.column("i_dq")).all()


def test_the_same_seed_gives_the_same_faults(bench):
    one, two = (_columns(_run(bench, "0.002 0.002 encoder intermittent")) for _ in range(2))
    assert np.array_equal(one, two)
    own, same = (_columns(_run(bench, "0.002 0.002 encoder intermittent 0 7")) for _ in range(2))
    assert np.array_equal(own, same) and not np.array_equal(own, one)


@pytest.mark.parametrize("kind", UNITS["feedback_link"])
def test_injected_while_it_runs_it_does_the_same(bench, kind):
    values = {"fault_injection": True, "initial_speed_rpm": 500.0}
    given = bench(injections=[f"0.004 0.001 feedback_link {kind}"], **values)
    given.run(60, (0.52, 0.5, 0.48))
    late = bench(**values).run(40, (0.52, 0.5, 0.48))
    late.plant.inject("feedback_link", kind, start=0.001, duration=0.001)
    assert len(late.plant.injections()) == 1
    late.run(20, (0.52, 0.5, 0.48))
    assert np.array_equal(_columns(given), _columns(late), equal_nan=True)
    assert late.plant.injections() == []


def test_what_is_injected_is_told_and_no_more_than_fit(bench):
    drive = bench(fault_injection=True).run(10)
    assert drive.plant.inject("encoder", "wrong", 0.0, 0.05) == "0.001 0.05 encoder wrong 0.5"
    for n in range(7):
        drive.plant.inject("load", "garbage", 0.1, 0.1, 2.0, seed=n)
    assert drive.plant.injections()[-1] == "0.1 0.1 load garbage 2 6"
    with pytest.raises(InjectionError, match="8 faults"):
        drive.plant.inject("encoder", "wrong", 0.0, 0.05)
    drive.run(500)
    drive.plant.inject("encoder", "wrong", 0.0, 0.05)
    assert len(drive.plant.injections()) == 8


def test_refused_while_it_runs(bench):
    with pytest.raises(InjectionError, match="fault_injection"):
        bench().plant.inject("encoder", "wrong", 0.0, 0.05)
    plant = bench(fault_injection=True, dc_link_kind="rectifier").plant
    with pytest.raises(InjectionError, match="stiff"):
        plant.inject("dc_link", "off", 0.0, 0.05)
    with pytest.raises(InjectionError, match="did you mean 'stuck'"):
        plant.inject("encoder", "stack", 0.0, 0.05)
    assert plant.injections() == []
