"""The report of a sweep tells what its rows hold."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import yaml

pytest.importorskip("pyarrow")

from mfpcc_experiments.sweeping import folder as folders
from mfpcc_experiments.sweeping import report, work
from mfpcc_experiments.sweeping.plan import Plan
from mfpcc_experiments.sweeping.rows import (
    Rows,
    axis,
    by_cell,
    front,
    interval,
    share_by_cell,
    worst,
)
from mfpcc_experiments.sweeping.spec import load


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("sweep")
    content = {
        "experiment": "steady_750_2",
        "set": {"duration": 0.05, "window_s": [0.02, 0.05], "oversampling": 0},
        "schemes": ["mls_mfpcc", "mbpcc"],
        "vary": {
            "mismatch.inductance": {"uniform": [0.2, 5.0]},
            "mismatch.flux": {"log_uniform": [0.1, 3.0]},
            "load_torque": [0.0, 1.0, 3.0],
        },
        "runs": 40,
        "survived": {"i_peak_over_limit": 1.2, "deviation_rms.q": 0.5},
    }
    (path / "spec.yaml").write_text(yaml.safe_dump(content))
    made = folders.begin(
        path / "out", Plan(load(path / "spec.yaml")), work.fingerprint(), resume=False
    )
    for job in work.jobs(made.plan):
        made.keep(job.number, job.run())
    return made


def test_statistics_of_cells_are_those_of_their_rows():
    rng = np.random.default_rng(1)
    cell, values = rng.integers(0, 7, 500), rng.normal(size=500)
    cell[cell == 3] = 4  # one is empty
    values[rng.random(500) < 0.2] = np.nan
    good = rng.random(500) < 0.3
    for k in range(7):
        mine = np.abs(values[(cell == k) & np.isfinite(values)])
        expected = (np.median(mine), mine.max()) if mine.size else (np.nan, np.nan)
        for statistic, figure in zip(("median", "worst"), expected, strict=True):
            found = by_cell(cell, 7, values, statistic)[k]
            assert found == figure or (np.isnan(found) and np.isnan(figure))
        share = share_by_cell(cell, 7, good)[k]
        assert np.isnan(share) if k == 3 else share == good[cell == k].mean()


def test_interval_of_a_share():
    # Wilson's interval as SciPy has it
    from scipy.stats import binomtest

    for good, n in ((0, 10), (7, 10), (998, 1000), (1000, 1000)):
        expected = binomtest(good, n).proportion_ci(method="wilson")
        assert interval(good, n) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_a_front_is_what_nothing_beats():
    x, y = np.array([1.0, 2.0, 3.0, 3.0, np.nan]), np.array([3.0, 2.0, 2.5, 2.0, 1.0])
    assert front(x, y).tolist() == [True, True, False, False, False]


def test_axes_have_all_values_within(folder):
    rows, spaces = Rows(folder), folder.plan.spec.spaces
    for name in spaces:
        values = rows[name]
        each = axis(name, spaces[name], values, 24)
        cell = each.cell_of(values)
        low, high = each.edges[cell], each.edges[cell + 1]
        assert ((low <= values) & (values <= high)).all()
    assert axis("load_torque", spaces["load_torque"], rows["load_torque"], 24).labels == (
        "0",
        "1",
        "3",
    )


def test_the_page_tells_the_rows_and_needs_nothing_but_itself(folder):
    rows = Rows(folder)
    text = report.write(folder).read_text()
    assert not re.search(r"(src|href)=\"(?!data:)", text)
    assert "://" not in text
    for scheme, title in (("mls_mfpcc", "MLS-MFPCC"), ("mbpcc", "MBPCC")):
        part = rows.of(scheme)
        assert set(rows["scheme"][part]) == {scheme}
        share = f"{100.0 * rows.survived[part].mean():.2f}"
        assert re.search(rf"<th scope=\"row\">{title}</th><td>{share}</td>", text)
    first = worst(rows, 1)[0]
    assert not rows.survived[first]
    lost = ~rows.survived
    assert rows["i_peak_over_limit"][first] == rows["i_peak_over_limit"][lost].max()
    assert f"mfpcc run --from {folder.path} --row {first}" in text
    assert text.count("mfpcc run --from") == 10

    data = json.loads(re.search(r"id=\"data\">(.*?)</script>", text, re.S)[1])
    assert [each["name"] for each in data["axes"]] == list(folder.plan.spec.vary)
    assert data["axes"][0]["name"] == "load_torque" and data["axes"][2]["name"] == (
        "mismatch.inductance"
    )
    shares = data["cells"]["0,2,MBPCC,share that survived"]
    cells = len(data["axes"][2]["edges"]) - 1
    ratio = rows["mismatch.inductance"]
    along = (ratio - ratio.min()) / (ratio.max() - ratio.min())
    cell = np.minimum((cells * along).astype(int), cells - 1)
    mine = np.zeros(folder.plan.rows, np.bool_)
    mine[rows.of("mbpcc")] = True
    for x in range(cells):
        for y, torque in enumerate((0.0, 1.0, 3.0)):
            here = mine & (cell == x) & (rows["load_torque"] == torque)
            expected = rows.survived[here].mean() if here.any() else None
            found = shares[y * cells + x]
            assert found == (None if expected is None else pytest.approx(expected, abs=6e-4))
    assert {path.suffix for path in (folder.path / "figures").iterdir()} == {".png"}
