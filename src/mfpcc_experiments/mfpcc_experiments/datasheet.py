"""
From a motor's data sheet to the parameters used here, with the conversion shown.

Data sheets give what can be measured between two terminals, in units and conventions of their own;
the equations here are per phase of the equivalent star, with amplitudes. For a star connection or
its equivalent, with line-to-line values R_ll, L_ll and the EMF between two terminals:

    R_s = R_ll / 2,   L = L_ll / 2
    psi_f = E_ll,peak / (sqrt(3) w_m),   w_m = n_p w_M
    tau = 1.5 n_p psi_f i (i: amplitude of the phase current)

The torque constant says how the sheet counts current: `rms` and `peak` of a sinusoidal phase
current, or `dc` as for brushless DC motors with block commutation (maxon, Faulhaber), where two
terminals carry the current and kT equals the line-to-line kE.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from pwm_node.names import unknown

_RPM = 2.0 * math.pi / 60.0

# What may follow a number, by quantity: how much of the SI unit it is.
UNITS: dict[str, dict[str, float]] = {
    "resistance": {"ohm": 1.0, "mohm": 1e-3, "Ω": 1.0, "mΩ": 1e-3},
    "inductance": {"H": 1.0, "mH": 1e-3, "uH": 1e-6, "µH": 1e-6},
    "ke": {
        "V/(rad/s)": 1.0,
        "V/krpm": 1e-3 / _RPM,
        "mV/rpm": 1e-3 / _RPM,
        "V/rpm": 1.0 / _RPM,
    },
    "kv": {"rpm/V": _RPM},
    "kt": {"Nm/A": 1.0, "mNm/A": 1e-3, "Ncm/A": 1e-2, "ozin/A": 7.0615518e-3},
    "inertia": {
        "kgm2": 1.0,
        "kgcm2": 1e-4,
        "gcm2": 1e-7,
        "ozins2": 7.0615518e-3,
    },
    "torque": {"Nm": 1.0, "mNm": 1e-3, "Ncm": 1e-2, "ozin": 7.0615518e-3},
    "current": {"A": 1.0, "mA": 1e-3},
    "speed": {"rpm": 1.0},
    "voltage": {"V": 1.0},
}

# Peak phase EMF over what the sheet's voltage constant gives
_EMF = {
    "ll-peak": 1.0 / math.sqrt(3.0),
    "ll-rms": math.sqrt(2.0 / 3.0),
    "phase-peak": 1.0,
    "phase-rms": math.sqrt(2.0),
}
# Amplitude of the phase current over the sheet's ampere. Two terminals in block commutation: the
# mean torque of 1 A there takes a sinusoidal amplitude of 2 / sqrt(3) A.
_CURRENT = {"rms": math.sqrt(2.0), "peak": 1.0, "dc": 2.0 / math.sqrt(3.0)}

# Two statements of one sheet that differ by more than this contradict each other.
TOLERANCE = 0.05


class SheetError(ValueError):
    """A data sheet from which no motor can be made; the text says what is missing or wrong."""


@dataclass(frozen=True)
class Sheet:
    """
    What a data sheet says, in SI units, each as the sheet means it.

    Attributes
    ----------
    poles : int
        Number of poles, twice that of the pole pairs.
    resistance, inductance : float
        Between two terminals (ohm, H), or per phase if `per_phase`.
    inductance_q : float, optional
        Of the q axis, where the sheet gives both; `inductance` is of the d axis then (H).
    kt, kv, ke : float, optional
        Torque constant (N m/A), speed constant (rad/s per V, between terminals, peak), voltage
        constant (V s/rad mechanical). At least one is needed.
    kt_current : str
        How `kt` and the currents count: rms, peak or dc.
    ke_voltage : str
        How `ke` counts: ll-peak, ll-rms, phase-peak or phase-rms.
    inertia : float
        Of the rotor (kg m^2).
    torque, current, speed : float, optional
        Rated torque (N m), current (A) and speed (r/min).
    no_load_speed : float, optional
        At `voltage` (r/min).
    voltage : float
        DC-link voltage it is meant for (V).
    """

    poles: int
    resistance: float
    inductance: float
    inertia: float
    voltage: float
    inductance_q: float | None = None
    per_phase: bool = False
    kt: float | None = None
    kv: float | None = None
    ke: float | None = None
    kt_current: str = "rms"
    ke_voltage: str = "ll-rms"
    torque: float | None = None
    current: float | None = None
    speed: float | None = None
    no_load_speed: float | None = None


@dataclass
class Motor:
    """
    The parameters, how they came about, and what does not fit.

    Attributes
    ----------
    values : dict
        R_s, L_d, L_q, psi_f, n_p, J, i_max, speed_max_rpm, u_dc as in a motor file.
    steps : list of (str, str, str)
        Quantity, conversion, result, each with units.
    contradictions : list of str
        Statements of the sheet that exclude each other.
    """

    values: dict[str, float] = field(default_factory=dict)
    steps: list[tuple[str, str, str]] = field(default_factory=list)
    contradictions: list[str] = field(default_factory=list)


def quantity(kind: str, text: str) -> float:
    """
    Read a number with its unit, such as `0.56 mH`, into SI units.

    Parameters
    ----------
    kind : str
        A key of `UNITS`.
    """
    units = UNITS[kind]
    match = re.fullmatch(r"\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(\S.*)?", text)
    if match is None:
        raise SheetError(f"'{text}' is no {kind}; expected a number with its unit, {_any(units)}")
    unit = re.sub(r"[\s·*^]|²", lambda m: "2" if m.group() == "²" else "", match.group(2) or "")
    if not unit:
        raise SheetError(f"'{text}' has no unit; {kind} takes {_any(units)}")
    if unit not in units:
        raise SheetError(f"'{text}': {unknown('unit', unit, units)}")
    try:
        value = float(match.group(1)) * units[unit]
    except ValueError:
        raise SheetError(f"'{text}' is no {kind}: '{match.group(1)}' is no number") from None
    if not (math.isfinite(value) and value > 0.0):
        raise SheetError(f"'{text}': {kind} must be above 0")
    return value


def convert(sheet: Sheet) -> Motor:
    """The parameters of a motor file from a data sheet."""
    for kind, value, known in (
        ("way to count current", sheet.kt_current, _CURRENT),
        ("way to count voltage", sheet.ke_voltage, _EMF),
    ):
        if value not in known:
            raise SheetError(unknown(kind, value, known))
    if sheet.poles < 2 or sheet.poles % 2:
        raise SheetError(f"{sheet.poles} poles: a rotor has an even number of them, 2 at least")
    motor = Motor()
    n_p = sheet.poles // 2
    motor.steps.append(("n_p", f"{sheet.poles} poles / 2", f"{n_p}"))

    share, by = (1.0, "per phase") if sheet.per_phase else (0.5, "line-to-line / 2")
    R_s = share * sheet.resistance
    L_d = share * sheet.inductance
    L_q = share * (sheet.inductance_q or sheet.inductance)
    motor.steps.append(("R_s", f"{sheet.resistance:.4g} ohm {by}", f"{R_s:.4g} ohm"))
    motor.steps.append(("L_d", f"{1e3 * sheet.inductance:.4g} mH {by}", f"{1e3 * L_d:.4g} mH"))
    motor.steps.append(
        (
            "L_q",
            f"{1e3 * (sheet.inductance_q or sheet.inductance):.4g} mH {by}",
            f"{1e3 * L_q:.4g} mH",
        )
    )

    fluxes = _fluxes(sheet, n_p)
    if not fluxes:
        raise SheetError("no torque, voltage or speed constant: one of kT, kE, kV is needed")
    for name, how, psi in fluxes:
        motor.steps.append((f"psi_f ({name})", how, f"{psi:.5g} V s"))
    psi_f = fluxes[0][2]
    motor.steps.append(("psi_f", f"from {fluxes[0][0]}", f"{psi_f:.5g} V s"))
    motor.steps.append(("J", "rotor", f"{sheet.inertia:.4g} kg m^2"))

    per_ampere = 1.5 * n_p * psi_f
    if sheet.current is not None:
        rated = _CURRENT[sheet.kt_current] * sheet.current
        how = f"{sheet.current:.4g} A ({sheet.kt_current}) as an amplitude"
    elif sheet.torque is not None:
        rated = sheet.torque / per_ampere
        how = f"{sheet.torque:.4g} N m / (1.5 n_p psi_f)"
    else:
        raise SheetError("neither rated current nor rated torque: one of them is needed")
    motor.steps.append(("rated current", how, f"{rated:.4g} A"))
    i_max = 2.0 * rated
    motor.steps.append(("i_max", "our choice: 2 x rated", f"{i_max:.4g} A"))

    reachable = sheet.voltage / math.sqrt(3.0) / (n_p * psi_f) / _RPM
    speed = sheet.speed if sheet.speed is not None else 0.8 * reachable
    motor.steps.append(
        (
            "speed_max_rpm",
            "rated" if sheet.speed is not None else "our choice: 80 % of the ideal no-load speed",
            f"{speed:.4g} r/min",
        )
    )
    motor.values = {
        "R_s": R_s,
        "L_d": L_d,
        "L_q": L_q,
        "psi_f": psi_f,
        "n_p": n_p,
        "J": sheet.inertia,
        "i_max": i_max,
        "speed_max_rpm": speed,
        "u_dc": sheet.voltage,
    }
    motor.contradictions = list(_contradictions(sheet, fluxes, per_ampere, reachable))
    return motor


def _fluxes(sheet: Sheet, n_p: int) -> list[tuple[str, str, float]]:
    """Flux linkage of the magnets from each constant there is: name, conversion, V s."""
    found = []
    if sheet.ke is not None:
        psi = sheet.ke * _EMF[sheet.ke_voltage] / n_p
        how = f"{sheet.ke:.4g} V s ({sheet.ke_voltage}) x {_EMF[sheet.ke_voltage]:.4g} / n_p"
        found.append(("kE", how, psi))
    if sheet.kt is not None:
        amplitude = _CURRENT[sheet.kt_current]
        psi = sheet.kt / (1.5 * n_p * amplitude)
        how = f"{sheet.kt:.4g} N m/A ({sheet.kt_current}) / (1.5 n_p {amplitude:.4g})"
        found.append(("kT", how, psi))
    if sheet.kv is not None:
        psi = 1.0 / (sheet.kv * math.sqrt(3.0) * n_p)
        how = f"1 / ({sheet.kv / _RPM:.4g} (r/min)/V x sqrt(3) n_p)"
        found.append(("kV", how, psi))
    return found


def _contradictions(
    sheet: Sheet, fluxes: list[tuple[str, str, float]], per_ampere: float, reachable: float
) -> Iterable[str]:
    """What in the sheet excludes what else, in sentences."""
    first, _, psi_f = fluxes[0]
    for name, _, psi in fluxes[1:]:
        if abs(psi / psi_f - 1.0) > TOLERANCE:
            yield (
                f"{first} and {name} contradict each other: they give psi_f = {psi_f:.4g} and "
                f"{psi:.4g} V s, {abs(psi / psi_f - 1.0):.0%} apart{_hint(psi / psi_f)}"
            )
    if sheet.torque is not None and sheet.current is not None:
        torque = per_ampere * _CURRENT[sheet.kt_current] * sheet.current
        # friction and iron take a part of it, and the two are rounded and rated each by itself
        if not 0.8 < sheet.torque / torque < 1.0 + 2.0 * TOLERANCE:
            yield (
                f"rated torque and current contradict {first}: {sheet.current:.4g} A "
                f"({sheet.kt_current}) give {torque:.4g} N m, the sheet says {sheet.torque:.4g} N m"
                f"{_hint(sheet.torque / torque)}"
            )
    if sheet.no_load_speed is not None:
        ideal = reachable
        if not 0.85 < sheet.no_load_speed / ideal < 1.0 + TOLERANCE:
            yield (
                f"no-load speed contradicts {first}: at {sheet.voltage:.4g} V it gives "
                f"{ideal:.4g} r/min, the sheet says {sheet.no_load_speed:.4g} r/min"
            )
    if sheet.speed is not None and sheet.speed > reachable:
        yield (
            f"rated speed {sheet.speed:.4g} r/min cannot be reached at {sheet.voltage:.4g} V: the "
            f"EMF alone takes it all at {reachable:.4g} r/min"
        )


def _hint(ratio: float) -> str:
    """Which mix-up of conventions would explain a ratio."""
    mixed = {
        "rms and peak": math.sqrt(2.0),
        "line-to-line and phase": math.sqrt(3.0),
        "line-to-line rms and phase peak": math.sqrt(1.5),
        "poles and pole pairs": 2.0,
        "dc and peak": 2.0 / math.sqrt(3.0),
    }
    for what, factor in mixed.items():
        if any(abs(ratio / f - 1.0) < 0.02 for f in (factor, 1.0 / factor)):
            return f"; as if {what} were mixed up"
    return ""


def _any(units: Iterable[str]) -> str:
    return "one of: " + ", ".join(units)


def yaml_text(motor: Motor, name: str, description: str, source: str) -> str:
    """The motor file, with a comment on how each value came about."""
    how = {step[0]: step[1] for step in motor.steps}
    units = {
        "R_s": "ohm",
        "L_d": "H",
        "L_q": "H",
        "psi_f": "V s",
        "n_p": "pole pairs",
        "J": "kg m^2",
        "i_max": "A",
        "speed_max_rpm": "r/min",
        "u_dc": "V",
    }
    lines = [f"name: {name}", f"description: {_quoted(description)}", f"source: {_quoted(source)}"]
    for key, value in motor.values.items():
        comment = units[key] + (f"; {how[key]}" if key in how else "")
        lines.append(f"{f'{key}: {value:.6g}':<24} # {comment}")
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
