"""Any samples in any order: sound commands only, and no trip missed.

The oracle is written anew from the table of faults in docs/reliability.md; it shares no code with
the controller.
"""

from __future__ import annotations

import math

import fuzz
import numpy as np
import pytest
from mfpcc_msgs.msg import DutyCommand, LutDiagnostics, PhaseFeedback

from mfpcc_controller.controller import Controller
from mfpcc_controller.parameters import SCHEMES, TABLE
from pwm_node import bits
from pwm_node.wire import fixed_dtype

MEASURED = ("i_a", "i_b", "i_c", "encoder_angle", "dc_voltage")
TURN = 2.0 * math.pi
#: A decision this near to its limit may be rounded either way.
ABOVE = 1.0 + 1e-9


def make_samples(rng: np.random.Generator, controller: Controller, n: int) -> np.ndarray:
    """Samples of a machine that turns steadily, and what a bad sensor and a bad link make of it."""
    motor = controller.motor
    k = np.arange(n)
    T_s = float(controller.cfg["T_s"][0])
    top = motor.speed_max_rpm * TURN / 60.0
    theta = rng.uniform(0.0, TURN) + rng.uniform(-1.0, 1.0) * top * T_s * k
    phase = motor.n_p * theta[:, None] + rng.uniform(0.0, TURN) - TURN / 3.0 * np.arange(3)
    current = rng.uniform(0.0, 1.4) * motor.i_max * np.cos(phase) + rng.normal(0, 0.02, (n, 3))
    samples = np.zeros(n, fixed_dtype(PhaseFeedback))
    samples["period"] = k
    samples["encoder_angle"] = theta % TURN
    samples["dc_voltage"] = motor.u_dc
    for x, name in enumerate("abc"):
        samples[f"i_{name}"] = current[:, x]
    bad = rng.choice([0.0, 0.01, 0.1, 0.5])
    for j in np.flatnonzero(rng.random(n) < bad):
        spoil(rng, samples, j, motor.i_max)
    return samples


def spoil(rng: np.random.Generator, samples: np.ndarray, j: int, i_max: float) -> None:
    """Spoil sample j, or its place in the order of the samples."""
    kind = rng.integers(6)
    if kind == 0:
        samples[MEASURED[rng.integers(5)]][j] = fuzz.any_float(rng)
    elif kind == 1:
        for name in MEASURED:
            samples[name][j] = fuzz.any_float(rng)
    elif kind == 2:  # a true overcurrent
        samples["i_a"][j], samples["i_b"][j] = rng.uniform(-3.0, 3.0, 2) * i_max
        samples["i_c"][j] = -samples["i_a"][j] - samples["i_b"][j]
    elif kind == 3:
        samples["encoder_angle"][j] = rng.uniform(0.0, TURN)
    elif kind == 4:  # repeated, overtaken, or with others missing before it
        step = int(rng.integers(-12, 13))
        samples["period"][j:] = np.maximum(samples["period"][j:].astype(np.int64) + step, 0)
    else:
        samples["period"][j] = fuzz.any_integer(rng)


class Oracle:
    """What must be tripped at least, told from the samples alone."""

    def __init__(self, controller: Controller) -> None:
        motor, values = controller.motor, controller.values
        self.T_s = float(controller.cfg["T_s"][0])
        self.i_max = motor.i_max
        self.u_dc = motor.u_dc
        self.overcurrent = values["fault.overcurrent"] * motor.i_max
        self.sum_limit = values["fault.current_sum"] * motor.i_max
        top = motor.speed_max_rpm * TURN / 60.0
        self.jump = 1.5 * top * self.T_s + values["fault.encoder_jump"]
        self.rest = 0.01 * top
        self.last: int | None = None
        self.angle: float | None = None
        self.bad_in_row = 0
        self.sum = 0.0
        self.tripped = False
        self.awaits_zero = False
        self.cause = False

    def take(self, sample: np.void) -> bool:
        """Judge a sample; returns whether it is to be answered."""
        period = int(sample["period"])
        if self.last is not None and period <= self.last:
            self.bad_in_row += 1
            if self.bad_in_row >= 2:
                self.tripped = self.cause = True
            return False
        step = 0 if self.last is None else period - self.last
        self.last = period
        self.cause = step > 5
        i_a, i_b, i_c, angle, u_dc = (float(sample[name]) for name in MEASURED)
        credible = (
            all(abs(i) <= 4.0 * self.i_max for i in (i_a, i_b, i_c))
            and -1e-6 <= angle <= TURN + 1e-6
            and 0.1 * self.u_dc <= u_dc <= 4.0 * self.u_dc
        )
        if credible:
            self.bad_in_row = 0
            amplitude = math.hypot((2.0 * i_a - i_b - i_c) / 3.0, (i_b - i_c) / math.sqrt(3.0))
            self.cause |= amplitude > ABOVE * self.overcurrent
            self.sum += (1.0 - math.exp(-self.T_s / 1e-3)) * (i_a + i_b + i_c - self.sum)
            self.cause |= abs(self.sum) > ABOVE * self.sum_limit
            if step == 1 and self.angle is not None:
                turned = math.remainder(angle - self.angle, TURN)
                self.cause |= abs(turned) > ABOVE * self.jump
            self.angle = angle
        else:
            self.bad_in_row += 1
            self.cause |= self.bad_in_row >= 2
            self.angle = None
        self.tripped |= self.cause
        return True

    def reference(self, values: dict[str, object]) -> None:
        """Take note of a reference at zero."""
        if values["control_mode"] == "speed":
            at_zero = abs(values["speed_ref_rpm"]) * TURN / 60.0 <= self.rest * ABOVE  # type: ignore[arg-type]
        else:
            size = math.hypot(values["i_d_ref"], values["i_q_ref"])  # type: ignore[arg-type]
            at_zero = size <= 0.01 * self.i_max * ABOVE
        if at_zero and not self.tripped:
            self.awaits_zero = False


def check_command(cmd: np.void, period: int) -> None:
    """A command that an inverter can follow."""
    assert int(cmd["period"]) == (period + 1) % 2**64
    assert np.all((cmd["duty"] >= 0.0) & (cmd["duty"] <= 1.0)), cmd["duty"]
    assert np.all((cmd["dwell"] >= 0.0) & (cmd["dwell"] <= 1.0 + 1e-9)), cmd["dwell"]
    assert np.all(cmd["vectors"] <= 6)
    assert 0 <= cmd["stamp"]["nanosec"] < 1_000_000_000


def check_diagnostics(lut: np.void) -> None:
    """Numbers, where the message does not say that there is none."""
    for name in ("gradient_re", "gradient_im", "prediction_error", "i_dq", "i_dq_ref", "w_m"):
        assert np.all(np.isfinite(lut[name])), (name, lut[name])
    assert np.all(np.isfinite(lut["error_share"])) and np.isfinite(lut["learning_rate"])


def disturb(rng: np.random.Generator, controller: Controller, oracle: Oracle) -> None:
    """What an operator does in between."""
    kind = rng.integers(7)
    if kind == 0:
        cause = oracle.cause
        lasting = controller.clear_faults()
        assert lasting or not cause, "cleared while the cause lasts"
        if not lasting:
            oracle.tripped, oracle.awaits_zero = False, True
    elif kind == 1:
        controller.stop()
        oracle.tripped = True
    elif kind == 2:
        change(controller, scheme=SCHEMES[rng.integers(len(SCHEMES))])
    elif kind == 3:
        change(controller, control_mode=("speed", "current")[rng.integers(2)])
    elif kind == 4:
        zero = rng.random() < 0.5
        change(
            controller,
            speed_ref_rpm=0.0 if zero else rng.uniform(-1e5, 1e5),
            i_q_ref=0.0 if zero else rng.uniform(-1e4, 1e4),
        )
    elif kind == 5:
        name = ("mismatch.inductance", "mismatch.resistance", "mismatch.flux")[rng.integers(3)]
        controller.apply(TABLE.validate({name: 10.0 ** rng.uniform(-2, 2)}, controller.values))
    else:
        controller.slow_down()


def change(controller: Controller, **values: object) -> None:
    controller.apply(TABLE.validate(values, controller.values))


@pytest.mark.parametrize("control_mode", ["speed", "current"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_any_samples_give_sound_commands_and_no_trip_is_missed(
    scheme: str, control_mode: str
) -> None:
    fb, cmd, lut = (
        np.zeros(1, fixed_dtype(kind)) for kind in (PhaseFeedback, DutyCommand, LutDiagnostics)
    )
    for rng in fuzz.cases(10):
        controller = Controller(
            TABLE.complete(
                {
                    "speed_ref_rpm": rng.uniform(-1500.0, 1500.0),
                    "i_d_ref": rng.uniform(-12.0, 12.0),
                    "i_q_ref": rng.uniform(-12.0, 12.0),
                    **fuzz.legal_values(TABLE, rng, rng.choice([0.0, 0.0, 0.1, 0.5])),
                    "scheme": scheme,
                    "control_mode": control_mode,
                    "fault.react": True,
                }
            )
        )
        controller.bind(fb, cmd, lut)
        oracle = Oracle(controller)
        cmd[0] = np.zeros((), cmd.dtype)
        busy = rng.choice([0.0, 0.02, 0.2])
        for sample in make_samples(rng, controller, 200):
            if rng.random() < busy:
                disturb(rng, controller, oracle)
            fb[0] = sample
            before = bits.of(cmd)
            controller.step(fb, cmd, lut, True)
            if not oracle.take(sample):
                assert bits.of(cmd) == before
                assert controller.tripped or not oracle.tripped
                continue
            oracle.reference(controller.values)
            check_command(cmd[0], int(sample["period"]))
            check_diagnostics(lut[0])
            if cmd["enable"][0]:
                assert not oracle.tripped, controller.faults()
                assert not oracle.awaits_zero, "power without a reference at zero"
