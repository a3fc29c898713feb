"""Injected faults: what goes wrong, when, and how much; off unless `fault_injection` is set.

An injection is one line of text, `START DURATION UNIT TYPE [MAGNITUDE [SEED]]`, times in simulated
seconds: `0.2 0.05 current_a stuck`. What is random about it follows from the seed (its own, or the
plant's) and the period, so a run with faults is as reproducible as one without, on the graph and in
process.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmsm_sim.motor import MotorPars
from pmsm_sim.noise import normal
from pmsm_sim.parts.part import Part
from pwm_node.compiled import kernel
from pwm_node.names import unknown
from pwm_node.parameters import Parameter

_SENSOR_TYPES = ("off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent")
_LINK_TYPES = ("off", "dropped", "garbage", "stuck", "delayed", "intermittent", "reordered")

#: What can fail, and how. Sensors and links lie to the controller; the others are the truth.
UNITS: dict[str, tuple[str, ...]] = {
    "current_a": _SENSOR_TYPES,
    "current_b": _SENSOR_TYPES,
    "current_c": _SENSOR_TYPES,
    "encoder": _SENSOR_TYPES,
    "dc_sensor": _SENSOR_TYPES,
    "dc_link": ("off", "garbage", "wrong", "slow", "intermittent"),
    "leg_a": ("off", "stuck", "garbage", "wrong", "intermittent"),
    "leg_b": ("off", "stuck", "garbage", "wrong", "intermittent"),
    "leg_c": ("off", "stuck", "garbage", "wrong", "intermittent"),
    "duty_link": (*_LINK_TYPES, "wrong", "duplicated"),
    "feedback_link": (*_LINK_TYPES, "wrong", "duplicated"),
    "load": ("off", "stuck", "garbage", "wrong", "intermittent"),
    "temperature": ("wrong", "slow"),
}
TYPES = (
    *_SENSOR_TYPES,
    "dropped",
    "reordered",
    "duplicated",
)  # all of them; the position is the number in `INJECTION`

_SENSORS = ("current_a", "current_b", "current_c", "encoder", "dc_sensor")

#: Magnitude where none is given, in the unit of what it acts on; for a `slow` sensor it is the time
#: constant (s), for `delayed` the number of periods.
MAGNITUDES = {
    "current_a": 5.0,  # A
    "current_b": 5.0,
    "current_c": 5.0,
    "encoder": 0.5,  # rad
    "dc_sensor": 150.0,  # V
    "dc_link": 120.0,  # V
    "leg_a": 0.2,  # duty
    "leg_b": 0.2,
    "leg_c": 0.2,
    "duty_link": 0.2,
    "feedback_link": 5.0,  # of the share of the current limit that the inverter allows
    "load": 15.0,  # N m
    "temperature": 120.0,  # K
}
_SLOW_TIME = 5e-3
_DELAY = 5.0

MAX_INJECTIONS = 8
_HISTORY = 32

INJECTION = np.dtype(
    [
        ("unit", np.int64),
        ("type", np.int64),
        ("begin", np.uint64),  # first period, and the first after it
        ("end", np.uint64),
        ("magnitude", np.float64),
        ("seed", np.uint64),  # 0: the plant's
        ("held", np.float64),  # value at the start (stuck), or behind the lag (slow)
        ("holds", np.bool_),
    ],
    align=True,
)

_INJECTOR = np.dtype(
    [
        ("on", np.bool_),  # whether there may be any
        ("n", np.int64),
        ("list", INJECTION, (MAX_INJECTIONS,)),
        ("history", np.float64, (_HISTORY, 5)),  # true samples by period
        ("stuck", np.float64, (5,)),  # the sample that a stuck link repeats
        # what it makes of the period at hand
        ("leg_off", np.uint8, (3,)),  # 1: both switches of leg x are off
        ("some_leg_off", np.bool_),
        ("duty_link", np.int64),  # what becomes of the next command: type + 1; 0: nothing
        ("duty_error", np.float64),
        ("copies", np.int64),  # of this sample that reach the controller
        ("late", np.int64),  # by so many periods
        ("tau_L", np.float64),  # added load torque (N m)
        ("u_dc", np.float64),  # added DC-link voltage (V)
        ("warmth", np.float64),  # added temperature (K)
        ("jammed", np.bool_),
    ],
    align=True,
)

PARAMETERS = (
    Parameter(
        "fault_injection",
        False,
        "Whether faults may be injected at all",
        read_only=True,
    ),
    Parameter(
        "injections",
        [],
        "Faults to inject, each 'START DURATION UNIT TYPE [MAGNITUDE [SEED]]', times in "
        "simulated seconds; more of them by the service ~/inject_fault",
        read_only=True,
    ),
)

_NAMES = tuple(UNITS)
_CURRENT_A, _DC_SENSOR = _NAMES.index("current_a"), _NAMES.index("dc_sensor")
_ENCODER = _NAMES.index("encoder")
_DC_LINK, _LEG_A, _LEG_C = _NAMES.index("dc_link"), _NAMES.index("leg_a"), _NAMES.index("leg_c")
_DUTY_LINK, _FEEDBACK_LINK = _NAMES.index("duty_link"), _NAMES.index("feedback_link")
_LOAD, _TEMPERATURE = _NAMES.index("load"), _NAMES.index("temperature")

_OFF, _STUCK, _GARBAGE = TYPES.index("off"), TYPES.index("stuck"), TYPES.index("garbage")
_WRONG, _SLOW, _DELAYED = TYPES.index("wrong"), TYPES.index("slow"), TYPES.index("delayed")
_INTERMITTENT, _DROPPED = TYPES.index("intermittent"), TYPES.index("dropped")
_REORDERED, _DUPLICATED = TYPES.index("reordered"), TYPES.index("duplicated")

# What becomes of a command on its way.
LOSE, SPOIL, SHIFT, FREEZE, REPEAT = 1, 2, 3, 4, 5
_CHANNEL = np.uint64(16)  # of the noise: the sensors have the first ones


class InjectionError(ValueError):
    """An injection that cannot be understood: what is wrong with it."""


def parse(entries: Iterable[str], T_s: float) -> NDArray[np.void]:
    """Read injections.

    Parameters
    ----------
    entries : iterable of str
        Each `START DURATION UNIT TYPE [MAGNITUDE [SEED]]`.
    T_s : float
        PWM period (s).

    Returns
    -------
    structured array of `INJECTION`, one row each
    """
    rows = [_parse_one(text, T_s) for text in entries]
    if len(rows) > MAX_INJECTIONS:
        raise InjectionError(f"at most {MAX_INJECTIONS} injections, not {len(rows)}")
    return np.array(rows, INJECTION)


def _parse_one(text: str, T_s: float) -> tuple[object, ...]:
    parts = text.split()
    try:
        if not 4 <= len(parts) <= 6:
            raise InjectionError(
                "expected START DURATION UNIT TYPE [MAGNITUDE [SEED]], "
                "such as '0.2 0.05 current_a stuck'"
            )
        try:
            start, duration, *magnitude = (float(part) for part in (*parts[:2], *parts[4:5]))
            seed = int(parts[5]) if len(parts) == 6 else 0
        except ValueError:
            raise InjectionError(
                "times and magnitude must be numbers, the seed a whole one"
            ) from None
        return injection(parts[2], parts[3], start, duration, *magnitude, seed=seed, T_s=T_s)
    except InjectionError as error:
        raise InjectionError(f"'{text}': {error}") from None


def injection(
    unit: str,
    kind: str,
    start: float,
    duration: float,
    magnitude: float | None = None,
    *,
    seed: int = 0,
    T_s: float,
    earliest: int = 1,
) -> tuple[object, ...]:
    """One row of `INJECTION`.

    Parameters
    ----------
    unit, kind : str
        What fails, and how: see `UNITS`.
    start, duration : float
        Simulated time (s).
    magnitude : float, optional
        In the unit of what fails; by default that of `MAGNITUDES`.
    seed : int
        Of what is random about it; 0: the plant's.
    T_s : float
        PWM period (s).
    earliest : int
        First period there can be.

    Raises
    ------
    InjectionError
        There is no such fault, or a number is out of its range.
    """
    if unit not in UNITS:
        raise InjectionError(unknown("unit", unit, UNITS))
    if kind not in UNITS[unit]:
        raise InjectionError(unknown(f"fault of {unit}", kind, UNITS[unit]))
    if magnitude is None:
        magnitude = MAGNITUDES[unit]
        if kind == "delayed":
            magnitude = _DELAY
        elif kind == "slow" and unit in _SENSORS:
            magnitude = _SLOW_TIME
    if not (0.0 <= start < 1e6 and 0.0 < duration < 1e6 and math.isfinite(magnitude)):
        raise InjectionError("start from 0, duration above 0, a finite magnitude (s)")
    if not 0 <= seed < 2**64:
        raise InjectionError("a seed from 0, below 2^64")
    if kind == "delayed" and not 1.0 <= magnitude < _HISTORY:
        raise InjectionError(f"a delay of 1 to {_HISTORY - 1} periods")
    if kind == "slow" and magnitude <= 0.0:
        raise InjectionError("a time constant above 0 s")
    begin = max(earliest, round(start / T_s))
    end = begin + max(1, round(duration / T_s))
    return _NAMES.index(unit), TYPES.index(kind), begin, end, magnitude, seed, 0.0, False


def described(row: np.void, T_s: float) -> str:
    """An injection as the line of text it could have come from."""
    begin, end = int(row["begin"]), int(row["end"])
    text = (
        f"{begin * T_s:.9g} {(end - begin) * T_s:.9g} {_NAMES[row['unit']]} {TYPES[row['type']]} "
        f"{float(row['magnitude']):g}"
    )
    return f"{text} {row['seed']}" if row["seed"] else text


def _check(values: Mapping[str, Any]) -> str | None:
    injections = values["injections"]
    if not injections:
        return None
    if not values["fault_injection"]:
        return "'injections' is refused: faults are injected only with 'fault_injection' = true"
    if values["dc_link.kind"] == "rectifier" and any("dc_link" in text for text in injections):
        return "'injections': dc_link fails only where 'dc_link.kind' is stiff"
    try:
        parse(injections, 1.0 / values["pwm_frequency"])
    except InjectionError as error:
        return f"'injections': {error}"
    return None


def _start(par: np.void, st: np.void, values: Mapping[str, Any], motor: MotorPars) -> None:
    injections = parse(values["injections"], float(par["T_s"]))
    injector = st["injector"]
    injector["on"] = values["fault_injection"]
    injector["n"] = len(injections)
    injector["list"][: len(injections)] = injections
    injector["copies"] = 1


PART = Part(parameters=PARAMETERS, state=(("injector", _INJECTOR),), check=_check, start=_start)


@kernel
def _random(par, it, period):
    seed = it.seed if it.seed != 0 else par.seed
    return normal(seed, period, _CHANNEL + np.uint64(it.unit))


@kernel
def _added(par, st, it, low):
    """What is added to a true quantity; `low` is what takes it away altogether."""
    if it.type == _OFF:
        return low
    if it.type == _GARBAGE:
        return it.magnitude * _random(par, it, st.period)
    if it.type == _SLOW:
        lapse = (st.period - it.begin) * par.T_s
        return it.magnitude * (1.0 - math.exp(-lapse / _SLOW_TIME))
    if it.type == _INTERMITTENT:
        return it.magnitude if _random(par, it, st.period) > 0.0 else 0.0
    return it.magnitude


@kernel
def _command_fault(par, it, period):
    """What becomes of the command for a period."""
    if it.type == _GARBAGE:
        return SPOIL
    if it.type == _WRONG:
        return SHIFT
    if it.type == _STUCK:
        return FREEZE
    if it.type == _DUPLICATED:
        return REPEAT
    if it.type == _INTERMITTENT and _random(par, it, period) > 0.0:
        return 0
    if it.type == _REORDERED and period % np.uint64(2) == 0:
        return 0  # of two that are swapped the later one comes in time
    return LOSE


@kernel
def inject_causes(par, st):
    """What the injections do to the truth in this period, and to the next command."""
    inj = st.injector
    inj.tau_L, inj.u_dc, inj.warmth = 0.0, 0.0, 0.0
    inj.jammed = False
    inj.duty_link = 0
    for n in range(inj.n):
        it = inj.list[n]
        following = st.period + np.uint64(1)
        if it.unit == _DUTY_LINK and following >= it.begin and following < it.end:
            inj.duty_link = _command_fault(par, it, following)
            inj.duty_error = it.magnitude
        if st.period < it.begin or st.period >= it.end:
            continue
        if it.unit == _DC_LINK:
            inj.u_dc += _added(par, st, it, 1.0 - par.dc_voltage)
        elif it.unit == _LOAD:
            if it.type == _STUCK:
                inj.jammed = True
            else:
                inj.tau_L += _added(par, st, it, -par.load_torque)
        elif it.unit == _TEMPERATURE:
            inj.warmth += _added(par, st, it, 0.0)
    par.tau_L = par.load_torque + inj.tau_L
    par.u_dc = max(1.0, par.dc_voltage + inj.u_dc)
    if inj.jammed:
        st.w_M = 0.0


@kernel
def inject_gates(par, st):
    """What the injections do to the legs of the inverter."""
    inj = st.injector
    inj.some_leg_off = False
    for x in range(3):
        inj.leg_off[x] = 0
    for n in range(inj.n):
        it = inj.list[n]
        if it.unit < _LEG_A or it.unit > _LEG_C or st.period < it.begin or st.period >= it.end:
            continue
        x = it.unit - _LEG_A
        if not it.holds:
            it.held = st.duty[x]
            it.holds = True
        if it.type == _OFF or (it.type == _INTERMITTENT and _random(par, it, st.period) > 0.0):
            inj.leg_off[x] = 1
            inj.some_leg_off = True
        elif it.type == _STUCK:
            st.duty[x] = it.held
        elif it.type == _GARBAGE:
            st.duty[x] = abs(math.sin(10.0 * _random(par, it, st.period)))
        elif it.type == _WRONG:
            st.duty[x] = min(max(st.duty[x] + it.magnitude, 0.0), 1.0)


@kernel
def _faulty(par, st, it, channel, true):
    """What a sensor shows instead of the true value."""
    inj = st.injector
    if not it.holds:
        it.held = true
        it.holds = True
    if it.type == _OFF:
        return 0.0
    if it.type == _STUCK:
        return it.held
    if it.type == _GARBAGE:
        # now and then no number at all
        number = _random(par, it, st.period)
        return np.nan if number > 1.5 else 10.0 * it.magnitude * number
    if it.type == _WRONG:
        return true + it.magnitude
    if it.type == _SLOW:
        it.held += (1.0 - math.exp(-par.T_s / it.magnitude)) * (true - it.held)
        return it.held
    if it.type == _DELAYED:
        return inj.history[(st.period - np.uint64(it.magnitude)) % np.uint64(_HISTORY), channel]
    return 0.0 if _random(par, it, st.period) > 0.0 else true


@kernel
def _set(fb, channel, value):
    if channel == 0:
        fb.i_a = value
    elif channel == 1:
        fb.i_b = value
    elif channel == 2:
        fb.i_c = value
    elif channel == 3:
        fb.encoder_angle = value
    else:
        fb.dc_voltage = value


@kernel
def _inject_feedback_link(par, st, it, fb):
    inj = st.injector
    k = st.period
    if it.type == _OFF or it.type == _DROPPED:
        inj.copies = 0
    elif it.type == _INTERMITTENT:
        inj.copies = 0 if _random(par, it, k) > 0.0 else 1
    elif it.type == _DUPLICATED:
        inj.copies = 2
    elif it.type == _REORDERED:
        # of two that are swapped the earlier one comes after the later one, too late
        inj.copies = 2 if k % np.uint64(2) == 1 else 0
    elif it.type == _GARBAGE:
        fb.i_a, fb.encoder_angle = np.nan, np.inf
    elif it.type == _WRONG:
        fb.derating += it.magnitude
    elif it.type == _STUCK:
        row = inj.history[(it.begin - np.uint64(1)) % np.uint64(_HISTORY)]
        if not it.holds:
            it.holds = True
            for channel in range(5):
                inj.stuck[channel] = row[channel]
        for channel in range(5):
            _set(fb, channel, inj.stuck[channel])
    else:
        inj.late = int(it.magnitude)
        row = inj.history[(k - np.uint64(it.magnitude)) % np.uint64(_HISTORY)]
        for channel in range(5):
            _set(fb, channel, row[channel])
        fb.period = k - np.uint64(it.magnitude)


@kernel
def inject_sample(par, st, fb):
    """What the injections do to what the drive measures."""
    inj = st.injector
    row = inj.history[st.period % np.uint64(_HISTORY)]
    row[0], row[1], row[2] = fb.i_a, fb.i_b, fb.i_c
    row[3], row[4] = fb.encoder_angle, fb.dc_voltage
    inj.copies, inj.late = 1, 0
    for n in range(inj.n):
        it = inj.list[n]
        if st.period < it.begin or st.period >= it.end:
            continue
        if it.unit <= _DC_SENSOR:
            channel = it.unit - _CURRENT_A
            value = _faulty(par, st, it, channel, row[channel])
            # more than a turn off is no angle any more, but a number that is wrong
            if channel == _ENCODER and not abs(it.magnitude) > 2.0 * math.pi:
                value %= 2.0 * math.pi
            _set(fb, channel, value)
        elif it.unit == _FEEDBACK_LINK:
            _inject_feedback_link(par, st, it, fb)
