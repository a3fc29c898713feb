"""Numbers with their units as data sheets write them, read into SI units."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass

from pwm_node.names import unknown
from pwm_node.units import RPM

_POUND = 0.45359237  # kg, exactly
_POUND_FORCE = 4.4482216152605  # N, exactly: the pound times 9.80665 m/s^2
_INCH, _FOOT = 0.0254, 0.3048  # m, exactly
_LB_IN = _POUND_FORCE * _INCH  # N m
_OZ_IN = _LB_IN / 16.0
_LB_FT = _POUND_FORCE * _FOOT
_KGF_CM = 0.0980665  # N m, exactly

_TORQUE = {
    "Nm": 1.0,
    "mNm": 1e-3,
    "uNm": 1e-6,
    "kNm": 1e3,
    "Ncm": 1e-2,
    "ozin": _OZ_IN,
    "lbin": _LB_IN,
    "lbft": _LB_FT,
    "kgcm": _KGF_CM,
    "gcm": 1e-3 * _KGF_CM,
}
_SPEED = {"rpm": RPM, "krpm": 1e3 * RPM, "rps": 60.0 * RPM, "rad/s": 1.0}  # in rad/s
_VOLTAGE = {"V": 1.0, "mV": 1e-3, "uV": 1e-6, "kV": 1e3}

#: What may follow a number, by quantity, as `_spelt` spells it: how much of the SI unit it is.
UNITS: dict[str, dict[str, float]] = {
    "resistance": {"ohm": 1.0, "mohm": 1e-3, "uohm": 1e-6, "kohm": 1e3},
    "inductance": {"H": 1.0, "mH": 1e-3, "uH": 1e-6},
    "ke": {
        f"{volt}/{speed}": _VOLTAGE[volt] / s
        for volt in ("V", "mV", "uV")
        for speed, s in _SPEED.items()
    }
    | {"Vs/rad": 1.0, "mVs/rad": 1e-3, "Vs": 1.0, "mVs": 1e-3},
    "kv": {f"{speed}/V": s for speed, s in _SPEED.items()} | {"rad/Vs": 1.0, "KV": RPM},
    "kt": {f"{torque}/A": n_m for torque, n_m in _TORQUE.items()} | {"Nm/mA": 1e3, "mNm/mA": 1.0},
    "inertia": {
        "kgm2": 1.0,
        "kgcm2": 1e-4,
        "kgmm2": 1e-6,
        "gm2": 1e-3,
        "gcm2": 1e-7,
        "gmm2": 1e-9,
        "ozin2": _POUND / 16.0 * _INCH**2,
        "lbin2": _POUND * _INCH**2,
        "lbft2": _POUND * _FOOT**2,
        "ozins2": _OZ_IN,
        "lbins2": _LB_IN,
        "lbfts2": _LB_FT,
        "kgcms2": _KGF_CM,
        "gcms2": 1e-3 * _KGF_CM,
        "Nms2": 1.0,
        "mNms2": 1e-3,
    },
    "torque": _TORQUE,
    "current": {"A": 1.0, "mA": 1e-3},
    "speed": {speed: s / RPM for speed, s in _SPEED.items()},
    "voltage": _VOLTAGE,
}

# How units are written, and how they are spelt here. In this order; all that is left of a unit
# before is letters, digits and /, since signs of multiplication and powers are taken away.
_SPELLINGS = tuple(
    (re.compile(pattern), spelt)
    for pattern, spelt in (
        # turns per minute: min-1, 1/min, /min, r/min, rev/min, U/min, tr/min; of 1000 of them
        (r"min-1", "rpm"),
        (r"(?i)(?<![a-z])(?:revs?|rot|tr|r|u|1)?/min(?![a-z])", "rpm"),
        (r"(?i)rpm", "rpm"),
        (r"1000/?rpm|[kK]rpm", "krpm"),
        (r"(?i)(?<![a-z])(?:revs?|r|u)/s(?:ec)?(?![a-z])", "rps"),
        (r"(?i)volts?", "V"),
        (r"(?i)amp(?:ere)?s?", "A"),
        (r"V-1$", "/V"),
        (r"A-1$", "/A"),
        (r"(?i)ohms?$", "ohm"),
        (r"(?i)(?<![a-z])(?:oz|lb|in|ft)(?:-?(?:oz|lb|in|ft|f|s|sec|2))+(?![a-z])", str.lower),
        (r"-", ""),
        (r"sec", "s"),
        (r"(oz|lb)f(?!t)", r"\1"),
        (r"(k?g)f", r"\1"),
        (r"^(in|ft)(oz|lb)", r"\2\1"),
        (r"^cmk(?:g|p)", "kgcm"),
    )
)
# What the letters behind volt or ampere say of how it counts
_COUNTED = {"rms": "rms", "eff": "rms", "pk": "peak", "peak": "peak", "p": "peak", "dc": "dc"}


class SheetError(ValueError):
    """A data sheet from which no motor can be made; the text says what is missing or wrong."""


@dataclass(frozen=True)
class Quantity:
    """
    A number of a data sheet.

    Attributes
    ----------
    value : float
        In SI units; a speed in r/min.
    counted : str, optional
        rms, peak or dc, where the unit says it: `Vrms/krpm`, `N m/Apk`.
    """

    value: float
    counted: str | None = None


def quantity(kind: str, text: str) -> float:
    """The value of `read`."""
    return read(kind, text).value


def read(kind: str, text: str) -> Quantity:
    """
    Read a number with its unit, as data sheets write it: `0.56 mH`, `70 µH`, `1,02 mV/min⁻¹`.

    Parameters
    ----------
    kind : str
        A key of `UNITS`.

    Raises
    ------
    SheetError
        If it is no number, has no unit or one of something else, or is not above 0.
    """
    units = UNITS[kind]
    plain = _plain(text)
    if kind == "kv":  # as model makers write it: KV400, 400 kv
        plain = re.sub(r"(?i)^kv *[=:]? *([0-9.,]+)$|^([0-9.,]+) *kv$", r"\1\2 KV", plain)
    match = re.fullmatch(
        r"([-+]?[0-9.,]*[0-9][0-9.,]*(?: [0-9]{3}(?![0-9]))*(?:[.,][0-9]+)?(?:[eE][-+]?[0-9]+)?)"
        r"(?: *[x*] *10\^?([-+]?[0-9]+))?"
        r" *([^0-9.,\s-].*|1/.*)?",
        plain,
    )
    if match is None:
        raise SheetError(f"'{text}' is no {kind}; expected a number with its unit, {_any(units)}")
    digits, power, written = match.groups()
    if not written:
        raise SheetError(f"'{text}' has no unit; {kind} takes {_any(units)}")
    unit, counted = _spelt(written, kind)
    if unit not in units:
        raise SheetError(f"'{text}': {unknown('unit', unit, units)}")
    value = _number(digits, text, kind) * 10.0 ** int(power or 0) * units[unit]
    if not (math.isfinite(value) and value > 0.0):
        raise SheetError(f"'{text}': {kind} must be above 0")
    return Quantity(value, counted)


def _plain(text: str) -> str:
    """One spelling of what Unicode has several of: micro, ohm, powers, minus, spaces."""
    text = unicodedata.normalize("NFKC", text)
    for signs, plain in (
        ("μ", "u"),
        ("Ω", "ohm"),
        ("\u2010\u2011\u2012\u2013\u2014\u2212", "-"),
        ("·⋅•∙×✕", "*"),
    ):
        for sign in signs:
            text = text.replace(sign, plain)
    return " ".join(text.split())


def _number(digits: str, text: str, kind: str) -> float:
    """A number with a decimal point or comma, and spaces or commas between thousands."""
    digits = digits.strip().rstrip(",")
    if re.fullmatch(r"[-+]?[0-9]{1,3}( [0-9]{3})+([.,][0-9]+)?", digits):
        digits = digits.replace(" ", "")
    if re.fullmatch(r"[-+]?[1-9][0-9]{0,2},[0-9]{3}", digits):
        raise SheetError(
            f"'{text}': does the comma part thousands or decimals? {digits.replace(',', '.')} or "
            f"{digits.replace(',', '')} is clear"
        )
    if re.fullmatch(r"[-+]?[0-9]{1,3}(,[0-9]{3})+\.[0-9]+|[-+]?[0-9]{1,3}(,[0-9]{3}){2,}", digits):
        digits = digits.replace(",", "")
    try:
        return float(digits.replace(",", "."))
    except ValueError:
        raise SheetError(f"'{text}' is no {kind}: '{digits}' is no number") from None


def _spelt(written: str, kind: str) -> tuple[str, str | None]:
    """A unit as `UNITS` spells it, and how its volt or ampere counts, if it says so."""
    unit = re.sub(r"[\s*.^_()]", "", written)
    counted = None
    found = re.search(r"(?i)(?<=[AV])-?(rms|eff|peak|pk|p|dc)(?![a-z])", unit)
    if found is not None and kind in ("ke", "kt", "current", "voltage"):
        counted = _COUNTED[found.group(1).lower()]
        unit = unit[: found.start()] + unit[found.end() :]
    for pattern, spelling in _SPELLINGS:
        if isinstance(spelling, str):
            unit = pattern.sub(spelling, unit)
        else:
            unit = pattern.sub(lambda match: match.group().lower(), unit)
    return unit, counted


def _any(units: Iterable[str]) -> str:
    return "one of: " + ", ".join(units)
