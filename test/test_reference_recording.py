"""The reference recording in `bags/`: every scheme answers its samples as it did when recorded."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mfpcc_controller.parameters import SCHEMES
from mfpcc_experiments.bags import recording
from mfpcc_experiments.bags.recording import Recording
from mfpcc_experiments.measuring import happened, metrics, replay

FOLDER = Path(__file__).resolve().parent.parent / "bags" / "reference"
ANEW = "mfpcc run bags/reference.yaml --engine inprocess --out bags/reference --force"

# Sines of another machine's mathematical library may differ in their last digit.
ROUNDING = 1e-9


def read(scheme: str) -> Recording:
    bag = FOLDER / scheme
    assert bag.is_dir(), f"scheme '{scheme}' is not in the reference recording; record it: {ANEW}"
    return recording.read(bag)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_scheme_gives_its_recorded_commands_and_predictions(scheme: str) -> None:
    samples = replay.Samples(read(scheme))
    assert samples.why_not_verifiable == ""
    assert samples.answered.all()
    own = replay.verify(samples)
    duty = np.abs(own.duty - samples.duty).max(axis=1)
    error = np.abs(own.error - samples.recording.lut["prediction_error"]).max(axis=1)
    for what, difference in (("command", duty), ("prediction", error)):
        rows = np.flatnonzero(~(difference <= ROUNDING))
        assert len(rows) == 0, (
            f"{scheme}: the {what} of sample {samples.feedback['period'][rows[0]]} is another than "
            f"recorded. If that is meant, record anew: {ANEW}"
        )


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_recording_is_whole_and_measures_as_before(scheme: str) -> None:
    found = read(scheme)
    assert found.notes == []
    assert found.lost_periods == 0
    assert happened.history(found).scheme_in(0, 1000) == scheme
    rows = {row["scheme"]: row for row in json.loads((FOLDER / "metrics.json").read_text())}
    assert set(rows) == set(SCHEMES), f"record anew: {ANEW}"
    now = metrics.evaluate(found)
    for name in ("thd_percent", "ripple_pp", "ripple_rms", "lut_error_max", "lut_error_rms"):
        for key, value in now[name].items():
            before = rows[scheme][name][key]
            assert value is before is None or value == pytest.approx(before, rel=1e-6), (name, key)
    assert now["switching_frequency_hz"] == rows[scheme]["switching_frequency_hz"]


def test_it_is_small() -> None:
    size = sum(file.stat().st_size for scheme in SCHEMES for file in (FOLDER / scheme).iterdir())
    assert size < 120_000 * len(SCHEMES)
