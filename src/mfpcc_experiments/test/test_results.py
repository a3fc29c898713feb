"""The interface for scripts and notebooks: the same figures as the command line's."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from harness import PATIENCE

from mfpcc_experiments import Experiment, Result, cli, load, run
from pwm_node.errors import ForPeople

SHORT = Experiment(
    name="short", motor="seed_750", speed_rpm=750.0, duration=0.12, window_s=(0.04, 0.12),
    plant={"load_torque": 2.0, "noise.current_rms": 0.0245, "oversampling": 20},
)  # fmt: skip


@pytest.fixture(scope="module")
def short() -> Result:
    return run(SHORT, scheme="mbpcc", seed=3, controller={"mismatch.inductance": 2.0})


def test_figures_are_those_of_the_command_line(
    tmp_path: Path, short: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short.yaml").write_text(
        "motor: seed_750\nspeed_rpm: 750\nduration: 0.12\nwindow_s: [0.04, 0.12]\n"
        "plant: {load_torque: 2.0, noise.current_rms: 0.0245, oversampling: 20}\n"
    )
    line = "run short.yaml --engine inprocess --scheme mbpcc --seed 3 --out here --set"
    assert cli.run([*line.split(), "mismatch.inductance=2.0"]) == 0
    (row,) = json.loads(Path("here/metrics.json").read_text())
    for measured in (row, short.metrics):
        measured.pop("step_time_us")
    assert row.pop("setup") == 0  # which column of a table: nothing of one run alone
    assert short.metrics == row
    again = load("here/mbpcc")
    np.testing.assert_array_equal(again.i_dq, short.i_dq)
    np.testing.assert_array_equal(again.duty, short.duty)


def test_arrays_agree_with_the_messages(short: Result) -> None:
    n = 1200
    feedback, state = short.recording.feedback, short.recording.state
    assert short.time.shape == (n,) and short.time[-1] == pytest.approx((n - 1) * 1e-4)
    assert short.i_abc.shape == (n, 3) and short.duty.shape == (n, 3)
    np.testing.assert_array_equal(short.i_abc[:, 1], feedback["i_b"])
    np.testing.assert_array_equal(short.w_M, state["speed"])
    # the command of period k was computed from sample k - 1; nobody commanded period 0
    assert np.isnan(short.duty[0]).all()
    np.testing.assert_array_equal(short.duty[1:], short.recording.command["duty"][: n - 1])
    # Clarke and Park by hand, with the true angle
    a = np.exp(2j * np.pi / 3)
    i_s = 2 / 3 * (short.i_abc @ np.array([1, a, a**2])) * np.exp(-4j * state["angle"])
    np.testing.assert_allclose(short.i_dq, i_s, atol=0.02)
    assert set(short.columns["scheme"]) == {"mbpcc"}


def test_decimated_topics_leave_gaps_not_zeros() -> None:
    result = run(SHORT, scheme="mbpcc", controller={"diagnostics_decimation": 4})
    assert np.isnan(result.i_dq[1]) and np.isfinite(result.i_dq[4])
    assert result.columns["scheme"][1] == ""


def test_nothing_is_left_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    run(SHORT, scheme="pi_foc")
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"experiment": "steady_750"}, "steady_750_2"),
        ({"scheme": "mls"}, "mls_mfpcc"),
        ({"engine": "fast"}, "inprocess"),
        ({"controller": {"mismatch.L": 2.0}}, "mismatch.inductance"),
        ({"plant": {"load_torque": "much"}}, "load_torque"),
        ({"plant": {"mismatch.inductance": 2.0}}, "controller"),
    ],
)
def test_errors_are_the_sentences_of_the_command_line(
    arguments: dict[str, object], sentence: str
) -> None:
    with pytest.raises(ForPeople, match=sentence):
        run(**{"experiment": SHORT, **arguments})  # type: ignore[arg-type]


def test_a_bag_that_is_not_there() -> None:
    with pytest.raises(ForPeople, match="no such file"):
        load("nowhere")


def test_importing_is_cheap() -> None:
    """The command line imports this package: arrays and kernels only when they are asked for."""
    code = "import mfpcc_experiments, sys; sys.exit('numpy' in sys.modules)"
    assert (
        subprocess.run([sys.executable, "-c", code], timeout=PATIENCE, check=False).returncode == 0
    )


def test_data_frame(short: Result) -> None:
    import pandas

    frame = short.to_dataframe()
    assert isinstance(frame, pandas.DataFrame) and frame.index.name == "period"
    assert frame["i_a_A"].iloc[5] == short.i_abc[5, 0]


def test_every_field_of_the_topics_has_its_column(short: Result) -> None:
    """A field that is added to a message is added to the table, or left out on purpose."""
    from mfpcc_experiments.measuring.columns import _COLUMNS

    left_out = {
        "feedback": {"stamp", "period", "derating"},
        "command": {"stamp", "period"},
        "lut": {
            "stamp", "period", "gradient_re", "gradient_im", "error_share", "learning_rate", "age",
            "updated", "bounded",
        },
        "state": {"stamp", "period", "dc_voltage"},
    }  # fmt: skip
    for topic, names in left_out.items():
        fields = set(getattr(short.recording, topic).dtype.names)
        assert fields - names == {field for t, field, _ in _COLUMNS if t == topic}


def test_progress_is_shown_if_wanted(capfd: pytest.CaptureFixture[str]) -> None:
    run(SHORT, scheme="pi_foc", progress=True)
    out, err = capfd.readouterr()
    assert out == "" and "pi_foc" in err
