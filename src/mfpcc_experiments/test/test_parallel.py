"""Many drives at once are the same drives."""

from __future__ import annotations

import pytest

from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.proofs.effects import SETS
from mfpcc_experiments.running.engine import Engine, parallel
from pmsm_sim.parameters import TABLE as PLANT
from pwm_node import bits


def _drive(n: int) -> Engine:
    """Drives that differ in load, noise, scheme and, every other one, in their effects."""
    plant = PLANT.complete(
        {
            "initial_speed_rpm": 700.0,
            "load_torque": 0.5 * n,
            "seed": n,
            "noise.current_rms": 0.02,
            **(SETS["servo"] if n % 2 else {}),
        }
    )
    scheme = ("mls_mfpcc", "mbpcc", "pi_foc")[n % 3]
    return Engine(plant, CONTROLLER.complete({"scheme": scheme, "speed_ref_rpm": 750.0}))


def _bits(traces):
    return [
        (bits.of(t.feedback), bits.of(t.command), bits.of(t.state), bits.of(t.lut)) for t in traces
    ]


def test_the_same_bits_as_one_at_a_time():
    periods = 2_500  # more than one piece
    together = parallel([_drive(n) for n in range(6)], periods)
    for n, traces in enumerate(together):
        assert sum(len(trace.feedback) for trace in traces) == periods
        assert _bits(traces) == _bits(_drive(n).run(periods)), f"drive {n}"


def test_an_error_of_one_drive_is_told():
    def broken(n):
        raise ValueError("drive 1")

    drives = [_drive(0), _drive(1)]
    drives[1].run = broken
    with pytest.raises(ValueError, match="drive 1"):
        parallel(drives, 10)
