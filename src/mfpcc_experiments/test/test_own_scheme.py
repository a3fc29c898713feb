"""docs/own_scheme.md: its package is made, installed and run, word by word."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from harness import PATIENCE

PAGE = Path(__file__).resolve().parents[3] / "docs" / "own_scheme.md"

RUN = """
import json, sys
import numpy as np
from mfpcc_experiments.running.closed_loop import run

r = run("slow_deadbeat", 0.3, schedule=["0.1 load_torque 5.0"])
switched = run("mls_mfpcc", 0.3, schedule=["0.2 scheme slow_deadbeat"])
back = run("slow_deadbeat", 0.3, schedule=["0.2 scheme mls_mfpcc"])
json.dump(
    {
        "scheme": r.controller.scheme,
        "complaint": r.controller.complaint,
        "mean": float(np.abs(r.error(0.25).mean(axis=0)).max()),
        "lut": r.lut_error(0.25),
        "bump": float(np.ptp(switched.error(0.2), axis=0).max()),
        "bump_back": float(np.ptp(back.error(0.2), axis=0).max()),
    },
    sys.stdout,
)
"""


def block(language: str) -> str:
    """The page's first code block in a language."""
    found = re.search(rf"```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert found is not None
    return found.group(1)


@pytest.fixture(scope="module")
def environment(tmp_path_factory) -> dict[str, str]:
    """Variables of a process that has the page's package installed."""
    source = tmp_path_factory.mktemp("slow_deadbeat")
    (source / "slow_deadbeat.py").write_text(block("python"))
    (source / "pyproject.toml").write_text(block("toml"))
    installed = tmp_path_factory.mktemp("installed")
    # as on the page, but not into the environment that the tests run in
    command = "-m pip install --no-index --no-build-isolation --no-deps -q --target"
    subprocess.run(
        [sys.executable, *command.split(), str(installed), str(source)],
        check=True,
        timeout=PATIENCE,
    )
    path = os.pathsep.join([str(installed), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PYTHONPATH": path}


def python(code: str, environment: dict[str, str]) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        check=False,
        timeout=PATIENCE,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_example_is_about_thirty_lines():
    lines = [line for line in block("python").splitlines() if line.strip()]
    assert len(lines) <= 30


def test_the_example_runs(environment):
    figures = json.loads(python(RUN, environment))
    assert figures["scheme"] == "slow_deadbeat"
    assert figures["complaint"] == ""
    assert figures["mean"] < 0.01
    assert figures["lut"] < 0.2
    assert figures["bump"] < 0.5
    assert figures["bump_back"] < 0.5


def test_the_command_on_the_page_works(environment, tmp_path):
    command = re.search(r"^mfpcc (run .*)$", PAGE.read_text(), re.MULTILINE)
    assert command is not None
    out = tmp_path / "out"
    code = (
        "import sys; from mfpcc_experiments import cli; "
        f"sys.exit(cli.run([*{command.group(1)!r}.split(), '--out', {str(out)!r}]))"
    )
    python(code, environment)
    rows = json.loads((out / "metrics.json").read_text())
    assert [row["scheme"] for row in rows] == ["slow_deadbeat", "mls_mfpcc"]
    assert rows[0]["lost_periods"] == 0
    assert rows[0]["deviation_rms"]["d"] < 0.1
