"""The paper's figures and numbers: what is run, how it is judged, and that nothing is left out."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from mfpcc_experiments import cli
from mfpcc_experiments.paper import reproduce
from mfpcc_experiments.paper.reproduce import CONFIRMED, DIFFERS, NOT_CONFIRMED, Statement
from mfpcc_experiments.running import run, scenario
from pwm_node import yaml_files


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> reproduce.Results:
    """All runs of the paper, with a coarser waveform than usual: it is written and read faster."""
    folder = tmp_path_factory.mktemp("paper")
    runs = []
    for experiment, scheme in reproduce.plan(reproduce.FIGURES):
        usual = scenario.load(experiment)
        coarse = usual.model_copy(update={"plant": {**usual.plant, "oversampling": 4}})
        run.run(coarse, scheme, "inprocess", folder / experiment, 0, lambda done: None)
        runs.append(reproduce.measure(experiment, scheme, folder / experiment / scheme))
    times = reproduce.step_times(folder / "steady_750_2" / "mls_mfpcc")
    return reproduce.Results(runs, times)


@pytest.fixture(scope="module")
def said(results: reproduce.Results) -> list[Statement]:
    return reproduce.statements(results, reproduce.FIGURES)


def test_the_plan_holds_every_run_of_the_paper_once() -> None:
    runs = reproduce.plan(reproduce.FIGURES)
    assert len(runs) == len(set(runs)) == 27
    assert {experiment for experiment, _ in runs} == set(yaml_files.available("experiments")) & {
        *reproduce.STEADY,
        *reproduce.STEPS,
        *reproduce.MISMATCHES,
    }
    assert reproduce.plan(["9"]) == [
        (experiment, scheme)
        for experiment in ("load_step", "speed_step")
        for scheme in ("mfpcc", "mls_mfpcc")
    ]


def test_steps_are_where_the_figures_expect_them() -> None:
    for experiment in (*reproduce.STEPS, *reproduce.MISMATCHES):
        assert scenario.load(experiment).schedule[0]["at"] == reproduce.STEP
    for experiment, (begin, end) in reproduce.SHOWN.items():
        assert 0.0 <= begin < end <= scenario.load(experiment).duration


def test_verdicts() -> None:
    assert [reproduce._near(ours, 0.4) for ours in (0.31, 0.49, 0.29, 0.51)] == [
        CONFIRMED,
        CONFIRMED,
        DIFFERS,
        DIFFERS,
    ]
    assert [reproduce._within(ours, 0.4) for ours in (0.1, 0.4, 0.45, 0.51)] == [
        CONFIRMED,
        CONFIRMED,
        DIFFERS,
        NOT_CONFIRMED,
    ]
    assert reproduce._within(float("nan"), 0.4) == NOT_CONFIRMED


def test_every_figure_and_every_published_number_is_judged(said: list[Statement]) -> None:
    assert list(dict.fromkeys(s.figure for s in said)) == ["6", "7", "8", "9", "10", "times"]
    text = " ".join(s.published for s in said)
    for number in ("16.01", "6.92", "1.8 A", "1.5 A", "0.2 A", "0.3 A", "0.30", "0.50", "1.00"):
        assert number in text
    for number in ("0.32", "46", "50", "65"):
        assert number in text
    assert {s.verdict for s in said} <= {CONFIRMED, DIFFERS, NOT_CONFIRMED}
    assert all(s.says.endswith(".") and s.ours and "nan" not in s.ours for s in said)


def test_what_the_paper_says_of_mls_mfpcc_holds(said: list[Statement]) -> None:
    """The promise of the project; what is said of its rivals may come out otherwise."""
    for s in said:
        if (
            s.figure in ("6", "7")
            and "of MLS-MFPCC" in s.says
            and "i_q of MLS-MFPCC at" not in s.says
        ):
            assert s.verdict == CONFIRMED, s
        if s.figure == "10" and "MLS-MFPCC" in s.says and "Mismatch a" not in s.says:
            assert s.verdict == CONFIRMED, s
        if s.published in ("within 0.30 A", "within 0.32 A", "always"):
            assert s.verdict == CONFIRMED, s


def test_the_fitted_baseline_says_so(said: list[Statement]) -> None:
    fitted = [s for s in said if re.fullmatch(r"The THD of MFPCC .*", s.says)]
    assert len(fitted) == 2
    for s in fitted:
        assert "By construction" in s.remark
        assert s.verdict == CONFIRMED


def test_a_run_that_tripped_is_not_judged(results: reproduce.Results) -> None:
    note = {"severity": "failure", "text": "gates off from 0.300 s: OVERSPEED, 200 rad/s"}
    spoiled = []
    for each in results.runs:
        if (each.experiment, each.scheme) == ("steady_750_5", "mls_mfpcc"):
            row = {**each.row, "notes": [note], "thd_percent": {"oversampled": None}}
            each = replace(each, row=row)
        spoiled.append(each)
    said = reproduce.statements(reproduce.Results(spoiled, {}), ["6", "9"])
    of_6 = [s for s in said if s.figure == "6"]
    assert [(s.verdict, s.ours) for s in of_6] == [(reproduce.NOT_JUDGED, note["text"])]
    assert {s.verdict for s in said if s.figure == "9"} <= {CONFIRMED, DIFFERS, NOT_CONFIRMED}


def test_computing_times(results: reproduce.Results) -> None:
    assert set(results.times) == {"mfpcc", "mls_mfpcc", "neso_mfpcc", "mbpcc"}
    assert all(0.0 < time < 50.0 for time in results.times.values())


def test_one_figure_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    line = ["reproduce", "--figure", "9", "--out", str(out)]
    assert cli.run(line) == 0
    printed = capsys.readouterr().out
    assert "confirmed" in printed
    assert "by construction" in printed
    report = (out / "report.html").read_text()
    assert "http" not in re.sub(r"http-equiv", "", report)
    assert report.count("by construction") >= 2  # above, and below each figure
    assert (out / "figures/figure_9.png").read_bytes()[1:4] == b"PNG"
    assert {path.stem for path in (out / "figures").iterdir()} == {"figure_9"}
    told = json.loads((out / "statements.json").read_text())
    assert "fitted" in told["note"]
    assert {s["figure"] for s in told["statements"]} == {"9"}
    rows = json.loads((out / "metrics.json").read_text())
    assert [(row["experiment"], row["scheme"]) for row in rows] == reproduce.plan(["9"])
    assert all(row["lost_periods"] == 0 for row in rows)
    assert (out / "speed_step/mls_mfpcc/metadata.yaml").is_file()
    assert cli.run(line) == 1
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [("--figure 5", "There are: 10, 6, 7, 8, 9"), ("--engine inproces", "did you mean")],
)
def test_a_command_line_that_makes_no_sense(
    options: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(["reproduce", "--out", str(tmp_path / "o"), *options.split()]) == 2
    assert said in capsys.readouterr().err
