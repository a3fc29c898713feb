"""
From a motor's data sheet to the parameters used here, with the conversion shown.

Data sheets give what can be measured between two terminals, in units and conventions of their own;
the equations here are per phase of the equivalent star, with amplitudes. For a star connection or
its equivalent, with line-to-line values R_ll, L_ll and the EMF between two terminals:

    R_s = R_ll / 2,   L = L_ll / 2   (whatever the connection)
    R_s = R_ph / 3,   L = L_ph / 3   (from one phase of a delta; of a star it is itself)
    psi_f = E_ll,peak / (sqrt(3) w_m),   w_m = n_p w_M
    tau = 1.5 n_p psi_f i (i: amplitude of the phase current)

The torque constant says how the sheet counts current: `rms` and `peak` of a sinusoidal phase
current, or `dc` as for brushless DC motors with block commutation (maxon, Faulhaber), where two
terminals carry the current and kT equals the line-to-line kE.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from mfpcc_experiments.datasheet.quantities import SheetError
from pwm_node.names import unknown
from pwm_node.units import RPM

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


@dataclass(frozen=True)
class Sheet:
    """
    What a data sheet says, in SI units, each as the sheet means it.

    Attributes
    ----------
    poles : int
        Number of poles, twice that of the pole pairs.
    resistance, inductance : float
        Between two terminals (ohm, H), or of one phase of the winding if `per_phase`.
    inductance_q : float, optional
        Of the q axis, where the sheet gives both; `inductance` is of the d axis then (H).
    kt, kv, ke : float, optional
        Torque constant (N m/A), speed constant (rad/s per V, between terminals, peak), voltage
        constant (V s/rad mechanical). At least one is needed.
    winding : str
        star or delta: what a phase of it is. Values between terminals do not depend on it.
    kt_current : str
        How `kt` counts the current of a terminal: rms, peak or dc.
    current_counted : str, optional
        How `current` counts; default: as `kt` does.
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
    winding: str = "star"
    kt: float | None = None
    kv: float | None = None
    ke: float | None = None
    kt_current: str = "rms"
    ke_voltage: str = "ll-rms"
    torque: float | None = None
    current: float | None = None
    speed: float | None = None
    no_load_speed: float | None = None
    current_counted: str | None = None

    @property
    def rated_amplitude(self) -> float | None:
        """Amplitude of the rated current of a terminal (A)."""
        if self.current is None:
            return None
        return _CURRENT[self.current_counted or self.kt_current] * self.current


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


def convert(sheet: Sheet) -> Motor:
    """The parameters of a motor file from a data sheet."""
    for kind, value, known in (
        ("way to count current", sheet.kt_current, _CURRENT),
        ("way to count current", sheet.current_counted or "rms", _CURRENT),
        ("way to count voltage", sheet.ke_voltage, _EMF),
        ("winding", sheet.winding, ("star", "delta")),
    ):
        if value not in known:
            raise SheetError(unknown(kind, value, known))
    if sheet.poles < 2 or sheet.poles % 2:
        raise SheetError(f"{sheet.poles} poles: a rotor has an even number of them, 2 at least")
    motor = Motor()
    n_p = sheet.poles // 2
    motor.steps.append(("n_p", f"{sheet.poles} poles / 2", f"{n_p}"))

    share, by = 0.5, "line-to-line / 2"
    if sheet.per_phase:
        delta = sheet.winding == "delta"
        share, by = (1.0 / 3.0, "per phase of the delta / 3") if delta else (1.0, "per phase")
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
    if sheet.rated_amplitude is not None:
        rated = sheet.rated_amplitude
        counted = sheet.current_counted or sheet.kt_current
        how = f"{sheet.current:.4g} A ({counted}) as an amplitude"
    elif sheet.torque is not None:
        rated = sheet.torque / per_ampere
        how = f"{sheet.torque:.4g} N m / (1.5 n_p psi_f)"
    else:
        raise SheetError("neither rated current nor rated torque: one of them is needed")
    motor.steps.append(("rated current", how, f"{rated:.4g} A"))
    i_max = 2.0 * rated
    motor.steps.append(("i_max", "our choice: 2 x rated", f"{i_max:.4g} A"))

    reachable = sheet.voltage / math.sqrt(3.0) / (n_p * psi_f) / RPM
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
        emf, counted = _EMF[sheet.ke_voltage], sheet.ke_voltage
        if sheet.winding == "delta" and counted.startswith("phase"):
            # a phase of a delta lies between two terminals
            emf, counted = emf / math.sqrt(3.0), f"{counted} of the delta"
        psi = sheet.ke * emf / n_p
        how = f"{sheet.ke:.4g} V s ({counted}) x {emf:.4g} / n_p"
        found.append(("kE", how, psi))
    if sheet.kt is not None:
        amplitude = _CURRENT[sheet.kt_current]
        psi = sheet.kt / (1.5 * n_p * amplitude)
        how = f"{sheet.kt:.4g} N m/A ({sheet.kt_current}) / (1.5 n_p {amplitude:.4g})"
        found.append(("kT", how, psi))
    if sheet.kv is not None:
        psi = 1.0 / (sheet.kv * math.sqrt(3.0) * n_p)
        how = f"1 / ({sheet.kv / RPM:.4g} (r/min)/V x sqrt(3) n_p)"
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
    if sheet.torque is not None and sheet.rated_amplitude is not None:
        torque = per_ampere * sheet.rated_amplitude
        # friction and iron take a part of it, and the two are rounded and rated each by itself
        if not 0.8 < sheet.torque / torque < 1.0 + 2.0 * TOLERANCE:
            yield (
                f"rated torque and current contradict {first}: {sheet.current:.4g} A "
                f"({sheet.current_counted or sheet.kt_current}) give {torque:.4g} N m, the sheet "
                f"says {sheet.torque:.4g} N m{_hint(sheet.torque / torque)}"
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
