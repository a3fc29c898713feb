"""What a recording tells of its drive: simulated drives, whose truth is known."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mfpcc_controller.motor
import pmsm_sim.motor
from mfpcc_experiments import cli
from mfpcc_experiments.identifying import identified
from mfpcc_experiments.identifying.connection import connection
from mfpcc_experiments.identifying.identified import IdentifyError, of_steps
from mfpcc_experiments.identifying.linear import one_step
from mfpcc_experiments.identifying.steps import Steps, steps_of
from mfpcc_experiments.measuring.waveform import space_vector
from mfpcc_experiments.notes import NOT_AS_ASKED
from mfpcc_experiments.proofs.identification import LIMITS, MOTORS, judge, recorded
from mfpcc_experiments.running import run
from mfpcc_experiments.running.scenario import Scenario


@pytest.mark.parametrize("motor", MOTORS)
def test_six_motors(motor: str) -> None:
    """One seed of each; `python -m mfpcc_experiments.proofs.identification` takes a hundred."""
    scores, exact = judge(motor, [7])
    assert exact == 1
    for key, score in scores.items():
        assert score.inside == 1 and score.worst < LIMITS[key], (key, score)


@pytest.fixture(scope="module")
def drive() -> Steps:
    return recorded("ipmsm", 3)[0]


def phases(i_s_ab: np.ndarray) -> np.ndarray:
    return np.stack([(i_s_ab * np.exp(-2j * np.pi / 3 * n)).real for n in range(3)], axis=1)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_signs_and_phases(drive: Steps, order: tuple[int, ...], sign: int) -> None:
    wrong = replace(drive, i_s_ab=space_vector(sign * phases(drive.i_s_ab)[:, list(order)]))
    found = connection(wrong)
    assert found is not None
    assert found.sign == sign and not found.backwards
    # the leg's current stands in the column in which its phase was put
    assert found.order == "".join("abc"[order.index(leg)] for leg in range(3))
    if found.wrong:
        with pytest.raises(IdentifyError, match="correct the map"):
            of_steps(wrong, 3, [])


def test_an_angle_that_runs_backwards(drive: Steps) -> None:
    with pytest.raises(IdentifyError, match="runs against the order of the phases"):
        of_steps(replace(drive, theta_m=-drive.theta_m, w_m=-drive.w_m), 3, [])


def said(found: identified.Identified) -> str:
    return "; ".join(str(note) for note in found.notes)


@pytest.mark.parametrize("degrees", [-100.0, 5.0, 178.0])
def test_a_wrong_zero_of_the_encoder(drive: Steps, degrees: float) -> None:
    turned = replace(drive, theta_m=drive.theta_m - math.radians(degrees))
    found = of_steps(turned, 3, [])
    told = re.search(r"the d axis lies ([-+.0-9]+) degrees", said(found))
    assert told is not None and float(told[1]) == pytest.approx(degrees, abs=0.3)
    assert found.delay == 0
    motor = pmsm_sim.motor.load("ipmsm")
    assert found.value("psi_f").value == pytest.approx(motor.psi_f, rel=0.01)
    assert found.value("L_q").value == pytest.approx(motor.L_q, rel=0.03)


def test_where_all_is_right_nothing_is_said(drive: Steps) -> None:
    assert [note for note in of_steps(drive, 3, []).notes if note.severity != "info"] == []


@pytest.mark.parametrize("more", [-1, 1])
def test_a_wrong_delay(drive: Steps, more: int) -> None:
    found = of_steps(drive.later(-more), 3, [])
    assert found.delay == more
    word = "later" if more > 0 else "earlier"
    assert f"commands act {more} period" in said(found) and word in said(found)
    assert found.value("L_d").value == pytest.approx(pmsm_sim.motor.load("ipmsm").L_d, rel=0.03)


def test_dead_time_and_bandwidth() -> None:
    steps, motor = recorded("seed_750", 1, **{"inverter.dead_time": 2e-6})
    found = of_steps(steps, motor.n_p, [])
    dead = found.value("dead_time_voltage")
    assert dead.low > 0.0
    assert dead.value == pytest.approx(311.0 * 2e-6 / 1e-4, rel=0.1)
    assert found.value("R_s").value == pytest.approx(motor.R_s, rel=0.05)
    steps, motor = recorded("seed_750", 1, **{"sensor.current_bandwidth": 2000.0})
    found = of_steps(steps, motor.n_p, [])
    lag = found.value("sensor_lag")
    assert lag.told
    assert 0.5 / math.pi / lag.value == pytest.approx(2000.0, rel=0.1)
    assert found.delay == 0
    assert found.value("L_q").value == pytest.approx(motor.L_q, rel=0.03)


def standstill(n: int = 400) -> Steps:
    k = np.arange(n)
    u = (3.0 * np.sin(0.2 * k) + np.sign(np.sin(0.03 * k))).astype(complex)
    i = np.zeros(n, complex)
    decay = math.exp(-0.3 / 2e-4 * 5e-5)
    for m in range(n - 1):
        i[m + 1] = u[m] / 0.3 * (1.0 - decay) + i[m] * decay
    noise = np.random.default_rng(1).normal(0.0, 0.02, (n, 2))
    return steps_of(i + noise[:, 0] + 1j * noise[:, 1], np.zeros(n), u, k, 5e-5)


def test_what_a_standstill_tells_and_what_not() -> None:
    found = of_steps(standstill(), 1, [])
    assert found.value("R_s").value == pytest.approx(0.3, rel=0.05)
    assert found.value("L_d").value == pytest.approx(2e-4, rel=0.03)
    assert not found.value("L_q").told and not found.value("psi_f").told
    assert "psi_f is not told: it takes a rotor that turns" in said(found)
    known = {"n_p": 2, "J": 1e-5, "u_dc": 24.0}
    with pytest.raises(IdentifyError, match="psi_f"):
        identified.motor_text(found, known, "x", "y")
    text = identified.motor_text(found, {**known, "psi_f": 0.01}, "x", "y")
    assert "not identified, taken to be L_d" in text


def test_least_squares_leave_the_noise(drive: Steps) -> None:
    """One step ahead of noise that is white leaves it twice, but for what is known of the first."""
    step = one_step(drive)
    assert step is not None
    per_axis = np.sqrt(np.mean(np.abs(step.error) ** 2) / 2.0)
    assert 0.020 < per_axis < 0.020 * math.sqrt(2.0) * 1.05
    assert np.mean(np.abs(step.unchanged) ** 2) > 4 * np.mean(np.abs(step.error) ** 2)


SHORT: Callable[..., Scenario] = lambda **changes: Scenario.model_validate(  # noqa: E731
    {
        "name": "short",
        "motor": "seed_750",
        "speed_rpm": 300.0,
        "duration": 0.06,
        "window_s": [0.0, 0.06],
        "plant": {"noise.current_rms": 0.0245, "load_torque": 3.0},
        "schedule": [{"at": 0.02, "i_d_ref": 2.0}, {"at": 0.04, "i_d_ref": -2.0}],
        **changes,
    }
)


def test_the_command_writes_a_motor_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run.run(SHORT(), "mls_mfpcc", "inprocess", tmp_path, 3, lambda done: None)
    bag, file = str(tmp_path / "mls_mfpcc"), tmp_path / "found.yaml"
    assert cli.run(["identify", bag, "-o", str(file)]) == 0
    out = capsys.readouterr().out
    assert "explained by a linear model" in out and f"written: {file}" in out
    motor, truth = pmsm_sim.motor.load(str(file)), pmsm_sim.motor.load("seed_750")
    assert mfpcc_controller.motor.load(str(file)).n_p == truth.n_p
    for key, limit in LIMITS.items():
        assert getattr(motor, key) == pytest.approx(getattr(truth, key), rel=limit)
    assert cli.run(["identify", bag, "-o", str(file)]) == 1
    assert "--force" in capsys.readouterr().err


def test_the_command_says_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from scipy.io import savemat

    steps = standstill()
    columns: dict[str, Any] = {"u": steps.u_s_ab.real, "i_a": -steps.i_s_ab.real}
    columns["i_b"] = -columns["i_a"] / 2
    savemat(tmp_path / "a.mat", columns)
    chart = tmp_path / "map.yaml"
    text = (
        "sample_time: 5e-5\ncurrents: {a: {column: i_a, scale: SCALE}, b: {column: i_b, scale: "
        "SCALE}}\ndc_voltage: {constant: 24}\nvoltages: {alpha: u, beta: {constant: 0}}\n"
        "delay: DELAY\n"
    )
    for scale, delay, code, sentence in (
        ("1", "0", 1, "turn their sign"),
        ("-1", "1", NOT_AS_ASKED, "commands act -1 period"),
        ("-1", "0", 0, "along one axis only"),
    ):
        chart.write_text(text.replace("SCALE", scale).replace("DELAY", delay))
        arguments = ["--map", str(chart), "--out", str(tmp_path / "bag"), "--force"]
        assert cli.run(["import", str(tmp_path / "a.mat"), *arguments]) == 0
        capsys.readouterr()
        assert cli.run(["identify", str(tmp_path / "bag")]) == code
        shown = capsys.readouterr()
        assert sentence in shown.out + shown.err


def test_too_short() -> None:
    with pytest.raises(IdentifyError, match="too few periods"):
        of_steps(standstill(30), 1, [])


# --- Predictions beside what the data allow -------------------------------------------------------


def test_replay_stands_beside_least_squares(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A true model leaves as much as least squares, a wrong one more, and neither is our word."""
    run.run(SHORT(), "mls_mfpcc", "inprocess", tmp_path, 3, lambda done: None)
    bag, out = tmp_path / "mls_mfpcc", tmp_path / "out"
    ratios = {}
    for mismatch in (1.0, 3.0):
        arguments = ["--scheme", "mbpcc", "--set", f"mismatch.inductance={mismatch}"]
        arguments += ["--window", "0.01", "0.06", "--out", str(out), "--force"]
        assert cli.run(["replay", str(bag), *arguments]) == 0
        (row,) = json.loads((out / "metrics.json").read_text())
        ratios[mismatch] = row["over_least_squares"]
        axes = row["lut_error_rms"]
        assert row["prediction_error_rms"] == pytest.approx(
            math.hypot(axes["d"], axes["q"]), rel=0.01
        )
        # Of noise that is white, nothing changes leaves at least sqrt(2) of it, on both axes.
        assert row["nothing_changes_rms"] > 0.02 * math.sqrt(2.0) * math.sqrt(2.0)
        assert sum(part["samples"] for part in row["by_speed"]) <= row["samples"]
    assert 0.95 < ratios[1.0] < 1.35 < ratios[3.0]
    shown = capsys.readouterr().out
    assert "least squares" in shown and "nothing changes" in shown
    page = (out / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 2 and "least squares" in page


def test_the_bound_is_that_of_least_squares_by_hand() -> None:
    """At standstill, on one axis: the residual of numpy's own fit of (i, u, 1)."""
    steps = standstill()
    i, u = steps.i_s_ab, steps.u_s_ab
    found = one_step(steps)
    assert found is not None
    columns = np.stack([i[:-1].real, i[:-1].imag, u[:-1].real, np.ones(len(i) - 1)], axis=1)
    for part, error in ((np.real, found.error.real), (np.imag, found.error.imag)):
        change = np.diff(part(i))
        fitted, *_ = np.linalg.lstsq(columns, change, rcond=None)
        np.testing.assert_allclose(error, change - columns @ fitted, atol=1e-9)
    np.testing.assert_allclose(found.unchanged, np.diff(i))
