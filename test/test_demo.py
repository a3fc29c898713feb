"""`make demo`: three schemes over a real graph, recorded, compared, and the figures in bounds."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
from domains import own_domain
from harness import PATIENCE


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo's results."""
    out = tmp_path_factory.mktemp("demo") / "out"
    schemes = [word for name in ("mbpcc", "mfpcc", "mls_mfpcc") for word in ("--scheme", name)]
    with own_domain():
        done = subprocess.run(
            ["mfpcc", "run", "steady_750_2", *schemes, "--out", str(out)],
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
    assert done.returncode == 0, done.stdout + done.stderr
    assert str(out / "report.html") in done.stdout
    return out


@pytest.fixture(scope="module")
def rows(folder: Path) -> dict[str, dict[str, Any]]:
    return {row["scheme"]: row for row in json.loads((folder / "metrics.json").read_text())}


def test_every_run_is_on_the_real_graph_and_whole(rows: dict[str, dict[str, Any]]) -> None:
    assert list(rows) == ["mbpcc", "mfpcc", "mls_mfpcc"]
    for row in rows.values():
        assert row["engine"] == "ros"
        assert row["lost_periods"] == 0
        assert row["periods"] == 4000


def test_mls_mfpcc_is_as_good_as_the_model_without_one(rows: dict[str, dict[str, Any]]) -> None:
    mls, model = rows["mls_mfpcc"], rows["mbpcc"]
    assert mls["thd_percent"]["oversampled"] <= 1.10 * model["thd_percent"]["oversampled"]
    assert max(mls["lut_error_max"].values()) <= 0.30
    assert max(mls["ripple_pp"]["d"], mls["ripple_pp"]["q"]) <= 0.30


def test_the_conventional_scheme_has_the_ripple_that_was_published(
    rows: dict[str, dict[str, Any]],
) -> None:
    assert 13.0 <= rows["mfpcc"]["thd_percent"]["oversampled"] <= 22.0


def test_the_readme_shows_these_figures(rows: dict[str, dict[str, Any]]) -> None:
    readme = (Path(__file__).parents[1] / "README.md").read_text()
    for title, axes, figure in (
        ("THD of the phase current, oversampled", ["oversampled"], "thd_percent"),
        ("ripple of i_d / i_q, peak to peak", ["d", "q"], "ripple_pp"),
        ("largest prediction error d / q", ["d", "q"], "lut_error_max"),
    ):
        (line,) = re.findall(rf"^\| {re.escape(title)} \|(.*)\|$", readme, re.MULTILINE)
        for cell, row in zip(line.split("|"), rows.values(), strict=True):
            shown = [float(number) for number in re.findall(r"[\d.]+", cell)]
            # rounded; and the single-vector limit cycle depends on the last digit of a sine
            assert shown == pytest.approx([row[figure][axis] for axis in axes], rel=0.1), title


def test_everything_promised_is_there(folder: Path) -> None:
    assert (folder / "report.html").stat().st_size > 10_000
    assert len(list((folder / "figures").glob("*.png"))) >= 4
    for scheme in ("mbpcc", "mfpcc", "mls_mfpcc"):
        assert (folder / scheme / "metadata.yaml").is_file()


def test_nothing_is_overwritten_without_force(folder: Path) -> None:
    before = (folder / "metrics.json").read_bytes()
    again = subprocess.run(
        ["mfpcc", "run", "steady_750_2", "--out", str(folder)],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert again.returncode != 0
    assert "--force" in again.stderr and "Traceback" not in again.stderr
    assert (folder / "metrics.json").read_bytes() == before
