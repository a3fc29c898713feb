"""What was not so is not reported: the same words and exit code wherever a result is shown."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from mfpcc_controller import plug_in
from mfpcc_controller.parameters import TABLE, Parameter
from mfpcc_experiments import cli, notes
from mfpcc_experiments.bags import LOOP_TOPICS, recording, status
from mfpcc_experiments.bags.definitions import message_definition
from mfpcc_experiments.measuring import metrics, window
from mfpcc_experiments.measuring.measured import Measured
from mfpcc_experiments.measuring.signals import signals
from mfpcc_experiments.paper import runs
from mfpcc_experiments.reporting import figures, table
from mfpcc_experiments.reporting.style import COLOURS, MARKS
from mfpcc_experiments.running import run, scenario
from mfpcc_experiments.running.trace import write_trace

STEADY = """\
motor: {motor}
speed_rpm: {rpm}
duration: 0.12
window_s: [0.06, 0.12]
plant: {{load.kind: speed, load.speed_rpm: {rpm}, noise.current_rms: {noise}{plant}}}
controller: {{control_mode: current, i_q_ref: {i_q}}}
schedule: [{schedule}]
"""


def written(folder: Path, name: str = "short", **changes: Any) -> Path:
    """A scenario that is steady at once: imposed speed, current control."""
    values = {"motor": "seed_750", "rpm": 1500, "noise": 0.02, "plant": "", "i_q": 3.0}
    values = {**values, "schedule": "", **changes}
    file = folder / f"{name}.yaml"
    file.write_text(STEADY.format(**values))
    return file


def evaluated(folder: Path, scheme: str = "mls_mfpcc", **changes: Any) -> dict[str, Any]:
    wanted = scenario.load(written(folder, **changes))
    run.run(wanted, scheme, "inprocess", folder, 1, lambda done: None)
    return metrics.evaluate(recording.read(folder / scheme))


def texts(row: dict[str, Any], *severities: str) -> list[str]:
    return [n["text"] for n in row["notes"] if n["severity"] in severities or not severities]


class Slow(plug_in.Scheme):
    """Controls by proportional voltage, and raises after period 500."""

    def __init__(self, motor: Any, T_s: float) -> None:
        self.motor = motor

    def step(self, sample: plug_in.Sample) -> complex:
        if sample.period >= 500:
            raise RuntimeError("lost its way {at all}")
        error = sample.i_dq_ref - sample.i_dq
        emf = 1j * sample.w_m * (self.motor.psi_f + self.motor.L_d * sample.i_dq)
        return emf + self.motor.R_s * sample.i_dq_ref + 20.0 * error


class Entry:
    value = "here:Slow"

    def load(self) -> type[Slow]:
        return Slow


@pytest.fixture
def slow_deadbeat(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A plug-in's name, as if its package were installed."""
    monkeypatch.setitem(plug_in.PLUG_INS, "slow_deadbeat", Entry())
    known: Parameter = TABLE["scheme"]
    choices = known.choices
    object.__setattr__(known, "choices", (*choices, "slow_deadbeat"))  # it is frozen
    yield "slow_deadbeat"
    object.__setattr__(known, "choices", choices)


@pytest.mark.usefixtures("no_vectors")
@pytest.mark.parametrize("event", ["fallback", "trip", "switch", "gap"])
def test_every_verb_says_the_same_words(
    event: str,
    slow_deadbeat: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    if event == "fallback":
        scheme, label = slow_deadbeat, "SLOW-DEADBEAT -> PI-FOC"
        words = (
            "SLOW-DEADBEAT failed at 0.050 s, PI-FOC took over: scheme 'slow_deadbeat' failed in "
            "period 500: RuntimeError: lost its way {at all}"
        )
        file = written(tmp_path)
    elif event == "trip":
        scheme, label = "mls_mfpcc", "MLS-MFPCC"
        words = "gates off from 0.080 s: OVERCURRENT, current amplitude"
        file = written(tmp_path, schedule="{at: 0.08, plant.fault.overcurrent: 0.1}")
    elif event == "switch":
        scheme, label = "mls_mfpcc", "MBPCC"
        words = "MBPCC controlled from 0.020 s on, MLS-MFPCC before"
        file = written(tmp_path, schedule="{at: 0.02, scheme: mbpcc}")
    else:
        scheme, label = "mls_mfpcc", "MLS-MFPCC"
        words = "30 of the 600 periods of the window are missing in phase_feedback"
        file = written(tmp_path)
        monkeypatch.setattr(run, "write_trace", without_some_samples)
    severity, code = ("info", 0) if event == "switch" else ("failure", notes.NOT_AS_ASKED)
    printed = []
    for line in (
        f"run {file.name} --scheme {scheme} --engine inprocess --out a",
        f"compare a/{scheme} --out b",
        f"replay a/{scheme} --scheme mbpcc --out c",
    ):
        assert cli.run(line.split()) == code
        printed.append(capsys.readouterr().out)

    said = set()
    for text in printed:
        (line,) = [x for x in text.splitlines() if x.startswith(f"{severity}:") and words in x]
        assert label in line
        said.add(line[line.index(words) :])
    for folder in (Path("a"), Path("b"), Path("c")):
        (row,) = json.loads((folder / "metrics.json").read_text())
        said |= {note for note in texts(row, severity) if words in note}
    (sentence,) = said
    for folder in (Path("a"), Path("b")):
        page = html.unescape(re.sub(r"<[^>]*>", "", (folder / "report.html").read_text()))
        assert sentence in page and label in page
    # `mfpcc reproduce` measures what it runs, in process and without a recording, by itself
    if event != "gap":
        row = metrics.evaluate(runs.simulate(scenario.load(file.name), scheme, 0))
        assert sentence in texts(row, severity)


def without_some_samples(writer: Any, trace: Any, **options: Any) -> None:
    """Write a trace, but for 30 of the samples."""

    class Lossy:
        def __getattr__(self, name: str) -> Any:
            return getattr(writer, name)

        def write(self, topic: str, at: int, data: bytes) -> None:
            if topic != "phase_feedback" or not 80_000_000 <= at < 83_000_000:
                writer.write(topic, at, data)

    write_trace(Lossy(), trace, **options)


def as_others_record(ours: Path, path: Path, *, lut: bool) -> Path:
    """The messages of a recording, with `drive_status` as the nodes publish it, and no more."""
    serialization = pytest.importorskip("rclpy.serialization")
    from mfpcc_msgs.msg import DriveFault, DriveStatus

    found = recording.read(ours)
    faults = found.summary["faults"]
    moments = {0, *np.flatnonzero(found.scheme[1:] != found.scheme[:-1]) + 1}
    moments |= {fault["period"] for fault in faults}
    path.mkdir()
    with (
        open(path / "theirs_0.mcap", "wb") as file,
        open(ours / f"{ours.name}_0.mcap", "rb") as old,
    ):
        writer = Writer(file)
        writer.start(profile="ros2")
        channels = {}
        for topic, kind in {**LOOP_TOPICS, status.TOPIC: status.TYPE}.items():
            schema = writer.register_schema(kind, "ros2msg", message_definition(kind).encode())
            channels["/" + topic] = writer.register_channel("/" + topic, "cdr", schema)
        for _, channel, message in make_reader(old).iter_messages(topics=list(channels)):
            if lut or channel.topic != "/lut_diagnostics":
                writer.add_message(
                    channels[channel.topic], message.log_time, message.data, message.log_time
                )
        for period in sorted(moments):
            for node in ("pmsm_sim", "mfpcc_controller"):
                said = DriveStatus(node=node, period=int(period), state="running", enabled=True)
                if node == "mfpcc_controller":
                    said.scheme = str(found.scheme[period])
                said.faults = [
                    DriveFault(code=f["code"], detail=f["detail"], period=f["period"])
                    for f in faults
                    if f["node"] == node and f["period"] <= period
                ]
                at = int(period) * 100_000
                writer.add_message(
                    channels["/" + status.TOPIC], at, serialization.serialize_message(said), at
                )
        writer.finish()
    return path


@pytest.mark.parametrize("lut", [True, False])
@pytest.mark.parametrize("event", ["fallback", "trip", "switch", "switch and fallback"])
def test_a_recording_of_others_has_the_same_labels_and_notes(
    event: str, lut: bool, slow_deadbeat: str, tmp_path: Path
) -> None:
    scheme = slow_deadbeat if event == "fallback" else "mls_mfpcc"
    schedule = {
        "trip": "{at: 0.08, plant.fault.overcurrent: 0.1}",
        "switch": "{at: 0.08, scheme: mbpcc}",
        "switch and fallback": "{at: 0.03, scheme: slow_deadbeat}",
    }.get(event, "")
    wanted = scenario.load(written(tmp_path, schedule=schedule))
    run.run(wanted, scheme, "inprocess", tmp_path, 1, lambda done: None)
    ours = metrics.evaluate(recording.read(tmp_path / scheme))
    found = recording.read(as_others_record(tmp_path / scheme, tmp_path / "theirs", lut=lut))
    found.n_p = 4  # without `lut_diagnostics` nothing tells it
    theirs = metrics.evaluate(found, ours["window_s"])
    assert theirs["scheme"] == ours["scheme"]
    assert texts(theirs, "failure") == texts(ours, "failure")
    told = [text for text in texts(ours, "info") if "controlled from" in text]
    assert [text for text in texts(theirs, "info") if "controlled from" in text] == told
    assert notes.exit_code([theirs]) == notes.exit_code([ours])


def test_a_status_that_is_no_status() -> None:
    for data in (b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + b"\xff" * 60, b"\x01" * 80):
        with pytest.raises(status.StatusError):
            status.parse(data, 0)


def test_a_scheme_that_failed_lends_no_name_to_the_figures_of_another(
    slow_deadbeat: str, tmp_path: Path
) -> None:
    row = evaluated(tmp_path, slow_deadbeat)
    assert row["scheme"] == "slow_deadbeat -> pi_foc"
    assert row["thd_percent"]["control"] is not None  # PI-FOC's, and the label says so
    assert row["step_time_us"] == {"median": None, "p99": None}
    names = set(recording.read(tmp_path / slow_deadbeat).scheme.tolist())
    assert names == {"slow_deadbeat", "pi_foc"}


def test_the_label_is_of_who_controlled_within_the_window(tmp_path: Path) -> None:
    row = evaluated(tmp_path, schedule="{at: 0.02, scheme: mbpcc}")
    assert row["scheme"] == "mbpcc" and notes.exit_code([row], strict=True) == 0
    assert "MBPCC controlled from 0.020 s on, MLS-MFPCC before" in texts(row)
    (tmp_path / "again").mkdir()
    row = evaluated(tmp_path / "again", schedule="{at: 0.09, scheme: mbpcc}")
    assert row["scheme"] == "mls_mfpcc -> mbpcc"
    assert row["thd_percent"]["control"] is row["lut_error_max"]["d"] is None


def test_overspeed_of_a_motor_that_nothing_holds(tmp_path: Path) -> None:
    file = tmp_path / "free.yaml"
    file.write_text(
        "motor: seed_750\nduration: 0.3\nwindow_s: [0.2, 0.3]\n"
        "controller: {control_mode: current, i_q_ref: 5}\n"
    )
    run.run(scenario.load(file), "mls_mfpcc", "inprocess", tmp_path, 1, lambda done: None)
    found = recording.read(tmp_path / "mls_mfpcc")
    # an encoder that has failed shows another speed than the true one
    found.feedback["encoder_angle"] = 1.0
    row = metrics.evaluate(found)
    (failure,) = texts(row, "failure")
    assert re.match(r"gates off from 0\.\d{3} s: OVERSPEED, \d+ rad/s$", failure)
    given = [m.key for m in metrics.METRICS if table.value(row, m.path) is not None]
    assert not any(key.startswith(("thd", "ripple", "lut", "copper", "i_d", "i_q", "torque"))
                   for key in given)  # fmt: skip
    assert row["switching_frequency_hz"] == 0.0
    truth = found.state["speed"][2000:3000].mean() * 30 / np.pi
    assert row["speed_rpm_mean"] == pytest.approx(truth) and truth > 1500


@pytest.mark.parametrize(
    "schedule",
    [
        "{at: 0.09, load.speed_rpm: 900}",
        "{at: 0.118, load_torque: 1.0}",
        "{at: 0.09, i_q_ref: 3.3}",
        "{at: 0.09, i_d_ref: -0.02}",
        "{at: 0.1, dc_voltage: 250}",
        "{at: 0.1, mismatch.flux: 0.5}",
    ],
)
@pytest.mark.parametrize("told", [True, False])
def test_no_thd_and_no_ripple_of_what_changes(schedule: str, told: bool, tmp_path: Path) -> None:
    wanted = scenario.load(written(tmp_path, schedule=schedule))
    run.run(wanted, "mls_mfpcc", "inprocess", tmp_path, 1, lambda done: None)
    found = recording.read(tmp_path / "mls_mfpcc")
    if not told:
        if "dc_voltage" in schedule or "mismatch" in schedule:
            pytest.skip("a recording of others does not tell")
        # a recording of others: what changed is in its messages only
        found.config = {"window_s": found.config["window_s"]}
    row = metrics.evaluate(found)
    assert row["steady"] is False
    assert set(row["thd_percent"].values()) == set(row["ripple_pp"].values()) == {None}
    assert row["scatter"]["parts"] == 0
    assert row["deviation_rms"]["q"] is not None
    assert any("not steady" in t and "deviation from the reference" in t for t in texts(row))
    assert notes.exit_code([row], strict=True) == 0  # it was asked for


def test_a_window_of_one_electrical_period_has_no_thd(tmp_path: Path) -> None:
    wanted = scenario.load(written(tmp_path))
    run.run(wanted, "mls_mfpcc", "inprocess", tmp_path, 1, lambda done: None)
    found = recording.read(tmp_path / "mls_mfpcc")
    assert metrics.evaluate(found)["steady"] is True
    row = metrics.evaluate(found, (0.1, 0.111))
    assert row["steady"] is None and row["thd_percent"]["control"] is None
    assert any("cannot be judged: the window holds 1.1 electrical" in t for t in texts(row))


def test_copper_loss_balances_the_powers(tmp_path: Path) -> None:
    plant = ", drift.resistance: 2.0, drift.temperature: 95.0, oversampling: 4"
    row = evaluated(tmp_path, plant=plant)
    found = recording.read(tmp_path / "mls_mfpcc")
    state = found.state[600:1200]
    electrical = np.mean(state["dc_voltage"] * state["dc_current"])
    mechanical = np.mean(state["torque"] * state["speed"])
    # the ideal inverter loses nothing; the field stores as much at the end as at the begin
    assert row["copper_loss_w"] == pytest.approx(electrical - mechanical, rel=0.02)
    expected = 2.0 * 1.5 * (1.0 + 0.00393 * 75.0)
    assert any(f"copper loss with {expected:.3g} ohm" in t for t in texts(row))
    found.state = found.state[:0]
    found.config["parameters"]["pmsm_sim"]["drift.time_constant"] = 10.0
    row = metrics.evaluate(found)
    assert row["copper_loss_w"] is None
    assert "no copper loss: the temperature of the winding is not recorded" in texts(row)


@pytest.mark.parametrize("height", [0.2, 0.02])
def test_steps_of_a_small_motor_are_seen(height: float, tmp_path: Path) -> None:
    row = evaluated(
        tmp_path,
        "mbpcc",
        motor="maxon_ec45flat_30w_12v",
        noise=0.0,
        i_q=0.5,
        schedule=f"{{at: 0.09, i_q_ref: {0.5 + height}}}",
    )
    (step,) = row["current_steps"]
    assert (step["axis"], step["from"], step["to"]) == ("q", 0.5, pytest.approx(0.5 + height))
    assert 1 <= step["settling_periods"] <= 20


def test_a_pace_that_was_not_kept_is_said() -> None:
    pace = {"asked": 1.0, "achieved": 0.58}
    found = SimpleNamespace(lost_periods=0, summary={"real_time_factor": pace})
    (note,) = metrics.of_the_run(found)  # type: ignore[arg-type]
    assert "real_time_factor 1 asked for, 0.58 achieved" in note.text
    pace["achieved"] = 0.995
    assert metrics.of_the_run(found) == []  # type: ignore[arg-type]


def measured(path: Path, label: str) -> Measured:
    found = recording.read(path)
    return Measured(
        path=path,
        label=label,
        row=metrics.evaluate(found),
        window=window.cut(found),
        signals=signals(found),
    )


def test_each_column_of_a_figure_has_its_own_time(make_bag: Any) -> None:
    config = {"T_s": 1e-4, "n_p": 4, "scheme": "mls_mfpcc"}
    runs = [
        measured(make_bag("a", 4000, config={**config, "window_s": [0.1, 0.3]}), "A"),
        measured(make_bag("b", 600, config={**config, "window_s": [0.01, 0.05]}), "B"),
    ]
    for figure in (figures.i_dq(runs), figures.lut_error(runs)):
        assert figure is not None
        spans = [axis.get_xlim() for axis in figure.axes]
        assert spans == [pytest.approx(s) for s in ((0.1, 0.3), (0.01, 0.05))] * 2 or spans == [
            pytest.approx(s) for s in ((0.1, 0.3), (0.1, 0.3), (0.01, 0.05), (0.01, 0.05))
        ]
        for axis in figure.axes:  # no empty panel
            low, high = axis.get_xlim()
            x = np.asarray(axis.lines[0].get_xdata())
            assert np.count_nonzero((x >= low) & (x <= high)) > 100


def test_many_columns_wrap(make_bag: Any) -> None:
    one = measured(make_bag("a", 2000), "A")
    figure = figures.i_dq([one] * 9)
    assert figure.get_figwidth() < 10.0 and len(figure.axes) == 18
    titles = [axis for axis in figure.axes if axis.get_title()]
    assert len(titles) == 9
    assert len({axis.get_ylim() for axis in figure.axes if axis.get_subplotspec()}) == 2


def test_ninety_recordings_are_told_apart() -> None:
    assert len(COLOURS) == len(set(COLOURS)) >= 9 and len(MARKS) == len(set(MARKS)) >= 9
    assert len({(COLOURS[n % len(COLOURS)], MARKS[n % len(MARKS)]) for n in range(90)}) == 90


@pytest.mark.parametrize(
    ("number", "shown"), [(0.00213, "0.00213"), (0.01234, "0.012"), (0.00012, "0.000")]
)
def test_milliamperes_keep_their_digits(number: float, shown: str) -> None:
    assert table.texts([number])[0] == shown
