"""A sweep: its file, its rows, and that nothing changes them: no kill, no worker, no machine."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from harness import Process, until

from mfpcc_experiments.bags import read
from mfpcc_experiments.measuring import evaluate
from mfpcc_experiments.method.drives import random_drive, settled
from mfpcc_experiments.running import closed_loop, run
from mfpcc_experiments.sweeping import again, cluster, estimate, local, work
from mfpcc_experiments.sweeping import folder as folders
from mfpcc_experiments.sweeping import plan as plans
from mfpcc_experiments.sweeping.errors import SweepError
from mfpcc_experiments.sweeping.plan import Plan
from mfpcc_experiments.sweeping.spec import load
from pwm_node import yaml_files
from pwm_node.errors import ForPeople

pytest.importorskip("pyarrow")
from pyarrow import parquet

SHORT = {"duration": 0.02, "window_s": [0.01, 0.02], "oversampling": 0}


def spec_of(folder: Path, **content):
    path = folder / "spec.yaml"
    path.write_text(yaml.safe_dump({"experiment": "steady_750_2", "set": SHORT, **content}))
    return load(path)


def rows_of(folder: Path):
    return parquet.read_table(sorted(folder.glob("*.parquet"))).to_pylist()


BAD = {
    "unknown parameter": (
        {"mismatch.inductanze": [1.0]},
        "unknown parameter 'mismatch.inductanze'",
    ),
    "of both nodes": ({"fault.overcurrent": [1.0]}, "both nodes have a parameter"),
    "empty range": ({"load_torque": {"uniform": [2, 2]}}, "the range from 2 to 2 is empty"),
    "no values": ({"load_torque": []}, "needs a list of values"),
    "backwards": ({"load_torque": {"uniform": [5, 2]}}, "the range from 5 to 2 is empty"),
    "log of nothing": ({"load_torque": {"log_uniform": [0, 2]}}, "both above 0, and has 0 and 2"),
    "no spread": ({"load_torque": {"normal": [1, 0]}}, "above 0, and has 0 for it"),
    "no distribution": ({"load_torque": {"cauchy": [1, 2]}}, "unknown distribution 'cauchy'"),
    "two of them": ({"load_torque": {"grid": [1], "uniform": [1, 2]}}, "needs one of"),
    "a number": ({"load_torque": 3}, "needs a list of values, or one of"),
    "not finite": ({"load_torque": {"uniform": [0, float("inf")]}}, "[lowest, highest], and has"),
    "out of range": ({"load_torque": {"uniform": [0, 1e5]}}, "'load_torque' = "),
    "drawn out of range": ({"mismatch.flux": {"normal": [0.0, 1.0]}}, "is out of range"),
    "wrong type": ({"load_torque": ["much"]}, "a number (-10000 to 10000 N m) is expected"),
    "no such motor": ({"motor": ["seed_751"]}, "unknown motor 'seed_751'"),
    "no such entry": ({"motor.L": [1.0]}, "unknown entry of a motor file 'L'"),
    "impossible motor": ({"motor.L_d": [-1.0]}, "greater than 0"),
    "no such change": ({"schedule[0].load_torque": [1.0]}, "has no such entry; it has none"),
    "fixed in a sweep": ({"duration": [1.0, 2.0]}, "is the same in all runs of a sweep"),
    "schemes elsewhere": ({"scheme": ["mbpcc"]}, "name the schemes in 'schemes'"),
    "sign of nothing": (
        {"load_torque": {"uniform": [0, 1], "sign_of": "speed_rpm"}},
        "'sign_of' names 'speed_rpm', which is no other one that varies",
    ),
    "its own sign": (
        {"load_torque": {"uniform": [0, 1], "sign_of": "load_torque"}},
        "which is no other one that varies",
    ),
    "sign of a text": (
        {"load_torque": {"uniform": [0, 1], "sign_of": "control_mode"}, "control_mode": ["speed"]},
        "whose values are no numbers",
    ),
    "text with a sign": (
        {"motor": {"choice": ["ipmsm"], "sign_of": "load_torque"}, "load_torque": [1.0]},
        "so they have no sign",
    ),
    "more than memory": (
        {"load_torque": {"linspace": [0, 1, 10**11]}},
        "has 100,000,000,000 values, more than 1,000,000",
    ),
    "twice": ({"load_torque": [1.0, 1.0]}, "a value stands twice"),
    "too many": (
        {f"mls.{n}": {"linspace": [0.1, 0.9, 1000]} for n in ("beta", "eta_min", "eta_max")},
        "4,096,000,000,000 runs are more than the 100,000,000",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_is_said_in_one_sentence(case, tmp_path):
    vary, sentence = BAD[case]
    with pytest.raises(ForPeople) as error:
        Plan(spec_of(tmp_path, vary=vary, runs=4096)).check()
    assert sentence in str(error.value)
    assert "\n" not in str(error.value)


def test_other_keys_that_cannot_be(tmp_path):
    for content, sentence in (
        ({"draw": "sobol", "runs": 1000}, "such as 512 or 1024"),
        ({"draw": "dice"}, "unknown draw 'dice'"),
        ({"metrics": ["thd"]}, "unknown metric 'thd'"),
        ({"survived": {"span": 1.0}}, "unknown figure 'span'"),
        ({"survived": {"i_peak": -1.0}}, "must be above 0"),
        ({"runs": 0}, "'runs'"),
        ({"runs": True}, "'runs'"),
        ({"name": "../../elsewhere"}, "must be of at most 100 letters"),
        ({"name": "x" * 5000}, "must be of at most 100 letters"),
        ({"schemes": ["mbpc"]}, "unknown scheme 'mbpc'"),
        ({"varies": {}}, "unknown key 'varies'"),
    ):
        with pytest.raises(ForPeople) as error:
            spec_of(tmp_path, **content)
        assert sentence in str(error.value)


def test_what_only_a_recording_has_is_refused_before_anything_runs(tmp_path):
    with pytest.raises(SweepError, match="a sweep runs with 'fault_injection' = False only"):
        Plan(spec_of(tmp_path, **{"set": {**SHORT, "fault_injection": True}})).check()


def test_the_time_of_long_runs_is_told_without_one(tmp_path, monkeypatch):
    """An hour each: to run two of them would take minutes."""
    clock = iter(range(100))
    monkeypatch.setattr(estimate.time, "process_time", lambda: next(clock))
    rooms = []
    monkeypatch.setattr(
        estimate, "Batch", lambda *room: rooms.append(room) or SimpleNamespace(run=list)
    )
    plan = Plan(spec_of(tmp_path, set={"duration": 3600.0}, runs=1000))
    # a second for two runs of 2 s is 900 s for one of an hour
    assert estimate.seconds(plan) == pytest.approx(1000 * 900.0 / local.cores())
    assert rooms[0][:2] == (20_000, (0.0, 2.0))


def test_values_that_are_wrong_together_are_told_with_their_row(tmp_path):
    vary = {"inverter.dead_time": {"uniform": [0, 6e-5]}}
    plan = Plan(spec_of(tmp_path, vary=vary, runs=20))
    plan.check()
    with pytest.raises(SweepError, match=r"row \d+: 'inverter.dead_time' = .* half a PWM period"):
        next(work.jobs(plan)).run()


def test_grids_take_all_and_draws_are_the_same_in_each(tmp_path):
    vary = {
        "control_mode": ["speed", "current"],
        "load_torque": {"uniform": [1.0, 5.0], "sign_of": "speed_rpm"},
        "speed_rpm": [300.0, 750.0],
        "sensor.encoder_lines": {"uniform": [500, 502]},
    }
    plan = Plan(spec_of(tmp_path, vary=vary, runs=50, schemes=["mbpcc", "pi_foc"], seed=9))
    assert (plan.points, plan.rows) == (4, 400)
    columns = plan.columns(0, 400)
    half = {name: values[:200] for name, values in columns.items()}
    assert all((values[200:] == half[name]).all() for name, values in columns.items())
    assert half["speed_rpm"].tolist() == ([300.0] * 50 + [750.0] * 50) * 2
    assert half["control_mode"].tolist() == ["speed"] * 100 + ["current"] * 100
    assert (half["seed"].reshape(4, 50) == 9 + np.arange(50)).all()
    drawn = half["load_torque"].reshape(4, 50)
    assert (drawn == drawn[0]).all()
    assert len(set(drawn[0].tolist())) == 50
    assert set(half["sensor.encoder_lines"].tolist()) == {500, 501, 502}


@pytest.mark.parametrize("draw", ["random", "latin_hypercube", "sobol"])
def test_distributions_are_what_they_are_called(draw, tmp_path):
    vary = {
        "load_torque": {"uniform": [1.0, 3.0]},
        "mismatch.flux": {"log_uniform": [0.1, 10.0]},
        "mismatch.resistance": {"normal": [5.0, 0.5]},
    }
    plan = Plan(spec_of(tmp_path, vary=vary, runs=4096, draw=draw))
    columns = plan.columns(0, plan.rows)
    u = (columns["load_torque"] - 1.0) / 2.0
    v = np.log10(columns["mismatch.flux"]) / 2.0 + 0.5
    z = (columns["mismatch.resistance"] - 5.0) / 0.5
    for uniform in (u, v):
        assert 0.0 <= uniform.min() < 0.01 and 0.99 < uniform.max() <= 1.0
        largest_gap = np.abs(np.sort(uniform) - (np.arange(4096) + 0.5) / 4096).max()
        assert largest_gap < (0.03 if draw == "random" else 1 / 2048)
    assert abs(z.mean()) < 0.05 and abs(z.std() - 1.0) < 0.05
    assert abs(np.corrcoef([u, v, z])[np.triu_indices(3, 1)]).max() < 0.05
    assert (plan.columns(100, 200)["load_torque"] == columns["load_torque"][100:200]).all()


EVERY_KIND = {
    "experiment": "load_step",
    "set": {"duration": 0.03, "window_s": [0.01, 0.03], "oversampling": 4},
    "vary": {
        "motor": {"choice": ["seed_750", "textbook_spmsm"]},
        "motor.R_s": {"uniform": [1.0, 3.0]},
        "motor.u_dc": {"uniform": [280.0, 320.0]},
        "speed_rpm": {"uniform": [-900.0, 900.0]},
        "load.inertia": {"log_uniform": [1e-4, 1e-2]},
        "sensor.adc_bits": {"choice": [0, 12]},
        "mismatch.inductance": {"uniform": [0.5, 2.0]},
        "mtpa": {"choice": [True, False]},
        "inverter.dead_time": {"choice": [0.0, 2e-6]},
        "schedule[0].load_torque": {"uniform": [0.0, 4.0], "sign_of": "speed_rpm"},
    },
    "runs": 12,
    "schemes": ["mls_mfpcc"],
}


def test_a_row_is_the_run_that_is_recorded(tmp_path, monkeypatch):
    content = dict(EVERY_KIND)
    # the step is within the run
    experiment = tmp_path / "step.yaml"
    experiment.write_text(
        "motor: seed_750\nspeed_rpm: 500.0\nduration: 0.03\nwindow_s: [0.01, 0.03]\n"
        "plant: {load_torque: 1.0, noise.current_rms: 0.02}\n"
        "schedule:\n  - {at: 0.015, load_torque: 5.0}\n"
    )
    content["experiment"] = str(experiment)
    plan = Plan(spec_of(tmp_path, **content))
    plan.check()
    folder = folders.begin(tmp_path / "out", plan, work.fingerprint(), resume=False)
    folder.keep(0, next(work.jobs(plan)).run())
    rows = rows_of(folder.path)
    assert [row["row"] for row in rows] == list(range(12))
    assert {row["motor"] for row in rows} == {"seed_750", "textbook_spmsm"}
    for number in (0, 5, 11):
        wanted, scheme, seed = again.experiment(folder.path, number)
        run.run(wanted, scheme, "inprocess", tmp_path / str(number), seed, lambda done: None)
        figures = evaluate(read(tmp_path / str(number) / scheme))
        row = rows[number]
        assert row["seed"] == figures["seed"]
        assert row["i_rms"] == pytest.approx(figures["i_rms"], rel=1e-9)
        assert row["speed_rpm_mean"] == pytest.approx(figures["speed_rpm_mean"], rel=1e-9)
        assert row["deviation_rms.q"] == pytest.approx(figures["deviation_rms"]["q"], rel=1e-9)
        assert row["lut_error_max.d"] == pytest.approx(figures["lut_error_max"]["d"], rel=1e-9)
        assert row["copper_loss_w"] == pytest.approx(figures["copper_loss_w"], rel=1e-9)


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A sweep of eight chunks, and what it gives undisturbed."""
    monkeypatch.setattr(plans, "_CHUNK_PERIODS", 200 * 25)
    vary = {"mismatch.inductance": {"uniform": [0.5, 2.0]}, "load_torque": [0.0, 2.0]}
    plan = Plan(spec_of(tmp_path, vary=vary, runs=50, schemes=["mls_mfpcc", "mbpcc"]))
    assert plan.chunks == 8
    folder = folders.begin(tmp_path / "whole", plan, work.fingerprint(), resume=False)
    for job in work.jobs(folder.plan):
        folder.keep(job.number, job.run())
    return plan, {n: folder.file(n).read_bytes() for n in range(plan.chunks)}


def test_a_killed_worker_is_replaced_and_its_chunk_done_again(small, tmp_path, monkeypatch):
    plan, whole = small
    hired = []
    begin = local._Worker.begin

    def begin_and_kill(self, job):
        begin(self, job)
        hired.append(self.process.pid)
        if len(hired) in (1, 4):
            os.kill(self.process.pid, signal.SIGKILL)

    monkeypatch.setattr(local._Worker, "begin", begin_and_kill)
    with local.pool(2) as pool:
        found = dict(pool.run(work.jobs(plan)))
    assert found == whole
    assert len(hired) == plan.chunks + 2


def test_a_chunk_that_kills_every_worker_is_given_up(small, tmp_path, monkeypatch):
    plan, _ = small
    begin = local._Worker.begin

    def begin_and_kill(self, job):
        begin(self, job)
        os.kill(self.process.pid, signal.SIGKILL)

    monkeypatch.setattr(local._Worker, "begin", begin_and_kill)
    with local.pool(1) as pool, pytest.raises(SweepError, match="3 workers died of it"):
        dict(pool.run(work.jobs(plan)))


def command(*arguments):
    code = "import sys; from mfpcc_experiments.cli import run; sys.exit(run(sys.argv[1:]))"
    return [sys.executable, "-c", code, *map(str, arguments)]


def test_a_killed_sweep_goes_on_and_gives_the_same_bytes(tmp_path):
    schemes = ["mls_mfpcc", "mbpcc", "pi_foc", "mfpcc", "neso_mfpcc", "mfpcc_two_vector"]
    vary = {"mismatch.inductance": {"uniform": [0.5, 2.0]}}
    spec_of(tmp_path, vary=vary, runs=200, schemes=schemes)
    spec, killed = tmp_path / "spec.yaml", tmp_path / "killed"

    with Process(command("sweep", spec, "--out", killed)) as sweep:
        until(lambda: list(killed.glob("*.parquet")), "first rows")
        sweep.kill()
        sweep.wait()
    left = {path.name for path in killed.glob("*.parquet")}

    def call(*arguments):
        return subprocess.run(command(*arguments), capture_output=True, text=True, check=False)

    again = call("sweep", spec, "--out", killed)
    assert again.returncode == 1 and "--resume" in again.stderr
    assert call("sweep", spec, "--out", killed, "--resume").returncode == 0
    assert left and left < {path.name for path in killed.glob("*.parquet")}
    assert not list(killed.glob(".*"))
    own = folders.load(killed)
    for job in work.jobs(own.plan):
        assert own.file(job.number).read_bytes() == job.run()
    assert len(rows_of(killed)) == 1200

    other = call("sweep", spec, "--out", killed, "--resume", "--scheme", "mbpcc")
    assert other.returncode == 1 and "other schemes" in other.stderr


def test_a_grid_by_mistake_is_asked_about(tmp_path):
    names = ("load_torque", "mismatch.flux", "mls.beta")
    spec_of(tmp_path, vary={name: {"linspace": [0.1, 0.9, 100]} for name in names})
    path = tmp_path / "spec.yaml"
    called = command("sweep", path, "--out", tmp_path / "out")
    asked = subprocess.run(called, capture_output=True, text=True, check=False)
    assert asked.returncode == 2
    assert "1,000,000 runs (1,000,000 points of the grids) take about" in asked.stderr
    assert "--yes" in asked.stderr
    assert not (tmp_path / "out").exists()


def test_a_cluster_gives_the_same_bytes_and_loses_a_worker(tmp_path):
    pytest.importorskip("distributed")
    schemes = ["mls_mfpcc", "mbpcc", "pi_foc", "mfpcc", "neso_mfpcc", "mfpcc_two_vector"]
    vary = {"mismatch.inductance": {"uniform": [0.5, 2.0]}}
    spec_of(tmp_path, vary=vary, runs=100, schemes=schemes)
    file, out = tmp_path / "scheduler.json", tmp_path / "out"
    dask = [sys.executable, "-m", "dask"]
    here = ["--scheduler-file", file, "--no-dashboard", "--host", "127.0.0.1"]
    worker = [
        *dask,
        "worker",
        *here,
        "--no-nanny",
        "--nthreads",
        "1",
        "--local-directory",
        tmp_path,
    ]
    with ExitStack() as stack:

        def start(arguments):
            return stack.enter_context(Process(arguments))

        start([*dask, "scheduler", *here, "--port", "0"])
        workers = [start(worker), start(worker)]
        for each in workers:
            each.wait_for("Registered to")
        sweep = start(command("sweep", tmp_path / "spec.yaml", "--out", out, *here[:2]))
        until(lambda: list(out.glob("*.parquet")), "first rows")
        workers[0].kill()
        assert sweep.wait() == 0, sweep.output
    own = folders.load(out)
    for job in work.jobs(own.plan):
        assert own.file(job.number).read_bytes() == job.run()


def test_a_worker_that_would_give_other_rows_is_refused_by_name():
    own = {"code": "a", "arithmetic": "b"}
    assert cluster._difference(own, dict(own)) == ""
    for answer, why in (
        ({**own, "code": "x"}, "another version of the code"),
        ({**own, "arithmetic": "x"}, "arithmetic of its processor"),
        (ModuleNotFoundError("no", name="numba"), "no package 'numba'"),
        (RuntimeError("ill"), "RuntimeError: ill"),
    ):
        assert why in cluster._difference(own, answer)

    class Client:
        def scheduler_info(self, n_workers):
            return {"workers": {a: {"name": f"node {a}", "nthreads": 2} for a in ("good", "old")}}

        def run(self, function, workers, on_error):
            answers = {"good": work.fingerprint(), "old": {**work.fingerprint(), "code": "old"}}
            return {name: answers[name] for name in workers}

    said = []
    crew = cluster._Crew(Client(), said.append)
    crew.look()
    crew.look()
    assert crew.threads == {"good": 2}
    assert said == ["worker node old (old) gets no work: it has another version of the code"]


def test_another_code_does_not_go_on_with_a_sweep(small, tmp_path):
    plan, _ = small
    own = work.fingerprint()
    folders.begin(tmp_path / "out", plan, own, resume=False)
    for key, words in (("code", "another version"), ("arithmetic", "other digits")):
        with pytest.raises(SweepError, match=words):
            folders.begin(tmp_path / "out", plan, {**own, key: "x"}, resume=True)


def test_nothing_else_is_written_over(small, tmp_path):
    plan, _ = small
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/file").write_text("mine")
    with pytest.raises(SweepError, match="something else than a sweep"):
        folders.begin(tmp_path / "mine", plan, work.fingerprint(), resume=True)


def test_the_random_drives_of_the_method_are_a_sweep():
    """The file draws what `random_drive` does, and judges as `settled` does."""
    plan = Plan(load(yaml_files.find("sweeps", "random_drives")), ("mfpcc_two_vector",))
    plan.check()
    assert plan.rows == 1000
    chosen = range(20)
    job = next(work.jobs(plan, [0]))
    few = replace(job, columns={name: values[:20] for name, values in job.columns.items()})
    outcome = work.outcomes(few)
    survived = work.survived(outcome, plan.spec.survived)
    for number in chosen:
        _, values = plan.row(number)
        options = random_drive(number)
        assert values["seed"] == options["seed"] == number
        assert {name: values[name] for name in options["controller"]} == options["controller"]
        assert (values["speed_rpm"], values["load_torque"]) == (options["rpm"], options["load"])
        assert options["schedule"] == [f"0.1 load_torque {values['schedule[0].load_torque']}"]
        r = closed_loop.run("mfpcc_two_vector", 0.25, **options)
        assert outcome["i_peak"][number] == r.largest_current()
        assert survived[number] == settled(r, 0.6)
    assert 0 < survived.sum() < 20
