"""The controller without a plant: parameters, references, fallback, plug-ins."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from mfpcc_msgs.msg import DutyCommand, LutDiagnostics, PhaseFeedback

from mfpcc_controller import plug_in
from mfpcc_controller.controller import Controller
from mfpcc_controller.parameters import SCHEMES, TABLE
from mfpcc_controller.plug_in import Output, Sample, Scheme
from mfpcc_controller.schemes import MEMORY_FIELDS
from pwm_node import bits
from pwm_node.wire import fixed_dtype

# What the node does, not the controller
NODE = {"fault.feedback_timeout", "fault.step_budget"}


class Bench:
    """A controller that is shown the currents of a motor that follows its reference."""

    def __init__(self, **values):
        self.controller = Controller(TABLE.complete({"speed_ref_rpm": 750.0, **values}))
        self.fb = np.zeros(1, fixed_dtype(PhaseFeedback))
        self.cmd = np.zeros(1, fixed_dtype(DutyCommand))
        self.lut = np.zeros(1, fixed_dtype(LutDiagnostics))
        self.k = 0

    def show(self, periods=1, speed=78.5):
        for _ in range(periods):
            angle = (self.k * speed * 1e-4) % (2.0 * math.pi)
            for x, name in enumerate(("i_a", "i_b", "i_c")):
                self.fb[name] = -2.0 * math.sin(4.0 * angle - 2.0 * math.pi / 3.0 * x)
            self.fb["period"], self.fb["dc_voltage"] = self.k, 311.0
            self.fb["encoder_angle"], self.fb["derating"] = angle, 1.0
            self.controller.step(self.fb, self.cmd, self.lut, True)
            self.k += 1
        return self


def other_value(name: str) -> object:
    """A value of a parameter that is not the default."""
    parameter = TABLE[name]
    default = parameter.default
    if parameter.choices:
        return next(choice for choice in parameter.choices if choice != default)
    if isinstance(default, bool):
        return not default
    if isinstance(default, int):
        return default + 1
    low = -math.inf if parameter.minimum is None else parameter.minimum
    high = math.inf if parameter.maximum is None else parameter.maximum
    return next(v for v in (1.1 * default, 0.9 * default, 1.0) if v != default and low <= v <= high)


@pytest.mark.parametrize("name", [n for n in TABLE if not TABLE[n].read_only and n not in NODE])
def test_an_accepted_parameter_acts(name):
    # a machine with saliency: maximum torque per ampere does nothing without
    controller = Controller(TABLE.complete({"motor": "ipmsm"}))
    before = bits.of(controller.cfg)
    controller.apply(TABLE.validate({name: other_value(name)}, controller.values))
    assert bits.of(controller.cfg) != before


def test_rules_across_parameters():
    with pytest.raises(ValueError, match=r"mls\.eta_min"):
        TABLE.complete({"mls.eta_min": 0.6})


@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_scheme_gives_sound_commands_from_the_first_sample_on(scheme):
    bench = Bench(scheme=scheme)
    for _ in range(50):
        bench.show()
        assert bench.cmd["period"][0] == bench.k
        assert np.all((bench.cmd["duty"] >= 0.0) & (bench.cmd["duty"] <= 1.0))
        assert bench.cmd["enable"][0]
    assert not bench.controller.fallen


def _spoil(memory: np.ndarray) -> None:
    """Whatever is a real or complex number becomes none."""
    for name in memory.dtype.names:
        if memory.dtype[name].names:
            _spoil(memory[name])
        elif memory.dtype[name].base.kind in "fc":
            memory[name] = math.nan


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_scheme_that_gives_no_number_is_replaced_in_the_same_period(scheme):
    fallback = "mbpcc" if scheme == "pi_foc" else "pi_foc"
    bench = Bench(scheme=scheme, fallback_scheme=fallback).show(20)
    # whatever the scheme remembers is spoilt; one that remembers nothing cannot fail this way
    for name, _ in MEMORY_FIELDS:
        _spoil(bench.controller.mem[name])
    bench.show()
    assert np.all(np.isfinite(bench.cmd["duty"])) and bench.cmd["enable"][0]
    if bench.controller.fallen:
        assert bench.controller.scheme == fallback
        assert [code for code, _, _ in bench.controller.faults()] == ["SCHEME"]
    else:
        assert scheme in ("mbpcc", "mbpcc_single_vector", "mfpcc", "mfpcc_two_vector")
    bench.show(20)
    assert np.all(np.isfinite(bench.cmd["duty"])) and bench.cmd["enable"][0]
    # another choice ends it
    bench.controller.apply({"scheme": "mls_mfpcc"})
    bench.show(2)
    assert not bench.controller.fallen and bench.controller.scheme == "mls_mfpcc"
    bench.show(50)
    assert not bench.controller.fallen


def test_without_gates_nothing_is_learned():
    bench = Bench().show(50)
    bench.controller.enabled = False
    bench.show(2)
    learned = bench.controller.mem["mls_mfpcc"]
    table = [learned[name].copy() for name in ("d", "q", "P")]
    bench.show(20)
    assert not bench.cmd["enable"][0]
    for name, before in zip(("d", "q", "P"), table, strict=True):
        np.testing.assert_array_equal(learned[name], before)
    assert bench.controller.mem["i_dq_ref"][0] == 0.0
    bench.controller.enabled = True
    bench.show(2)
    assert bench.cmd["enable"][0]


@pytest.mark.parametrize(("i_d", "i_q"), [(0.0, 50.0), (-8.0, 50.0), (-50.0, -50.0), (3.0, -4.0)])
def test_current_references_keep_within_the_limit(i_d, i_q):
    bench = Bench(control_mode="current", i_d_ref=i_d, i_q_ref=i_q).show(3)
    reference = complex(*bench.lut["i_dq_ref"][0])
    i_max = bench.controller.motor.i_max
    assert abs(reference) <= i_max * (1.0 + 1e-12)
    if abs(complex(i_d, i_q)) <= i_max:
        assert reference == complex(i_d, i_q)


# --- Plug-ins ------------------------------------------------------------------------------------


class _Entry:
    """An entry point that has been found."""

    value = "somewhere:Something"

    def __init__(self, scheme):
        self.scheme = scheme

    def load(self):
        if isinstance(self.scheme, BaseException):
            raise self.scheme
        return self.scheme


class Holds(Scheme):
    """Applies the same voltage again."""

    def step(self, sample: Sample) -> complex:
        return sample.u_dq


class Vectors(Scheme):
    def step(self, sample: Sample) -> Output:
        return Output(2, 3, 0.25, 0.5, 1.0 + 2.0j)


class Raises(Scheme):
    def step(self, sample: Sample) -> complex:
        raise RuntimeError("out of ideas")


class NoNumber(Scheme):
    def step(self, sample: Sample) -> complex:
        return complex(math.nan, 0.0)


class TooLong(Scheme):
    def step(self, sample: Sample) -> Output:
        return Output(1, 2, 0.8, 0.8)


class NoAnswer(Scheme):
    def step(self, sample: Sample) -> complex:
        return None  # type: ignore[return-value]


class Leaves(Scheme):
    def step(self, sample: Sample) -> complex:
        sys.exit(3)


class Interrupts(Scheme):
    def step(self, sample: Sample) -> complex:
        raise KeyboardInterrupt


class Closes(Scheme):
    def step(self, sample: Sample) -> complex:
        raise GeneratorExit


class LeavesAtOnce(Holds):
    def __init__(self, motor, T_s) -> None:
        sys.exit(3)


class Endless(Scheme):
    def step(self, sample: Sample) -> complex:
        while True:
            pass


class NeverMade(Holds):
    def __init__(self, motor, T_s) -> None:
        while True:
            pass


class Deep(Scheme):
    def step(self, sample: Sample) -> complex:
        return self.step(sample)


class Two(Scheme):
    def step(self, sample: Sample):
        return np.array([1.0, 2.0])


class Text(Scheme):
    def step(self, sample: Sample):
        return "1.0"


class Half(Scheme):
    def step(self, sample: Sample) -> Output:
        return Output(1.5, 2, 0.1, 0.1)  # type: ignore[arg-type]


class Seven(Scheme):
    def step(self, sample: Sample) -> Output:
        return Output(7, 2, 0.1, 0.1)


class Complex(Scheme):
    def step(self, sample: Sample) -> Output:
        return Output(1, 2, 0.1 + 1.0j, 0.1)  # type: ignore[arg-type]


class Huge(Scheme):
    def step(self, sample: Sample) -> complex:
        return 10**400


class Hungry(Scheme):
    def step(self, sample: Sample) -> complex:
        return np.zeros(1 << 60)[0]


class Breaks(Scheme):
    def step(self, sample: Sample) -> complex:
        self.motor.R_s = math.nan  # type: ignore[misc]
        return 0j


@pytest.fixture
def plugged(monkeypatch):
    """A function that makes a bench with a plug-in in control."""

    def make(scheme) -> Bench:
        monkeypatch.setitem(plug_in.PLUG_INS, "mine", _Entry(scheme))
        bench = Bench(scheme="pi_foc").show(20)
        bench.controller.apply({"scheme": "mine"})
        return bench

    return make


def test_a_plug_in_is_asked_and_obeyed(plugged):
    bench = plugged(Vectors).show(2)
    assert bench.controller.scheme == "mine" and bench.controller.complaint == ""
    assert list(bench.cmd["vectors"][0]) == [2, 3]
    assert list(bench.cmd["dwell"][0]) == [0.25, 0.5]
    i_dq = complex(*bench.lut["i_dq"][0])
    assert complex(*bench.lut["prediction_error"][0]) == pytest.approx(i_dq - (1.0 + 2.0j))


def test_a_plug_in_need_not_predict(plugged):
    bench = plugged(Holds).show(200)
    assert bench.controller.scheme == "mine" and bench.controller.faults() == []
    # the motor file does so in its place
    assert np.all(np.abs(bench.lut["prediction_error"]) < 1.0)


def test_a_voltage_is_made_as_the_built_in_schemes_make_it(plugged):
    bench = plugged(Holds).show(1)
    mem = bench.controller.mem[0]
    u_now, u_next = (mem[name]["u"] * mem[f"turn_{name}"] for name in ("now", "next"))
    assert u_next == pytest.approx(u_now, abs=1e-12)


@pytest.mark.parametrize(
    ("scheme", "said"),
    [
        (Raises, "failed in period 20: RuntimeError: out of ideas"),
        (NoNumber, ""),
        (TooLong, ""),
        (NoAnswer, "failed in period 20: TypeError"),
        (ImportError("no module named 'torch'"), "cannot be loaded: ImportError: no module"),
        (dict, "cannot be loaded"),
        (SystemExit(3), "cannot be loaded: SystemExit: 3"),
        (LeavesAtOnce, "cannot be loaded: SystemExit: 3"),
        (Leaves, "failed in period 20: SystemExit: 3"),
        (Interrupts, "failed in period 20: KeyboardInterrupt"),
        (Closes, "failed in period 20: GeneratorExit"),
        (Deep, "failed in period 20: RecursionError"),
        (Two, "failed in period 20: TypeError: the answer is no number but of type ndarray"),
        (Text, "failed in period 20: TypeError: the answer is no number but of type str"),
        (Half, "failed in period 20: TypeError"),
        (Seven, "failed in period 20: ValueError: there is no vector 7"),
        (Complex, "failed in period 20: ValueError: dwell times that are complex"),
        (Huge, "failed in period 20: OverflowError"),
        (Hungry, "failed in period 20: "),
        (Breaks, "failed in period 20: ValidationError"),
        (Endless, "failed in period 20: did not return"),
        (NeverMade, "cannot be loaded: did not return"),
    ],
)
def test_a_plug_in_that_fails_is_replaced_in_the_same_period(plugged, scheme, said, monkeypatch):
    monkeypatch.setattr(plug_in, "_AT_FIRST", 0.3)
    bench = plugged(scheme).show(1)
    assert bench.controller.fallen and bench.controller.scheme == "pi_foc"
    assert said in bench.controller.complaint
    assert bench.cmd["enable"][0] and np.all(np.isfinite(bench.cmd["duty"]))
    bench.show(10)
    assert bench.cmd["enable"][0] and not bench.controller.failed
