"""Plug-ins: current-control schemes of other packages, in Python.

A package offers a scheme by an entry point of the group ``mfpcc_controller.schemes``; its name then
is a value of the parameter `scheme`. The class derives from `Scheme` and is asked once per period,
between the compiled stages of the controller. See docs/own_scheme.md.
"""

from __future__ import annotations

import abc
import cmath
import math
import numbers
import operator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mfpcc_controller.diagnostics import show_nothing_learned
from mfpcc_controller.motor import EstimatedPars
from mfpcc_controller.parameters import PLUG_INS
from mfpcc_controller.vectors import ACTIVE_LENGTH
from pwm_node import foreign
from pwm_node.compiled import kernel

# How long a plug-in may take before it is interrupted (s). It may have to be imported, and its own
# kernels to be compiled. A step that only overruns its budget is for `fault.step_budget`.
_AT_FIRST = 30.0
_LATER = 5.0

_SQRT3 = math.sqrt(3.0)


class Sample(NamedTuple):
    """
    What a scheme gets to see of one period; `dq` is the rotor frame, amplitude-invariant.

    Attributes
    ----------
    period : int
        Number k of the period that begins with this sample.
    T_s : float
        Length of a period (s).
    i_dq : complex
        Measured current (A).
    i_dq_ref : complex
        Where it shall be (A).
    u_dq : complex
        Mean voltage that is being applied in period k (V), in the rotor frame of its middle; it was
        decided at sample k - 1.
    u_dc : float
        DC-link voltage (V).
    theta_m : float
        Electrical rotor angle at the sample (rad).
    w_m : float
        Electrical speed (rad/s).
    fresh : bool
        True at the first sample, at the first after another scheme was in control, and after a gap:
        what the scheme remembers does not connect to this sample. To start from `u_dq` makes no
        bump.
    """

    period: int
    T_s: float
    i_dq: complex
    i_dq_ref: complex
    u_dq: complex
    u_dc: float
    theta_m: float
    w_m: float
    fresh: bool


class Output(NamedTuple):
    """
    What the inverter shall do in period k + 1.

    Attributes
    ----------
    a, b : int
        Two active vectors, 1 to 6; 0 for none.
    d_a, d_b : float
        Their shares of the period, together at most 1; the zero vector has the rest.
    i_hat : complex
        Current that the scheme predicts for sample k + 1 (A, dq); where it is NaN, recordings and
        protection get what the motor file predicts.
    """

    a: int
    b: int
    d_a: float
    d_b: float
    i_hat: complex = complex(math.nan, math.nan)

    @classmethod
    def from_voltage(
        cls, sample: Sample, u_dq: complex, i_hat: complex = complex(math.nan, math.nan)
    ) -> Output:
        """
        Two neighbouring vectors that make a mean voltage, shortened to what the inverter has.

        Parameters
        ----------
        sample : Sample
            The sample that this answers.
        u_dq : complex
            Mean voltage (V) for period k + 1, in the rotor frame of its middle.
        i_hat : complex
            As of the class.
        """
        angle = sample.theta_m + 1.5 * sample.w_m * sample.T_s
        u_ab = u_dq * cmath.exp(1j * angle) / (ACTIVE_LENGTH * sample.u_dc)
        sector = int(cmath.phase(u_ab) % math.tau / (math.pi / 3.0)) % 6
        rest = u_ab * cmath.exp(-1j * sector * math.pi / 3.0)
        d_a = max(rest.real - rest.imag / _SQRT3, 0.0)
        d_b = max(2.0 / _SQRT3 * rest.imag, 0.0)
        total = max(d_a + d_b, 1.0)
        return cls(sector + 1, (sector + 1) % 6 + 1, d_a / total, d_b / total, i_hat)


class Scheme(abc.ABC):
    """
    Base of a plug-in.

    Parameters
    ----------
    motor : EstimatedPars
        Nominal values of the motor file.
    T_s : float
        Length of a period (s).
    """

    def __init__(self, motor: EstimatedPars, T_s: float) -> None:
        self.motor = motor
        self.T_s = T_s

    @abc.abstractmethod
    def step(self, sample: Sample) -> complex | Output:
        """
        Answer the sample of period k for period k + 1.

        Returns
        -------
        complex or Output
            The mean voltage (V) in the rotor frame of the middle of period k + 1, or the vectors.
        """


class Host:
    """
    Runs a plug-in on the records of the controller.

    Whatever goes wrong in it, loading included, becomes an output that is refused, so that the
    fallback scheme answers the same sample; `complaint` says what it was.

    Parameters
    ----------
    name : str
        Name of the entry point.
    motor : EstimatedPars
        Nominal values of the motor file.
    cfg, mem : arrays of length 1 of `CONTROL_CFG`, `CONTROL_MEMORY`
        The controller's.
    """

    def __init__(
        self, name: str, motor: EstimatedPars, cfg: NDArray[np.void], mem: NDArray[np.void]
    ) -> None:
        self.name = name
        self.complaint = ""
        self._what = f"scheme '{name}'"
        self._mem = mem
        self._T_s = float(cfg["T_s"][0])
        self._scheme: Scheme | None = None
        self._limit = _AT_FIRST
        try:
            self._scheme = self._call(_load, name, motor, self._T_s)
        except foreign.ForeignError as error:
            self._complain("cannot be loaded", error)

    def step(self) -> None:
        """Let the plug-in answer the sample that the controller has taken."""
        out = self._mem[0]["next"]
        out["d_a"] = math.nan
        if self._scheme is None:
            return
        sample = self._sample()
        try:
            answer = self._call(_ask, self._scheme, sample)
        except foreign.ForeignError as error:
            self._complain(f"failed in period {sample.period}", error)
            return
        self._limit = _LATER
        out["a"], out["b"], out["d_b"], out["d_a"] = answer.a, answer.b, answer.d_b, answer.d_a
        self._mem["i_hat"] = answer.i_hat

    def _call(self, function: Any, *arguments: Any) -> Any:
        return foreign.call(function, *arguments, what=self._what, seconds=self._limit)

    def _sample(self) -> Sample:
        mem = self._mem[0]
        u_dc = float(mem["u_dc"])
        return Sample(
            period=int(mem["period"]),
            T_s=self._T_s,
            i_dq=complex(mem["i_dq"]),
            i_dq_ref=complex(mem["i_dq_ref"]),
            u_dq=u_dc * complex(mem["now"]["u"]) * complex(mem["turn_now"]),
            u_dc=u_dc,
            theta_m=float(mem["theta_m"]),
            w_m=float(mem["w_m"]),
            fresh=not (mem["contiguous"] and mem["kept"]),
        )

    def _complain(self, what: str, error: foreign.ForeignError) -> None:
        if not self.complaint:
            self.complaint = f"{self._what} {what}: {error}"


def _load(name: str, motor: EstimatedPars, T_s: float) -> Scheme:
    scheme = PLUG_INS[name].load()(motor, T_s)
    if not isinstance(scheme, Scheme):
        raise TypeError(f"{PLUG_INS[name].value} is no mfpcc_controller.plug_in.Scheme")
    return scheme


def _ask(scheme: Scheme, sample: Sample) -> Output:
    """A plug-in's answer, with numbers of Python's own types in it."""
    answer = scheme.step(sample)
    if not isinstance(answer, Output):
        u_dq = _number(answer, "the answer")
        if not cmath.isfinite(u_dq):
            raise ValueError(f"a voltage of {u_dq} V")
        answer = Output.from_voltage(sample, u_dq)
    d_a, d_b = _number(answer.d_a, "d_a"), _number(answer.d_b, "d_b")
    if d_a.imag or d_b.imag:
        raise ValueError(f"dwell times that are complex: {d_a}, {d_b}")
    i_hat = _number(answer.i_hat, "i_hat")
    return Output(_vector(answer.a), _vector(answer.b), d_a.real, d_b.real, i_hat)


def _vector(value: Any) -> int:
    vector = operator.index(value)
    if not 0 <= vector <= 6:
        raise ValueError(f"there is no vector {vector}")
    return vector


def _number(value: Any, what: str) -> complex:
    if isinstance(value, np.ndarray) and not value.shape:
        value = value[()]
    if not isinstance(value, numbers.Number):
        raise TypeError(f"{what} is no number but of type {type(value).__name__}")
    return complex(value)  # type: ignore[call-overload, no-any-return]


@kernel
def show(diag):
    """Fill in a plug-in's part of the diagnostics: its gradients, if it has any, are its own."""
    for j in range(7):
        diag.gradient_re[j] = np.nan
        diag.gradient_im[j] = np.nan
    show_nothing_learned(diag)
