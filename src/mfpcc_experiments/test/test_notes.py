"""Notes: how much they matter for the exit code, and how they are printed."""

import pytest

from mfpcc_experiments import notes


@pytest.mark.parametrize(
    ("made", "code", "strict"),
    [([], 0, 0), ([notes.info("a")], 0, 0), ([notes.warning("a")], 0, 3),
     ([notes.failure("a")], 3, 3), ([notes.info("a"), notes.failure("b")], 3, 3)],
)  # fmt: skip
def test_the_worst_note_makes_the_exit_code(made, code, strict):
    rows = [{"notes": []}, {"notes": [note.to_json() for note in made]}]
    assert notes.exit_code(rows) == code
    assert notes.exit_code(rows, strict=True) == strict


def test_lines_for_the_terminal():
    row = {"notes": [notes.failure("gates off").to_json(), notes.info("b").to_json()]}
    assert notes.lines([row], ["MBPCC"]) == ["failure: MBPCC: gates off", "info: MBPCC: b"]
