"""Exported recordings, read back by other means and held against the raw messages of the bag."""

from __future__ import annotations

import csv
import json
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.io import loadmat

from mfpcc_experiments import cli

CONFIG = {"T_s": 1e-4, "n_p": 4, "scheme": "mls_mfpcc"}
PERIODS = 40


@pytest.fixture
def bag(make_bag) -> Path:
    return make_bag("some.bag", PERIODS, oversampling=4, config=CONFIG)


def raw(bag: Path, topic: str, layout: str) -> np.ndarray:
    """Fields of the messages of a topic, by their place in the serialized bytes."""
    rows = []
    (file,) = bag.glob("*.mcap")
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            if channel.topic.lstrip("/") == topic:
                rows.append(struct.unpack_from(layout, message.data))
    return np.array(rows, dtype=float)


def expected(bag: Path) -> dict[str, np.ndarray]:
    # stamp (two of 32 bits), period, then as in the .msg files
    feedback = raw(bag, "phase_feedback", "<4xiIQ5d")
    command = raw(bag, "duty_command", "<4xiIQ3d")
    state = raw(bag, "drive_state", "<4xiIQ4d")
    assert len(feedback) == PERIODS
    duty = {int(row[2]): row[3:] for row in command}
    duties = [duty.get(int(k), np.full(3, np.nan)) for k in feedback[:, 2]]
    return {
        "period": feedback[:, 2],
        "time_s": feedback[:, 0] + 1e-9 * feedback[:, 1],
        "i_a_A": feedback[:, 3],
        "i_c_A": feedback[:, 5],
        "u_dc_V": feedback[:, 7],
        "duty_b": np.array(duties)[:, 1],
        "i_q_true_A": state[:, 4],
        "tau_M_true_N_m": state[:, 5],
    }


def agree(found, bag: Path) -> None:
    for name, values in expected(bag).items():
        np.testing.assert_allclose(
            np.asarray(found[name], dtype=float).ravel(), values, rtol=1e-15, atol=1e-15
        )


def read_csv(path: Path) -> dict[str, np.ndarray]:
    with path.open(newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    table = dict(zip(head, zip(*rows, strict=True), strict=True))
    scheme = table.pop("scheme", None)
    found = {n: np.array([float(v or "nan") for v in values]) for n, values in table.items()}
    return found | ({"scheme": np.array(scheme)} if scheme else {})


def test_csv(bag, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.run(["export", str(bag), "--format", "csv"]) == 0
    assert "written: some.bag.csv" in capsys.readouterr().out
    found = read_csv(tmp_path / "some.bag.csv")
    agree(found, bag)
    assert set(found["scheme"]) == {"mls_mfpcc"}
    fine = read_csv(tmp_path / "some.bag_oversampled.csv")
    assert list(fine) == [
        "period", "time_s", "i_a_true_A", "i_b_true_A", "i_c_true_A", "leg_a", "leg_b", "leg_c",
    ]  # fmt: skip
    # stamp, period, 9 doubles, the flag padded to 4, length 3 x 4, then a, b, c of each instant
    state = raw(bag, "drive_state", "<4xiIQ9d?3xI12d")
    assert np.all(state[:, 13] == 12)
    for n, phase in enumerate("abc"):
        np.testing.assert_array_equal(fine[f"i_{phase}_true_A"], state[:, 14 + n :: 3].ravel())
    np.testing.assert_allclose(fine["time_s"], np.arange(4 * PERIODS) * 1e-4 / 4, atol=1e-12)


def test_mat(bag, tmp_path):
    path = tmp_path / "run.mat"
    assert cli.run(["export", str(bag), "--format", "mat", "--out", str(path)]) == 0
    found = loadmat(path)
    agree(found, bag)
    assert found["i_a_A"].shape == (PERIODS, 1)
    assert found["oversampled_i_b_true_A"].shape == (4 * PERIODS, 1)
    names = [str(name[0]) for name in found["scheme_names"].ravel()]
    assert {names[k - 1] for k in found["scheme"].ravel()} == {"mls_mfpcc"}
    assert json.loads(str(found["configuration"][0]))["scheme"] == "mls_mfpcc"


def test_parquet(bag, tmp_path):
    from pyarrow import parquet

    path = tmp_path / "run.parquet"
    assert cli.run(["export", str(bag), "--format", "parquet", "--out", str(path)]) == 0
    table = parquet.read_table(path)
    agree(table.to_pydict(), bag)
    assert json.loads(table.schema.metadata[b"configuration"])["scheme"] == "mls_mfpcc"
    assert parquet.read_table(tmp_path / "run_oversampled.parquet").num_rows == 4 * PERIODS


def test_what_was_not_recorded_is_an_empty_cell(bag, tmp_path):
    """There is no command for period 0."""
    path = tmp_path / "run.csv"
    assert cli.run(["export", str(bag), "--format", "csv", "--out", str(path)]) == 0
    with path.open(newline="", encoding="utf-8") as file:
        first, second, *_ = csv.DictReader(file)
    assert first["duty_a"] == "" and first["i_a_A"] != ""
    assert second["duty_a"] != ""


def test_nothing_is_left_of_what_cannot_be_done(bag, tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    out.mkdir()
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    arguments = ["export", str(bag), "--format"]
    assert cli.run([*arguments, "parquet", "--out", str(out / "run.parquet")]) == 1
    assert "needs the package pyarrow: 'pip install pyarrow'" in capsys.readouterr().err
    assert cli.run([*arguments, "cvs", "--out", str(out / "run.csv")]) == 2
    assert "did you mean 'csv'" in capsys.readouterr().err
    assert cli.run([*arguments, "csv", "--out", str(out / "no/run.csv")]) == 1
    assert "no such folder" in capsys.readouterr().err
    monkeypatch.setattr("scipy.io.savemat", _fails)
    assert cli.run([*arguments, "mat", "--out", str(out / "run.mat")]) == 1
    assert "No space left" in capsys.readouterr().err
    assert not list(out.iterdir())


def _fails(file, *_, **__):
    file.write(b"half")
    raise OSError(28, "No space left on device")


def test_no_file_is_replaced_unasked(bag, tmp_path, capsys):
    path = tmp_path / "run.csv"
    path.write_text("mine")
    arguments = ["export", str(bag), "--format", "csv", "--out", str(path)]
    assert cli.run(arguments) == 1
    assert "--force replaces it" in capsys.readouterr().err
    assert path.read_text() == "mine"
    assert cli.run([*arguments, "--force"]) == 0
    agree(read_csv(path), bag)
