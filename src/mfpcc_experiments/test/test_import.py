"""Measured files into bags: the same samples, and one sentence for what makes no sense."""

from __future__ import annotations

import csv
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.io import savemat

from mfpcc_experiments import bags, cli
from mfpcc_experiments.importing import ImportFailedError, import_file, load
from mfpcc_experiments.importing.mapping import Map
from mfpcc_experiments.measuring import Samples
from mfpcc_experiments.measuring import replay as replaying
from mfpcc_experiments.running import run
from mfpcc_experiments.running.scenario import Scenario
from pwm_node.yaml_files import FileError, validated

PERIODS = 400


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of our own plant, with steps of load and speed."""
    folder = tmp_path_factory.mktemp("recorded")
    scenario = Scenario.model_validate(
        {
            "name": "short",
            "motor": "seed_750",
            "speed_rpm": 500.0,
            "duration": PERIODS * 1e-4,
            "window_s": [0.01, PERIODS * 1e-4],
            "plant": {"load_torque": 2.0, "noise.current_rms": 0.0245},
            "schedule": [{"at": 0.02, "load_torque": 4.0, "speed_ref_rpm": 600.0}],
        }
    )
    run.run(scenario, "mls_mfpcc", "inprocess", folder, 5, lambda done: None)
    return folder / "mls_mfpcc"


@pytest.fixture(scope="module")
def table(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording as a CSV file."""
    path = tmp_path_factory.mktemp("table") / "table.csv"
    assert cli.run(["export", str(recorded), "--format", "csv", "--out", str(path)]) == 0
    return path


def chart(**changes: Any) -> Map:
    """The map of our own tables, with changes; None takes a key out."""
    values = {**load("mfpcc_export").model_dump(exclude_unset=True), **changes}
    return validated({k: v for k, v in values.items() if v is not None}, Map)


PLAIN: dict[str, Any] = {"vectors": None, "dwell": None, "references": None, "enable": None}


# --- Our own recordings, there and back -----------------------------------------------------------


@pytest.mark.parametrize("form", ["csv", "mat", "parquet"])
def test_a_recording_of_ours_comes_back_bit_for_bit(
    recorded: Path, tmp_path: Path, form: str
) -> None:
    if form == "parquet":
        pytest.importorskip("pyarrow")
    file, out = tmp_path / f"table.{form}", tmp_path / "again"
    assert cli.run(["export", str(recorded), "--format", form, "--out", str(file)]) == 0
    assert cli.run(["import", str(file), "--map", "mfpcc_export", "--out", str(out)]) == 0
    before, after = bags.read(recorded), bags.read(out)
    assert after.T_s == before.T_s
    for name in before.feedback.dtype.names:
        np.testing.assert_array_equal(after.feedback[name], before.feedback[name])
    acted = before.command[before.command["period"] < PERIODS]  # a table has no row for the last
    for name in acted.dtype.names:
        np.testing.assert_array_equal(after.command[name], acted[name])
    np.testing.assert_array_equal(after.lut["i_dq_ref"], before.lut["i_dq_ref"])
    changes = {"motor": "seed_750", "speed_ref_rpm": 500.0}
    for scheme in ("mls_mfpcc", "mbpcc"):
        one = replaying.replay(Samples(before, {"schedule": []}), scheme)
        other = replaying.replay(Samples(after, {**changes, "schedule": []}), scheme)
        np.testing.assert_array_equal(other.error, one.error)
    if form != "csv":  # the configuration came along
        again = Samples(after)
        assert again.why_not_verifiable == ""
        replaying.require_same(again, replaying.verify(again))


def test_what_a_map_says_of_the_controller_is_verified(
    recorded: Path, table: Path, tmp_path: Path
) -> None:
    values = bags.read(recorded).config["parameters"]["mfpcc_controller"]
    import_file(table, chart(controller=values), tmp_path / "bag")
    samples = Samples(bags.read(tmp_path / "bag"))
    replaying.require_same(samples, replaying.verify(samples))
    import_file(
        table, chart(controller={**values, "observer.bandwidth": 300.0}), tmp_path / "other"
    )
    samples = Samples(bags.read(tmp_path / "other"))
    with pytest.raises(replaying.ReplayError, match="does not give its recorded commands"):
        replaying.require_same(samples, replaying.verify(samples))


def test_compare_reads_it_and_claims_no_prediction(
    recorded: Path, table: Path, tmp_path: Path
) -> None:
    from mfpcc_experiments.measuring import evaluate

    import_file(table, chart(motor="seed_750"), tmp_path / "bag")
    row = evaluate(bags.read(tmp_path / "bag"))
    assert row["scheme"] == "measured"
    assert row["lut_error_rms"] in (None, {"d": None, "q": None})
    expected = evaluate(bags.read(recorded), [0.0, PERIODS * 1e-4])
    assert row["deviation_rms"]["q"] == pytest.approx(expected["deviation_rms"]["q"], rel=1e-3)
    assert row["speed_rpm_mean"] == pytest.approx(expected["speed_rpm_mean"], rel=1e-2)


# --- Other people's tables ------------------------------------------------------------------------


def rows_of(table: Path) -> tuple[list[str], list[list[str]]]:
    with table.open(newline="") as file:
        head, *rows = csv.reader(file)
    return head, rows


def write(path: Path, head: list[str], rows: list[list[str]], *, separator: str = ",") -> Path:
    lines = [separator.join(cells) for cells in [head, *rows]]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_decimal_commas_a_preamble_and_a_line_of_units(table: Path, tmp_path: Path) -> None:
    head, rows = rows_of(table)
    text = "\n".join(
        [
            "Model;Scope 12",
            "Date;3.4.",
            ";".join(head),
            ";".join("A" for _ in head),
            *(";".join(cell.replace(".", ",") for cell in row) for row in rows),
        ]
    )
    file = tmp_path / "scope.csv"
    file.write_text("\ufeff" + text, encoding="utf-8")
    result = import_file(file, chart(), tmp_path / "bag")
    import_file(table, chart(), tmp_path / "plain")
    assert any("line 4 is passed over as units" in note for note in result.notes)
    np.testing.assert_array_equal(
        bags.read(tmp_path / "bag").feedback, bags.read(tmp_path / "plain").feedback
    )


def test_columns_by_number_without_a_head(table: Path, tmp_path: Path) -> None:
    head, rows = rows_of(table)
    names = ("time_s", "i_a_A", "i_b_A", "i_c_A", "encoder_angle_rad", "u_dc_V")
    places = [head.index(name) for name in (*names, "duty_a", "duty_b", "duty_c")]
    file = tmp_path / "plain.txt"
    file.write_text("\n".join("\t".join(row[k] for k in places) for row in rows[1:]))
    numbers = {
        "time": 1,
        "currents": {"a": 2, "b": 3, "c": 4},
        "angle": 5,
        "dc_voltage": 6,
        "duties": {"a": 7, "b": 8, "c": 9},
    }
    import_file(file, chart(**PLAIN, **numbers), tmp_path / "bag")
    found, before = bags.read(tmp_path / "bag"), rows[1:]
    assert found.feedback["i_b"].tolist() == [float(row[head.index("i_b_A")]) for row in before]


def test_units_signs_two_currents_counts_and_an_electrical_angle(
    recorded: Path, table: Path, tmp_path: Path
) -> None:
    read = bags.read(recorded)
    head, rows = rows_of(table)
    at = head.index
    columns = {
        "t": [repr(1e3 * float(row[at("time_s")])) for row in rows],
        "ia": [repr(-1e3 * float(row[at("i_a_A")])) for row in rows],
        "ic": [repr(2048 + 100 * float(row[at("i_c_A")])) for row in rows],
        "angle": [
            repr(float(np.degrees(4 * float(row[at("encoder_angle_rad")]) + 0.3) % 360.0))
            for row in rows
        ],
        **{
            leg: [str(2000 * float(row[at(f"duty_{leg}")] or "nan")) for row in rows]
            for leg in "abc"
        },
    }
    file = write(
        tmp_path / "dsp.csv",
        list(columns),
        [list(row) for row in zip(*columns.values(), strict=True)],
    )
    told = {
        "time": {"column": "t", "unit": "ms"},
        "currents": {
            "a": {"column": "ia", "unit": "mA", "scale": -1},
            "c": {"column": "ic", "zero": 2048, "scale": 0.01},
        },
        "angle": None,
        "electrical_angle": {"column": "angle", "unit": "deg"},
        "encoder_zero": 0.3,
        "dc_voltage": {"constant": 311.0},
        "duties": {"a": "a", "b": "b", "c": "c", "full": 2000},
        "pole_pairs": 4,
    }
    result = import_file(file, chart(**PLAIN, **told), tmp_path / "bag")
    found = bags.read(tmp_path / "bag")
    assert any("phase b is not measured" in note for note in result.notes)
    for leg in "ac":
        np.testing.assert_allclose(found.feedback[f"i_{leg}"], read.feedback[f"i_{leg}"], atol=1e-9)
    turned = np.exp(4j * (found.feedback["encoder_angle"] - read.feedback["encoder_angle"]))
    np.testing.assert_allclose(turned, 1.0, atol=1e-9)
    np.testing.assert_allclose(
        found.command["duty"], read.command["duty"][: len(found.command)], atol=1e-9
    )


def synthetic(n: int = 500) -> dict[str, np.ndarray]:
    """A table of a drive that stands still, with a lag between voltage and current."""
    k = np.arange(n)
    u = 3.0 * np.sin(0.31 * k) + 2.0 * np.sign(np.sin(0.05 * k))
    i = np.zeros(n)
    for m in range(n - 1):
        i[m + 1] = i[m] + 1e-4 / 2e-4 * (u[m - 2] * (m >= 2) - 0.4 * i[m])
    return {"t": 1e-4 * k, "i_a": i, "i_b": -i / 2, "u": u, "w": np.full(n, 50.0)}


def test_voltages_a_speed_and_an_estimated_delay(tmp_path: Path) -> None:
    file = tmp_path / "a.mat"
    savemat(file, {"rec": {"data": synthetic()}})
    told = validated(
        {
            "table": "rec.data",
            "time": "t",
            "currents": {"a": "i_a", "b": "i_b"},
            "dc_voltage": {"constant": 24.0},
            "voltages": {"alpha": "u", "beta": {"constant": 0.0}},
        },
        Map,
    )
    result = import_file(file, told, tmp_path / "bag")
    assert any("is, in periods, 2 (it leaves" in note for note in result.notes)
    assert any("counts as standing still" in note for note in result.notes)
    found = bags.read(tmp_path / "bag")
    command = found.command[found.command["period"] == 102][0]
    u = (2 * command["duty"][0] - command["duty"][1] - command["duty"][2]) / 3 * 24.0
    assert u == pytest.approx(synthetic()["u"][100])
    turning = told.model_copy(
        update={"electrical_speed": Map.model_validate({**_LEAST, "electrical_speed": "w"})
                .electrical_speed, "delay": 2}
    )  # fmt: skip
    result = import_file(file, turning, tmp_path / "turning")
    assert any("integrated from the speed" in note for note in result.notes)
    angle = np.unwrap(bags.read(tmp_path / "turning").feedback["encoder_angle"])
    np.testing.assert_allclose(np.diff(angle), 50.0 * 1e-4, rtol=1e-9)


_LEAST: dict[str, Any] = {
    "sample_time": 1e-4,
    "currents": {"a": "i_a", "b": "i_b"},
    "dc_voltage": {"constant": 24.0},
    "voltages": {"alpha": "u", "beta": {"constant": 0.0}},
}


def test_a_sinusoid_does_not_tell_the_delay(tmp_path: Path) -> None:
    k = np.arange(600)
    columns = {"u": np.sin(0.1 * k), "i_a": 3 * np.sin(0.1 * k - 0.9), "i_b": 0.0 * k}
    columns["i_b"] = -columns["i_a"] / 2
    savemat(tmp_path / "a.mat", columns)
    result = import_file(tmp_path / "a.mat", validated(_LEAST, Map), tmp_path / "bag")
    assert any("cannot be told from the data" in note for note in result.notes)


def test_matlab_files_of_version_7_3(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    file = tmp_path / "a.mat"
    with h5py.File(file, "w", userblock_size=512) as stored:
        for name, values in synthetic().items():
            column = stored.create_dataset(f"rec/{name}", data=values[None, :])
            column.attrs["MATLAB_class"] = np.bytes_("double")
        text = stored.create_dataset("title", data=np.frombuffer(b"bench", np.uint8)[:, None])
        text.attrs["MATLAB_class"] = np.bytes_("char")
    with file.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512, b" "))
    told = validated({**_LEAST, "table": "rec", "delay": 0}, Map)
    import_file(file, told, tmp_path / "bag")
    found = bags.read(tmp_path / "bag")
    np.testing.assert_array_equal(found.feedback["i_a"], synthetic()["i_a"])


def test_several_rows_per_period(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", synthetic(600))
    told = validated({**_LEAST, "samples_per_period": 4, "delay": 1}, Map)
    import_file(tmp_path / "a.mat", told, tmp_path / "bag")
    found = bags.read(tmp_path / "bag")
    assert found.T_s == pytest.approx(4e-4)
    np.testing.assert_array_equal(found.feedback["i_a"], synthetic(600)["i_a"][::4])


# --- What makes no sense --------------------------------------------------------------------------


def set_cell(head: list[str], rows: list[list[str]], line: int, name: str, text: str) -> None:
    rows[line - 2][head.index(name)] = text


BAD: list[tuple[Callable[[list[str], list[list[str]]], Any], str]] = [
    (
        lambda head, rows: set_cell(head, rows, 17, "i_a_A", "1.2V"),
        "line 17: column 'i_a_A' holds '1.2V', which is no number",
    ),
    (
        lambda head, rows: set_cell(head, rows, 300, "duty_b", "1_0"),
        "line 300: column 'duty_b' holds '1_0', which is no number",
    ),
    (
        lambda head, rows: set_cell(head, rows, 40, "duty_b", "1.4"),
        "line 40: the duty of leg b is 1.4, and has to be within 0 to 1",
    ),
    (
        lambda head, rows: set_cell(head, rows, 40, "time_s", ""),
        "line 40: the time is no number",
    ),
    (
        lambda head, rows: set_cell(head, rows, 40, "time_s", "0.001"),
        "line 40: the time does not rise",
    ),
    (
        lambda head, rows: [
            set_cell(head, rows, k, "time_s", repr(0.0148 + (k - 150) * 1.5e-4))
            for k in range(150, 402)
        ],
        "line 151: the sample time changes from 100 us to 150 us",
    ),
    (
        lambda head, rows: [
            set_cell(head, rows, k, "time_s", repr(0.0148 + (k - 150) * 1.05e-4))
            for k in range(150, 402)
        ],
        "the sample time changes from 100 us to 10",
    ),
    (lambda head, rows: rows[88].__delitem__(slice(4, None)), "line 90 has 4 cells, too few"),
    (
        lambda head, rows: head.__setitem__(head.index("i_b_A"), "i_bb"),
        "there is no column 'i_b_A'",
    ),
    (lambda head, rows: rows.clear(), "there are no rows"),
]


@pytest.mark.parametrize(("spoil", "sentence"), BAD)
def test_what_makes_no_sense_is_said_with_its_line(
    table: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    spoil: Callable[[list[str], list[list[str]]], Any],
    sentence: str,
) -> None:
    head, rows = rows_of(table)
    spoil(head, rows)
    file = write(tmp_path / "bad.csv", head, rows)
    out = tmp_path / "out" / "bag"
    assert cli.run(["import", str(file), "--map", "mfpcc_export", "--out", str(out)]) == 1
    said = capsys.readouterr().err
    assert sentence in said
    assert said.strip().splitlines()[-1].startswith(f"mfpcc: {file}: ")
    assert not out.exists() and not list(tmp_path.glob("out/.*"))


def test_gaps_and_empty_cells_are_lost_periods(table: Path, tmp_path: Path) -> None:
    head, rows = rows_of(table)
    set_cell(head, rows, 52, "i_a_A", "NaN")
    set_cell(head, rows, 53, "i_a_A", "")
    del rows[198:201]
    file = write(tmp_path / "gaps.csv", head, rows)
    result = import_file(file, chart(), tmp_path / "bag")
    assert "3 rows are missing, the first before line 200: these periods are lost" in result.notes
    assert any("2 of 397 rows lack a value, the first is line 52" in n for n in result.notes)
    found = bags.read(tmp_path / "bag")
    missing = set(range(PERIODS)) - set(found.feedback["period"].tolist())
    assert missing == {50, 51, 198, 199, 200}
    assert found.lost_periods == len(missing)


def test_decimal_commas_between_commas(table: Path, tmp_path: Path) -> None:
    head, rows = rows_of(table)
    file = write(
        tmp_path / "bad.csv", head, [[cell.replace(".", ",") for cell in row] for row in rows]
    )
    with pytest.raises(ImportFailedError, match=r"line 2 has \d+ cells.*semicolons"):
        import_file(file, chart(), tmp_path / "bag")
    head, rows = rows_of(table)
    rows = [[cell.replace(".", ",") for cell in row] for row in rows]
    set_cell(head, rows, 300, "i_a_A", "1.5")
    file = write(tmp_path / "mixed.csv", head, rows, separator=";")
    with pytest.raises(ImportFailedError, match=r"line 300.*decimal point, while other lines"):
        import_file(file, chart(), tmp_path / "bag")


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.csv", b"", "the file is empty"),
        ("a.csv", b"\x00\x01\x02" * 100, "zero bytes"),
        ("a.csv", b"x" * (1 << 21), "longer than"),
        ("a.mat", b"no MATLAB", "is no MATLAB file"),
        ("a.mat", b"MATLAB 7.3 MAT-file" + b" " * 200, "7.3|no MATLAB"),
        ("a.parquet", b"PAR1 nothing", "Parquet"),
        ("a.xlsx", b"", "unknown ending '.xlsx'"),
    ],
)
def test_files_of_another_kind(tmp_path: Path, name: str, content: bytes, sentence: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ImportFailedError, match=sentence):
        import_file(tmp_path / name, chart(), tmp_path / "bag")
    with pytest.raises(ImportFailedError, match="no such file"):
        import_file(tmp_path / "none.csv", chart(), tmp_path / "bag")


def test_matlab_columns_of_other_lengths_and_matrices(tmp_path: Path) -> None:
    columns = synthetic()
    savemat(tmp_path / "a.mat", {**columns, "u": columns["u"][:-1]})
    with pytest.raises(ImportFailedError, match="'u' 499: these are not columns of one table"):
        import_file(tmp_path / "a.mat", validated(_LEAST, Map), tmp_path / "bag")
    savemat(tmp_path / "b.mat", {**columns, "u": np.zeros((250, 2))})
    with pytest.raises(ImportFailedError, match="'u' is a matrix of 250 x 2"):
        import_file(tmp_path / "b.mat", validated(_LEAST, Map), tmp_path / "bag")
    told = validated({**_LEAST, "table": "rek"}, Map)
    savemat(tmp_path / "c.mat", {"rec": columns})
    with pytest.raises(ImportFailedError, match="unknown structure 'rek'; did you mean 'rec'"):
        import_file(tmp_path / "c.mat", told, tmp_path / "bag")


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"currents": {"a": "i_a"}}, "at least two of a, b, c are needed"),
        ({"time": None}, "one of 'time' and 'sample_time' is needed"),
        ({"electrical_angle": "x"}, "at most one of 'angle' and 'electrical_angle'"),
        ({"angle": {"column": "x", "unit": "grad"}}, "unknown unit 'grad'; did you mean 'rad'"),
        ({"angle": {"column": "x", "scale": 0}}, "nothing would be left"),
        ({"curents": {}}, "unknown key 'curents'; did you mean 'currents'"),
        ({"motor": "seed_75"}, "unknown motor 'seed_75'; did you mean 'seed_750'"),
        ({"voltages": {"a": "u"}}, "a, b, c are needed, or alpha, beta, or d, q"),
    ],
)
def test_maps_that_make_no_sense(tmp_path: Path, changes: dict[str, Any], sentence: str) -> None:
    values = {**load("mfpcc_export").model_dump(exclude_unset=True), **changes}
    values = {key: value for key, value in values.items() if value is not None}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(values))
    with pytest.raises(FileError) as error:
        load(str(tmp_path / "map.yaml"))
    assert sentence in str(error.value)


def test_nothing_is_overwritten(table: Path, tmp_path: Path) -> None:
    import_file(table, chart(), tmp_path / "bag")
    with pytest.raises(bags.BagError, match="--force"):
        import_file(table, chart(), tmp_path / "bag")
    bad = tmp_path / "bad.csv"
    text = table.read_text()
    bad.write_text(text[: text.rstrip().rindex("\n") + 12])
    with pytest.raises(ImportFailedError):
        import_file(bad, chart(), tmp_path / "bag", force=True)
    assert len(bags.read(tmp_path / "bag").feedback) == PERIODS  # what was there stays


def test_memory_does_not_grow_with_the_file(table: Path, tmp_path: Path) -> None:
    """The rows of a large file are never in memory together."""
    head, rows = rows_of(table)
    file, n = tmp_path / "long.csv", 60_000
    keep = [head.index(c) for c in ("i_a_A", "i_b_A", "i_c_A", "encoder_angle_rad", "u_dc_V")]
    keep += [head.index(f"duty_{leg}") for leg in "abc"]
    with file.open("w") as stream:
        stream.write(",".join(["time_s", *(head[k] for k in keep)]) + "\n")
        for k in range(n):
            row = rows[1 + k % (len(rows) - 1)]
            stream.write(",".join([f"{k * 1e-4:.4f}", *(row[place] for place in keep)]) + "\n")
    tracemalloc.start()
    try:
        result = import_file(file, chart(**PLAIN), tmp_path / "bag")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert result.samples == n
    assert peak < 2 * file.stat().st_size  # 10,000 rows at once; all of them take five times it
