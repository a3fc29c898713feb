"""All that a recording tells of its drive, in words and numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mfpcc_experiments.bags import Recording
from mfpcc_experiments.identifying import delay as delays
from mfpcc_experiments.identifying.connection import connection
from mfpcc_experiments.identifying.fit import Fit, fit
from mfpcc_experiments.identifying.linear import one_step
from mfpcc_experiments.identifying.steps import Steps, of_recording
from mfpcc_experiments.notes import Note, failure, info, warning
from pwm_node.errors import ForPeople
from pwm_node.units import RPM

# An encoder's zero is wrong if it is off by so much (rad), and by so many of its own errors.
_ZERO = math.radians(1.5)
_ZERO_CLEAR = 3.0
# Share of one step that least squares explain; below it a model of this kind is not what it is.
_EXPLAINED = 0.5


class IdentifyError(ForPeople):
    """A recording that tells nothing of its drive; the text says why."""


@dataclass(frozen=True)
class Value:
    """
    One thing that was identified.

    Attributes
    ----------
    key : str
        Of the motor file, or a name.
    value, low, high : float
        The value, and the limits between which it lies with 95 %.
    unit : str
    told : bool
        Whether the recording tells it.
    """

    key: str
    value: float
    low: float
    high: float
    unit: str
    told: bool


@dataclass
class Identified:
    """
    What was identified.

    Attributes
    ----------
    values : list of Value
    delay : int
        Periods by which commands act later than the recording says.
    explained : float or None
        Share of the change from sample to sample that least squares explain, 0 to 1.
    fit : Fit
        The model.
    speed_max, i_max : float
        The largest in the recording (r/min, A).
    notes : list of Note
    """

    values: list[Value]
    delay: int
    explained: float | None
    fit: Fit
    speed_max: float
    i_max: float
    notes: list[Note] = field(default_factory=list)

    def value(self, key: str) -> Value:
        """One of the values."""
        return next(value for value in self.values if value.key == key)


def identify(recording: Recording, n_p: int | None = None) -> Identified:
    """
    Identify motor, inverter and sensors.

    Parameters
    ----------
    recording : Recording
        From `bags.read`.
    n_p : int, optional
        Pole pairs; default: the recording's.

    Raises
    ------
    IdentifyError
        If it is too short, has no voltage, or its columns do not belong together.
    """
    pairs = n_p or recording.n_p
    notes = []
    if pairs is None:
        pairs = 1
        notes.append(warning("pole pairs are not known: the angle counts as electrical"))
    steps = of_recording(recording, pairs)
    return of_steps(steps, pairs, notes, where=str(recording.path))


def of_steps(steps: Steps, n_p: int, notes: list[Note], *, where: str = "") -> Identified:
    """As `identify`, of steps."""
    prefix = f"{where}: " if where else ""
    linked = connection(steps)
    if linked is None or not np.abs(steps.u_s_ab[steps.whole]).any():
        raise IdentifyError(
            f"{prefix}there are too few periods in a row with a known voltage to identify a drive"
        )
    if linked.wrong:
        raise IdentifyError(f"{prefix}{'; '.join(linked.wrong)}; correct the map and import again")
    delay = delays.estimate(steps)
    if delay is None:
        raise IdentifyError(f"{prefix}there are too few periods in a row to identify a drive")
    shift = delay.periods if delay.sure else 0
    if delay.sure and shift:
        notes.append(
            failure(
                f"commands act {shift} period{'s' if abs(shift) > 1 else ''} "
                f"{'later' if shift > 0 else 'earlier'} than the recording says ({delay}): change "
                "'delay' of the map by that; what follows is with it"
            )
        )
    elif not delay.sure:
        notes.append(info("whether commands act when the recording says is not told by it"))
    steps = steps.later(shift)
    found = fit(steps)
    assert found is not None
    notes += _zero(found)
    steps = replace(steps, theta_m=steps.theta_m + found.values["zero"])
    if linked.one_axis:
        notes.append(
            info("voltage was applied along one axis only: the order of the phases is not checked")
        )
    step = one_step(steps)
    explained = None
    if step is not None:
        total = float(np.mean(np.abs(step.unchanged) ** 2))
        explained = max(0.0, 1.0 - float(np.mean(np.abs(step.error) ** 2)) / total)
    turning = float(np.abs(steps.w_m).max())
    result = Identified(
        values=_values(found, steps),
        delay=shift,
        explained=explained,
        fit=found,
        speed_max=turning / n_p / RPM,
        i_max=float(np.abs(steps.i_s_ab).max()),
        notes=notes,
    )
    for value in result.values:
        if value.key in ("R_s", "L_d", "L_q", "psi_f") and not value.told:
            notes.append(info(f"{value.key} is not told: {_WHY[value.key]}"))
    if explained is not None and explained < _EXPLAINED:
        notes.append(
            info(
                f"a linear model explains {explained:.0%} of what changes from sample to sample: "
                "the rest is noise, or nothing that a motor of this kind does"
            )
        )
    return result


_WHY = {
    "R_s": "it takes a current that lasts, or changes slowly",
    "L_d": "it takes a voltage along d that changes, such as steps of i_d",
    "L_q": "it takes a voltage along q that changes, such as steps of the torque",
    "psi_f": "it takes a rotor that turns",
}


def _zero(found: Fit) -> list[Note]:
    """Whether the flux lies where the angle says."""
    angle = found.values["zero"]
    half = 0.5 * (found.high["zero"] - found.low["zero"])
    if abs(angle) < max(_ZERO, _ZERO_CLEAR * half):
        return []
    return [
        failure(
            f"the encoder's zero is off: the d axis lies {math.degrees(angle):+.1f} degrees "
            "(electrical) ahead of where the angle says; subtract that, divided by the pole pairs "
            "if the angle is mechanical, from 'encoder_zero' of the map; what follows is with it"
        )
    ]


def _values(found: Fit, steps: Steps) -> list[Value]:
    def value(key: str, name: str, unit: str, within: float = 0.5) -> Value:
        return Value(
            key,
            found.values[name],
            found.low[name],
            found.high[name],
            unit,
            found.values[name] != 0.0 and found.told(name, within),
        )

    tau = value("sensor_lag", "tau", "s")
    tau = replace(tau, told=tau.value > 0.0)  # it is fitted only where it is seen
    return [
        value("R_s", "R_s", "ohm"),
        value("L_d", "L_d", "H"),
        value("L_q", "L_q", "H"),
        value("psi_f", "psi_f", "V s"),
        value("dead_time_voltage", "u_dead", "V", math.inf),
        tau,
    ]


def motor_text(found: Identified, known: Mapping[str, Any], name: str, source: str) -> str:
    """
    The motor file, with a comment on each value.

    Parameters
    ----------
    found : Identified
        What the recording told.
    known : mapping
        What it cannot tell: n_p, J, u_dc, and psi_f where the rotor stood still.
    name, source : str
        Of the file.

    Raises
    ------
    IdentifyError
        If a value that the file needs is neither identified nor given.
    """
    lines = [f"name: {name}", "description: Identified from a recording", f"source: '{source}'"]

    def line(key: str, value: float, comment: str) -> None:
        lines.append(f"{f'{key}: {value:.6g}':<24} # {comment}")

    for key in ("R_s", "L_d", "L_q", "psi_f"):
        value = found.value(key)
        if value.told:
            text = f"{value.unit}; {value.low:.5g} to {value.high:.5g} with 95 %"
            line(key, value.value, text)
        elif key in known:
            line(key, known[key], f"{value.unit}; not identified, given")
        elif key in ("L_d", "L_q") and found.value("L_q" if key == "L_d" else "L_d").told:
            other = found.value("L_q" if key == "L_d" else "L_d")
            line(key, other.value, f"{value.unit}; not identified, taken to be {other.key}")
        else:
            option = "--psi-f" if key == "psi_f" else "another recording"
            raise IdentifyError(
                f"the motor file needs {key}, which the recording does not tell ({_WHY[key]}): "
                f"give {option}"
            )
    line("n_p", known["n_p"], "pole pairs; given")
    line("J", known["J"], "kg m^2; given")
    line("i_max", found.i_max, "A; the largest current of the recording")
    psi = found.value("psi_f").value if found.value("psi_f").told else known["psi_f"]
    reachable = known["u_dc"] / math.sqrt(3.0) / (known["n_p"] * psi) / RPM
    turned = found.speed_max > 0.01 * reachable
    line(
        "speed_max_rpm",
        found.speed_max if turned else 0.8 * reachable,
        "r/min; the largest speed of the recording"
        if turned
        else "r/min; 80 % of the ideal no-load speed",
    )
    line("u_dc", known["u_dc"], "V; of the recording")
    return "\n".join(lines) + "\n"
