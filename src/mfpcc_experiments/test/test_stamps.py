"""Stamps of a whole loop whose PWM period is no whole number of nanoseconds."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.bags import BagWriter, recording
from mfpcc_experiments.running.engine import Engine
from mfpcc_experiments.running.trace import write_trace
from pmsm_sim.parameters import TABLE as PLANT


@pytest.mark.parametrize("hertz", [70_000.0, 30_000.0, 12_345.678])
def test_each_stamp_is_the_nearest_nanosecond_to_its_period(hertz, tmp_path):
    common = {"pwm_frequency": hertz}
    engine = Engine(PLANT.complete(common), CONTROLLER.complete(common))
    traces = list(engine.run(3_000))
    at = [round(k * 10**9 / Fraction(hertz)) for k in range(3_001)]
    for trace in traces:
        for rows in (trace.feedback, trace.state, trace.command, trace.lut):
            for row in rows:
                told = int(row["stamp"]["sec"]) * 10**9 + int(row["stamp"]["nanosec"])
                assert told == at[int(row["period"])]

    # and what only has the stamps to go by
    with BagWriter(tmp_path / "bag", config={}, oversampling=0) as writer:
        for trace in traces:
            write_trace(writer, trace)
        writer.close({"lost_periods": 0})
    found = recording.read(tmp_path / "bag")
    assert found.T_s == pytest.approx(1.0 / hertz, rel=1e-7)
    if hertz == 70_000.0:
        assert found.T_s == 1.0 / hertz
    np.testing.assert_array_equal(found.feedback["period"], np.arange(3_000))
