"""Any bytes on the loop's topics, in any order, into the nodes as they are: they go on."""

from __future__ import annotations

from typing import Any

import fuzz
import numpy as np
import pytest
from mfpcc_msgs.msg import DutyCommand, PhaseFeedback

from mfpcc_controller.node import MfpccController
from pmsm_sim.node import PmsmSim
from pwm_node.wire import HEADER, Wire


def started(kind: type, context: Any) -> Any:
    node = kind(context=context)
    assert node.trigger_configure() and node.trigger_activate()
    return node


def spoilt(rng: np.random.Generator, wire: Wire, good: int) -> bytes:
    """A message of this kind for about this period, with something wrong in it now and then."""
    fields = wire.fixed
    fields["period"] = np.uint64(min(max(0, good + int(rng.integers(-2, 3))), 2**64 - 1))
    kind = rng.integers(8)
    if kind == 0:
        fields["period"] = np.uint64(fuzz.any_integer(rng))
    elif kind == 1:
        for name in set(fields.dtype.names) - {"stamp", "period", "enable"}:
            fields[name] = np.resize([fuzz.any_float(rng) for _ in range(3)], fields[name].shape)
    elif kind == 2:
        return HEADER + rng.bytes(len(wire.to_bytes()) - 4)
    elif kind == 3:
        return rng.bytes(int(rng.integers(0, 200)))
    return wire.to_bytes()


@pytest.mark.filterwarnings("ignore:.*cast")  # any number as a small integer
def test_any_bytes_into_the_nodes(context: Any) -> None:
    for rng in fuzz.cases(5):
        plant, controller = started(PmsmSim, context), started(MfpccController, context)
        samples, commands = Wire(PhaseFeedback), Wire(DutyCommand)
        commands.fixed["duty"], samples.fixed["dc_voltage"] = 0.5, 311.0
        controller.period = 0  # as if the first sample had come: nobody waits for listeners here
        for _ in range(100):
            controller._on_feedback(spoilt(rng, samples, controller.period + 1))
            plant._on_command(spoilt(rng, commands, plant.period + 1))
            if rng.random() < 0.05:
                for node in (plant, controller):
                    node.core.clear_faults()
                    node._publish_diagnostics(node._diagnosed_at + 1.0)
            duty = controller._command.fixed["duty"]
            assert np.all((duty >= 0.0) & (duty <= 1.0))
            for wire in (plant._feedback, plant._state, controller._lut):
                for name in set(wire.fixed.dtype.names) - {"stamp", "speed_ref"}:
                    assert np.all(np.isfinite(wire.fixed[name])), (name, wire.fixed[name])
        for node in (plant, controller):
            node.destroy_node()
