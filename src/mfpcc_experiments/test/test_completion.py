"""A Tab completes what there is: in a real bash, as setup.bash sets it up."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix
from harness import PATIENCE

SCRIPT = Path(get_package_prefix("mfpcc_experiments")).parent / "mfpcc.completion.bash"


def offered(*words: str) -> list[str]:
    """What bash offers for the last of some words, which it has split as it does at `=`."""
    quoted = " ".join(f"'{word}'" for word in words)
    script = (
        f"source '{SCRIPT}'; COMP_WORDS=({quoted}); COMP_CWORD={len(words) - 1}; "
        "$(complete -p mfpcc | sed -E 's/.*-F ([^ ]+).*/\\1/') mfpcc; "
        "printf '%s\\n' \"${COMPREPLY[@]}\""
    )
    done = subprocess.run(
        ["bash", "-c", script], capture_output=True, text=True, timeout=PATIENCE, env=os.environ
    )
    assert "Traceback" not in done.stderr
    return done.stdout.split()


@pytest.mark.skipif(not SCRIPT.exists(), reason="this workspace was built without the set-up")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["mfpcc", "rep"], ["replay", "reproduce"]),
        (["mfpcc", "run", "steady_7"], ["steady_750_2", "steady_750_5"]),
        (["mfpcc", "run", "steady_750_2", "--scheme", "pi"], ["pi_foc"]),
        (["mfpcc", "run", "steady_750_2", "--scheme", "=", "neso"], ["neso_mfpcc"]),
        (["mfpcc", "run", "steady_750_2", "--sep"], ["--separate"]),
        (["mfpcc", "run", "steady_750_2", "--engine", "r"], ["ros"]),
        (["mfpcc", "run", "steady_750_2", "--set", "motor", "=", "seed"], ["seed_750"]),
        (["mfpcc", "run", "steady_750_2", "--set", "motor=seed"], ["motor=seed_750"]),
    ],
)
def test_tab_offers(words, expected):
    assert offered(*words) == expected
