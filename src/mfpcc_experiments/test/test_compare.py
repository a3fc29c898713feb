"""Comparing recordings: the contract of metrics.json, the table, the figures and the report."""

import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from harness import PATIENCE

from mfpcc_experiments.bags import BagError, recording
from mfpcc_experiments.measuring import METRICS, evaluate, happened, measured, signals, window
from mfpcc_experiments.paper import runs
from mfpcc_experiments.reporting import STYLE, compare, figures, report, table, traces
from mfpcc_experiments.running import scenario

CONTRACT = {
    "experiment": None,
    "scheme": None,
    "motor": None,
    "engine": None,
    "seed": None,
    "periods": None,
    "lost_periods": None,
    "window_s": None,
    "thd_percent": {"control", "oversampled"},
    "ripple_pp": {"d", "q", "d_oversampled", "q_oversampled"},
    "ripple_rms": {"d", "q"},
    "lut_error_max": {"d", "q"},
    "lut_error_rms": {"d", "q"},
    "i_d_mean": None,
    "i_q_error_mean": None,
    "speed_rpm_mean": None,
    "step_time_us": {"median", "p99"},
}


@pytest.fixture(scope="module")
def bags(tmp_path_factory, write_bag, drive_messages) -> list[Path]:
    folder = tmp_path_factory.mktemp("bags")
    return [
        write_bag(
            folder / name,
            config=config(scheme=name),
            source=drive_messages(4000, oversampling=4, scheme=name),
            oversampling=4,
        )
        for name in ("mbpcc", "mls_mfpcc")
    ]


@pytest.fixture(scope="module")
def compared(bags, tmp_path_factory) -> tuple[Path, list[dict], list[float]]:
    """A folder of results, the rows and what the progress bar was told."""
    out = tmp_path_factory.mktemp("compared") / "out"
    told: list[float] = []
    return out, compare.compare(bags, out, progress=told.append), told


def config(**changes: object) -> dict:
    known = {"experiment": "synthetic", "scheme": "x", "motor": "m", "engine": "ros", "seed": 1}
    return {**known, "T_s": 1e-4, "n_p": 4, "window_s": [0.1, 0.3], **changes}


class Page(HTMLParser):
    """Tags of a page, what it refers to, and its visible text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.references: list[str] = []
        self.text = ""
        self._inside = ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self._inside = tag
        self.references += [v for k, v in attributes if k in ("src", "href", "srcset", "action")]

    def handle_endtag(self, tag):
        self._inside = ""

    def handle_data(self, data):
        if self._inside not in ("script", "style"):
            self.text += data


def test_a_folder_of_results(compared):
    out, rows, told = compared
    assert json.loads((out / "metrics.json").read_text()) == rows
    for row, scheme in zip(rows, ("mbpcc", "mls_mfpcc"), strict=True):
        assert row["scheme"] == scheme
        for key, keys in CONTRACT.items():
            assert key in row
            assert keys is None or set(row[key]) >= keys
    names = {"phase_currents", "i_dq", "lut_error", "spectrum", "speed_torque"}
    for ending, begin in ((".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")):
        pictures = {path.stem: path for path in (out / "figures").glob(f"*{ending}")}
        assert set(pictures) == names
        assert all(path.read_bytes().startswith(begin) for path in pictures.values())
    assert len(list((out / "figures").iterdir())) == 3 * len(names)
    assert told == sorted(told) and told[-1] == 1.0
    assert {path.name for path in out.iterdir()} == {"metrics.json", "report.html", "figures"}


def test_the_report_needs_nothing_but_itself(compared):
    out, _, _ = compared
    text = (out / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.references and all(r.startswith("data:image/png;base64,") for r in page.references)
    assert "link" not in page.tags and "iframe" not in page.tags
    assert not re.search(r"https?://|@import|url\(", text)
    assert "default-src 'none'" in text
    assert "MLS-MFPCC" in page.text and "2.00" in page.text
    assert str(out.parent) not in text


@pytest.mark.usefixtures("no_vectors")
def test_text_from_recordings_is_escaped(make_bag, tmp_path):
    evil = "</script><script>alert(1)</script><img src=x onerror=alert(2)>[bold]$x_$"
    paths = [
        make_bag(name, 3500, config=config(scheme=evil, experiment=evil, motor=evil, note=evil))
        for name in ("one", "two")
    ]
    rows = compare.compare(paths, tmp_path / "out")
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.tags.count("script") == 2
    assert all(reference.startswith("data:") for reference in page.references)
    assert "<img src=x" not in text and "</script><script>alert" not in text
    table.print_table(rows)


@pytest.mark.usefixtures("no_vectors")
def test_figures_of_recordings_that_lack_topics(make_bag, drive_messages, tmp_path):
    only = ("phase_feedback", "duty_command")
    source = (m for m in drive_messages(3500) if m[0] in only)
    bare = make_bag("bare", source=source, config=config())
    rows = compare.compare([bare, make_bag("full", 3500, oversampling=4)], tmp_path / "out")
    assert rows[0]["lut_error_max"] is None and rows[0]["torque_mean"] is None
    assert rows[0]["i_d_mean"] == pytest.approx(0.2, abs=1e-3)
    compare.compare([bare], tmp_path / "alone")
    names = {path.stem for path in (tmp_path / "alone" / "figures").iterdir()}
    assert names == {"phase_currents", "i_dq", "spectrum"}


def test_lines_of_one_panel_are_told_apart_in_a_grey_print(bags):
    with mpl.rc_context(STYLE):
        figure = figures.phase_currents(compare.measure(bags))
    for axis in figure.axes:
        assert len({line.get_marker() for line in axis.lines}) == len(axis.lines) == 3
        begins = [line.get_markevery()[0] for line in axis.lines]
        assert len(set(begins)) == 3  # marks do not cover each other


def test_vector_figures_are_vectors_and_the_same_each_time(bags, compared, tmp_path):
    out, _, _ = compared
    compare.compare(bags, tmp_path / "again")
    for path in sorted((out / "figures").iterdir()):
        assert path.read_bytes() == (tmp_path / "again/figures" / path.name).read_bytes(), path
    drawing = ElementTree.parse(out / "figures/i_dq.svg").getroot()
    tags = {element.tag.rpartition("}")[2] for element in drawing.iter()}
    assert "path" in tags and "image" not in tags
    assert b"/Subtype /Image" not in (out / "figures/i_dq.pdf").read_bytes()


def test_phase_currents_have_the_time_of_the_run(bags):
    (run,) = compare.measure(bags[:1], window_s=(0.15, 0.25))
    (axis,) = figures.phase_currents([run]).axes
    # two periods of 50 Hz from the begin of the window on
    assert axis.get_xlim() == pytest.approx((0.15, 0.19), abs=1e-3)
    assert "(s)" in axis.get_xlabel()
    time, current = axis.lines[0].get_data()
    assert np.array_equal(current, run.window.fine_abc[: len(time), 0])
    np.testing.assert_allclose(time, 0.15 + np.arange(len(time)) * 1e-4 / 4, atol=1e-9)


def test_what_lut_error_is_stands_where_it_comes_first(compared, capsys):
    out, rows, _ = compared
    text = Page((out / "report.html").read_text(encoding="utf-8")).text
    assert 0 < text.index("Prediction error") < text.index("measured minus predicted current")
    assert text.index("measured minus predicted current") < text.index("Prediction error q")
    table.print_table(rows)
    assert "Prediction error: measured minus predicted current" in capsys.readouterr().out


@pytest.mark.usefixtures("no_vectors")
def test_changes_of_a_run_are_told_with_its_figures(make_bag, tmp_path):
    bag_ = make_bag(config=config(scenario={"changes": {"mls.window": 10, "duration": 0.3}}))
    (row,) = compare.compare([bag_], tmp_path / "out")
    text = "not as the experiment says: mls.window = 10, duration = 0.3"
    assert {"severity": "info", "text": text} in row["notes"]
    assert text in (tmp_path / "out/report.html").read_text()


@pytest.mark.usefixtures("no_vectors")
def test_another_window_than_the_recorded_one(bags, tmp_path):
    (row, *_) = compare.compare(bags[:1], tmp_path / "out", window_s=(0.15, 0.25))
    assert row["window_s"] == [0.15, 0.25]
    page = (tmp_path / "out/report.html").read_text()
    assert "evaluated from 0.15 to 0.25 s" in page
    for other in ((0.2, 7.0), (5.0, 6.0)):  # said of 100 periods, it would not be true
        with pytest.raises(window.MetricsError, match="cannot be evaluated"):
            compare.compare(bags[:1], tmp_path / "other", window_s=other)
    assert not (tmp_path / "other").exists()


def test_nothing_is_written_if_a_recording_is_no_good(bags, tmp_path):
    with pytest.raises(BagError):
        compare.compare([*bags, tmp_path / "missing"], tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with pytest.raises(BagError, match="no recordings"):
        compare.compare([], tmp_path / "out")


def test_the_table_in_the_terminal(compared, capsys):
    table.print_table(compared[1])
    lines = capsys.readouterr().out.splitlines()
    assert re.search(r"MBPCC +MLS-MFPCC", lines[0])
    assert re.search(r"THD, oversampled +2\.00 +2\.00 +%", lines[1])


def test_a_table_too_wide_for_the_terminal_goes_on_below(compared, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    schemes = ["mbpcc", "mbpcc_single_vector", "neso_mfpcc", "mfpcc_two_vector", "mls_mfpcc"]
    rows = [{**compared[1][0], "scheme": s, "setup": n} for n, s in enumerate(schemes)]
    table.print_table(rows)
    text = capsys.readouterr().out
    shown = text[: text.index("info:")]  # a note stays on its line
    assert max(len(line.rstrip()) for line in shown.splitlines()) <= 80
    for scheme in schemes:
        assert happened.scheme_title(scheme) in text
    assert len(re.findall(r"THD, oversampled( +2\.00)+ +%", text)) == 2


@pytest.mark.parametrize(
    ("number", "shown"),
    [(None, "–"), (0.0, "0.000"), (1.8123, "1.81"), (19.02, "19.0"), (0.19739, "0.197"),
     (-0.0456, "-0.046"), (749.99, "750.0"), (0, "0"), (12, "12")],
)  # fmt: skip
def test_three_digits(number, shown):
    assert table.texts([number])[0] == shown


def test_labels_tell_recordings_apart():
    def row(**changes):
        return {"scheme": "mfpcc", "experiment": "a", "motor": "m", "engine": "ros", "seed": 0,
                **changes}  # fmt: skip

    def names(*rows, paths=("x", "y")):
        return measured.labels(rows, [Path(p) for p in paths])

    assert names(row(), row(scheme="mls_mfpcc")) == ["MFPCC", "MLS-MFPCC"]
    assert names(row(), row(experiment="b")) == ["MFPCC, a", "MFPCC, b"]
    assert names(row(), row(seed=3)) == ["MFPCC, seed 0", "MFPCC, seed 3"]
    assert names(row(), row()) == ["MFPCC, x", "MFPCC, y"]
    assert names(row(), row(), paths=("x", "x")) == ["MFPCC, x (1)", "MFPCC, x (2)"]


def test_only_differences_beyond_chance_are_marked():
    low, high = [1.0, 1.1, 0.9, 1.05, 0.95], [1.5, 1.6, 1.4, 1.55, 1.45]
    alike = [v + 0.02 for v in low]
    assert table.best([low, alike]) == [False, False]
    assert table.best([high, low]) == [False, True]
    assert table.best([alike, high, low]) == [True, False, True]
    assert table.best([[0, 0], [3, 3]]) == [True, False]  # the noise does not matter
    # a single run has no scatter, however far it is away; nor has one of which figures are missing
    assert table.best([[1.0], [9.0]]) == [False, False]
    assert table.best([[0.1], low, high]) == [False, True, False]
    assert table.best([low, [*high[:4], None]]) == [False, False]
    assert table.best([low, [None]]) == [False, False]


METRIC_PATHS = [m.path for m in METRICS if m.in_table and m.less_is_better]


@pytest.fixture(scope="module")
def seeds():
    """Figures of 80 seeds of a scheme that falls into limit cycles, one row per figure."""
    wanted = scenario.load("steady_750_2")
    wanted = wanted.model_copy(update={"duration": 0.2, "window_s": (0.1, 0.2)})
    rows = [evaluate(runs.simulate(wanted, "mfpcc", seed)) for seed in range(80)]
    values = np.array([[table.value(row, path) for row in rows] for path in METRIC_PATHS], float)
    return values[np.isfinite(values).all(axis=1)]


def test_runs_that_differ_by_chance_alone_are_hardly_ever_marked(seeds):
    """250 pairs of five seeds of one scheme: of each figure 1 % may be marked, nominally."""
    rng = np.random.default_rng(5)
    assert len(seeds) > 8
    marked = np.zeros((len(seeds), 250))
    for n in range(250):
        pick = rng.permutation(seeds.shape[1])[:10]
        for k, figure in enumerate(seeds[:, pick]):
            marked[k, n] = any(table.best([figure[:5].tolist(), figure[5:].tolist()]))
    assert marked.mean() < 0.015  # over all figures
    assert marked.mean(axis=1).max() <= 0.036  # four standard deviations of 250 at 1 %


def test_chance_has_the_nominal_rate_and_true_differences_are_found():
    rng = np.random.default_rng(3)
    values = rng.normal(1.0, 0.05, (1000, 3, 6))
    rate = np.mean([any(table.best(each.tolist())) for each in values])
    assert 0.001 < rate <= 0.01 + 3 * (0.01 * 0.99 / 1000) ** 0.5
    values[:, 1] *= 0.8
    found = [table.best(each.tolist()) == [False, True, False] for each in values[:100]]
    assert np.mean(found) > 0.7


@pytest.mark.usefixtures("no_vectors")
def test_seeds_of_one_setup_are_one_column(make_bag, tmp_path):
    """In a folder of results, with one configuration but for the seed."""

    def bag(name, seed, **changes):
        parameters = {"pmsm_sim": {"seed": seed, **changes}}
        return make_bag(name, 3500, config=config(seed=seed, parameters=parameters))

    paths = [bag("a/0", 0), bag("a/1", 1), bag("a/again", 1), bag("a/x", 2, load_torque=3.0)]
    paths += [bag("b/2", 2)]
    rows = compare.compare(paths, tmp_path / "out")
    assert [row["setup"] for row in rows] == [0, 0, 1, 2, 3]
    assert table.titles(rows)[0] == "X -> MLS-MFPCC, 1 (2 seeds)"
    for line in table.lines(rows):
        assert len(line.cells) == 4 and line.best == [False] * 4
    thd = next(line for line in table.lines(rows) if line.metric.key == "thd_percent.control")
    assert re.fullmatch(r"[\d.]+ ± 0\.0+", thd.cells[0]) and "±" not in thd.cells[1]
    rows[1]["thd_percent"]["control"] = None
    thd = next(line for line in table.lines(rows) if line.metric.key == "thd_percent.control")
    assert thd.cells[0] == "1 of 2 seeds"
    page = Page((tmp_path / "out" / "report.html").read_text(encoding="utf-8")).text
    assert "no best is marked" in table.legend(rows) and "No best is marked" in page
    assert "first seed of each" in page


def test_traces_hold_the_signal_to_a_screens_resolution():
    values = np.linspace(-3.0, 5.0, 1000, dtype=np.float32)
    values[10] = np.nan
    part = traces._packed(0.0, 1e-4, values)
    import base64

    whole = np.frombuffer(base64.b64decode(part["data"]), "<i2")
    assert whole[10] == -32768
    restored = part["low"] + (whole + 32767.0) * part["scale"]
    restored[10] = np.nan
    assert np.nanmax(np.abs(restored - values)) < 8.0 / 65000


def test_long_traces_keep_their_extremes_and_the_window():
    values = np.zeros(1_000_000, dtype=np.float32)
    values[123_456] = 7.0  # one period in 100 s
    coarse, fine = traces._segments(signals.Signal(0.0, 1e-4, values), 50.0, 50.2)
    assert coarse["pairs"] and coarse["low"] + 65534 * coarse["scale"] == pytest.approx(7.0)
    assert coarse["dt"] * traces.FULL / 2 >= 100.0
    assert (fine["t0"], fine["dt"], fine["pairs"]) == (50.0, 1e-4, False)


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_the_viewers_program_is_sound(tmp_path):
    program = Path(report.__file__).parent / "templates" / "viewer.js"
    subprocess.run(["node", "--check", program], check=True, timeout=PATIENCE)


def test_window_of_a_long_recording_is_all_that_is_kept(make_bag):
    found = recording.read(make_bag(oversampling=4))
    w = window.cut(found)
    assert len(w.time) == 2000 and len(w.fine_time) == 8000
