"""Tuning: the optimiser goes on where it was, figures are what they are called, ties are ties."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import stats

from mfpcc_experiments.measuring.compiled import I_D, I_D_REF, I_Q, I_Q_REF, SIGNALS
from mfpcc_experiments.sweeping.errors import SweepError
from mfpcc_experiments.tuning import criteria, page, ranks, scenarios, tune
from mfpcc_experiments.tuning.folder import Folder
from mfpcc_experiments.tuning.study import Study
from mfpcc_experiments.verbs.tune import command
from pwm_node import yaml_files
from pwm_node.errors import ForPeople

pytest.importorskip("optuna")

SHORT = {"duration": 0.02, "window_s": [0.01, 0.02], "oversampling": 0}
DRIVES = {
    "steady": [{"experiment": "steady_750_2", "set": {**SHORT, "oversampling": 4}}],
    "steps": [{"experiment": "current_step", "set": {**SHORT, "schedule[0].at": 0.01}}],
    "disturbed": [{"experiment": "load_step", "set": {**SHORT, "schedule[0].at": 0.01}}],
    "mismatched": [{"experiment": "steady_750_2", "set": {**SHORT, "mismatch.flux": 0.5}}],
    "random": {"sweep": "random_drives", "runs": 2, "seed": 0},
}
SMALL = {
    "ranges": {
        "pi_foc": {"pi.bandwidth": {"log_uniform": [200.0, 2000.0]}},
        "mbpcc_single_vector": {"deadbeat.gain": {"uniform": [0.5, 1.0]}},
    },
    "tuned_on": DRIVES,
    "judged_on": DRIVES,
}


class Here:
    """A pool of this process, which may be broken off."""

    def __init__(self, breaks_after=math.inf):
        self.left = breaks_after

    def run(self, jobs):
        for job in jobs:
            if self.left <= 0:
                raise KeyboardInterrupt
            self.left -= 1
            yield job.number, job.run()


def content(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def invented(drives, scheme, choice, repeat):
    """Figures that depend on all there is, in no time."""
    text = json.dumps([scheme, choice, repeat, drives.random.seed])
    draw = np.random.default_rng(list(text.encode()))
    every = (*criteria.CRITERIA, *criteria.RIPPLE_BLIND)
    found = {c.name: float(draw.uniform(1.0, 2.0)) for c in every}
    pwm = choice.get("pwm_frequency", 10e3)
    legs = pwm if scheme == "pi_foc" else 0.8 * pwm
    return {**found, "switching_frequency": legs, "pwm_frequency": pwm}


def test_a_tuning_that_was_broken_off_goes_on_to_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(criteria, "figures", invented)
    monkeypatch.setattr(criteria.Judgement, "_pwm_frequency", lambda self: 12.5e3)
    judged_on = {**DRIVES, "random": {**DRIVES["random"], "seed": 7}}
    tuning = tune.Tuning(
        scenarios.Scenarios.model_validate({**SMALL, "judged_on": judged_on}),
        ("pi_foc", "mbpcc_single_vector"),
        12,
        2,
    )
    seen = SimpleNamespace(done=0)
    progress = SimpleNamespace(add=lambda n: setattr(seen, "done", seen.done + n))
    whole = Folder(tmp_path / "whole", {}, resume=False)
    rows = tune.run(tuning, whole, Here(), progress)
    assert seen.done == tuning.steps == 2 * 2 * (12 + 4)

    for breaks_after in (5, 15, 23, 7):
        folder = Folder(tmp_path / "broken", {}, resume=True)
        with pytest.raises(KeyboardInterrupt):
            tune.run(tuning, folder, Here(breaks_after), progress)
    assert len(content(folder.path)) > 2  # not all was in vain
    seen.done = 0
    assert tune.run(tuning, folder, Here(), progress) == rows
    assert seen.done == tuning.steps
    assert content(folder.path) == content(whole.path)

    for scheme in tuning.schemes:
        ((_, space),) = tuning.scenarios.spaces(scheme).items()
        for repeat in range(2):
            trials = whole.trials(scheme, repeat)
            assert len(trials) == 12 and trials[0].choice == {}
            low, high = space.values
            assert all(low <= x <= high for t in trials[1:] for x in t.choice.values())
            best = min(trials, key=lambda t: criteria.score(t.figures))
            found = {
                (r.which, r.equal): r for r in rows if (r.scheme, r.repeat) == (scheme, repeat)
            }
            assert found["tuned", False].choice == best.choice
            assert found["default", False].choice == {}
            for (_, equal), row in found.items():
                pwm = 12.5e3 if equal and scheme != "pi_foc" else 10e3
                chosen = row.choice if pwm == 10e3 else {**row.choice, "pwm_frequency": pwm}
                assert row.figures == invented(tuning.scenarios.judged_on, scheme, chosen, repeat)

    text = page.render(tuning, rows, "mfpcc tune", "Made.")
    assert text.count("`pi_foc`") >= 6 and "does not win" not in text
    told = [line for line in text.splitlines() if not line.startswith("|")]
    assert max(map(len, told)) <= 100


def test_the_legs_of_a_single_vector_switch_as_often_as_they_shall():
    drives = scenarios.Scenarios.model_validate(SMALL).judged_on
    found = criteria.Judgement(0, drives, "mbpcc_single_vector", {}, 0, 10e3).run()
    assert found["switching_frequency"] == pytest.approx(10e3, rel=0.05)
    assert found["pwm_frequency"] > 10.5e3


def test_what_the_optimiser_is_told_decides_what_it_asks():
    spaces = scenarios.Scenarios.model_validate(SMALL).spaces("pi_foc")

    def figures(choice, best):
        x = abs(math.log(choice.get("pi.bandwidth", 2000.0) / best)) + 0.1
        return dict.fromkeys((c.name for c in criteria.CRITERIA), x)

    found = {}
    for best in (300.0, 1500.0):
        study = Study("pi_foc", 0, 60, spaces)
        while study.left:
            study.tell([figures(choice, best) for choice in study.generation()])
        found[best] = study.best.choice["pi.bandwidth"]
        assert found[best] == pytest.approx(best, rel=0.05)
        # another history is not taken for this one
        study.trials[3].choice["pi.bandwidth"] *= 1.1
        with pytest.raises(SweepError, match="other choices now"):
            Study("pi_foc", 0, 60, spaces, study.trials)


def test_settling_by_hand():
    n, i_max, T_s = 300, 12.0, 1e-4
    signals = np.zeros((len(SIGNALS), n))
    signals[I_Q_REF] = 5.0
    signals[I_Q] = 5.0 - 4.0 * 0.5 ** np.arange(n)  # 4.0, 2.0, 1.0, 0.5, 0.25, 0.125 A away
    batch = SimpleNamespace(signals=signals, T_s=T_s)
    assert criteria.settling(batch, i_max) == (5 * T_s, 5 * T_s)
    signals[I_D] = 0.5 * (-1.0) ** np.arange(n)  # a ripple beyond 0.2 A
    assert criteria.settling(batch, i_max) == (n * T_s, pytest.approx(5 * T_s))
    signals[I_D], signals[I_Q] = 0.0, np.nan
    signals[I_D_REF] = 0.0
    assert criteria.settling(batch, i_max) == (n * T_s, n * T_s)


def test_a_drive_that_trips_counts_as_the_worst():
    drives = scenarios.Scenarios.model_validate(SMALL).judged_on
    good = criteria.figures(drives, "mbpcc", {}, 0)
    tripped = criteria.figures(drives, "mbpcc", {"controller.fault.overcurrent": 0.1}, 0)
    assert tripped["distortion"] == pytest.approx(100.0)
    assert [tripped[name] for name in ("mismatch_error", "step_error")] == pytest.approx([12.0] * 2)
    assert tripped["lost"] == pytest.approx(100.0 * 4 / 6)
    assert criteria.score(good) < criteria.score(tripped)


def test_intervals_and_ties():
    a, b = [1.0, 1.2, 0.9, 1.1, 1.0], [1.3, 1.4, 1.2, 1.5, 1.2]
    expected = stats.ttest_rel(a, b).confidence_interval(0.95)
    found = ranks.difference(a, b)
    assert (found.mean - found.half, found.mean + found.half) == pytest.approx(
        (expected.low, expected.high)
    )
    assert found.is_less and not ranks.difference(b, a).is_less
    noisy = [1.0, 1.6, 0.8, 1.3, 0.9]  # neither better than a nor worse than b for certain
    assert ranks.ranks({"b": b, "a": a, "noisy": noisy}) == {"a": 1, "noisy": 1, "b": 2}


def test_the_file_of_the_project_is_fair_and_its_ranges_hold_the_defaults():
    found = scenarios.load(yaml_files.find("tuning", "leaderboard"))
    from mfpcc_controller.parameters import SCHEMES, TABLE

    assert set(found.ranges) == set(SCHEMES)
    gains = [r["deadbeat.gain"] for r in found.ranges.values() if "deadbeat.gain" in r]
    assert len(gains) == 9 and all(gain == gains[0] for gain in gains)
    for scheme in SCHEMES:
        for name, space in found.spaces(scheme).items():
            low, high = space.values
            default = TABLE[name].default
            assert default == 0.0 or low <= default <= high, name
    # no draw of the one set is one of the other, in any of many repeats
    tuned, judged = found.tuned_on.random, found.judged_on.random
    assert tuned.seed + 1000 * 50 + tuned.runs < judged.seed


BAD = {
    "unknown scheme": (["mls_mfpc"], {}, "did you mean 'mls_mfpcc'"),
    "nothing to tune": (["mbpcc"], {}, "'mbpcc' has no parameters to be tuned"),
    "no such file": (["--scenarios", "nowhere"], None, "unknown tuning 'nowhere'"),
    "unknown parameter": ([], {"ranges": {"pi_foc": {"pi.band": {"uniform": [1, 2]}}}}, "pi.band"),
    "no range": ([], {"ranges": {"pi_foc": {"pi.bandwidth": [1.0, 2.0]}}}, "needs a range"),
    "out of range": (
        [],
        {"ranges": {"pi_foc": {"pi.bandwidth": {"uniform": [0.0, 9e9]}}}},
        "pi.bandwidth",
    ),
    "no scheme": ([], {"ranges": {"pi": {"pi.bandwidth": {"uniform": [1, 2]}}}}, "unknown scheme"),
    "nothing at all": ([], {"ranges": {"pi_foc": {}}}, "has nothing to be moved"),
    "no drives": ([], {"tuned_on": {**DRIVES, "steps": []}}, "steps"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_is_said_in_one_sentence(case, tmp_path):
    arguments, changes, sentence = BAD[case]
    if changes is not None:
        (tmp_path / "own.yaml").write_text(json.dumps({**SMALL, **changes}))
        arguments = [*arguments, "--scenarios", str(tmp_path / "own.yaml")]
    out = tmp_path / "out"
    found = CliRunner().invoke(command, [*arguments, "--budget", "2", "--out", str(out)])
    assert isinstance(found.exception, ForPeople)
    assert sentence in str(found.exception) and "\n" not in str(found.exception)
    assert not out.exists()


def test_another_tuning_or_something_else_is_left_alone(tmp_path):
    Folder(tmp_path / "one", {"budget": 2}, resume=False)
    with pytest.raises(SweepError, match="--resume"):
        Folder(tmp_path / "one", {"budget": 2}, resume=False)
    with pytest.raises(SweepError, match="another budget"):
        Folder(tmp_path / "one", {"budget": 3}, resume=True)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/file").write_text("mine")
    with pytest.raises(SweepError, match="something else than a tuning"):
        Folder(tmp_path / "mine", {}, resume=True)


def test_without_the_optimiser_the_set_up_is_named(monkeypatch):
    monkeypatch.setattr("mfpcc_experiments.sweeping.errors.find_spec", lambda name: None)
    found = CliRunner().invoke(command, ["--budget", "2"])
    assert "'make sweeps' installs it" in str(found.exception)
