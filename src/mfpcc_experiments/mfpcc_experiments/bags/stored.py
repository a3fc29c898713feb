"""
What a recording says of its run, held to what it can be.

A file may come from anybody, and be damaged or made up. What makes no sense is left out, as if it
had not been stored, and a note says so; all that reads a recording can rely on the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from mfpcc_experiments.notes import Note, warning

_LONGEST_LABEL = 200
_LONGEST_TEXT = 10_000
_MOST = 1e9  # of any quantity in SI units
_DEEPEST = 8
_SHOWN = 60


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 1 << 63


def _is_number(value: Any) -> bool:
    return _is_integer(value) or (isinstance(value, float) and math.isfinite(value))


def _is_quantity(value: Any) -> bool:
    return _is_number(value) and abs(value) <= _MOST


def _is_count(value: Any) -> bool:
    return _is_integer(value) and value >= 0


def _is_label(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= _LONGEST_LABEL and value.isprintable()


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= _LONGEST_TEXT


def _is_bounded(value: Any, depth: int = 0) -> bool:
    """Whether it is something that JSON holds, of no absurd size."""
    if depth > _DEEPEST:
        return False
    if isinstance(value, Mapping):
        return all(_is_label(k) and _is_bounded(v, depth + 1) for k, v in value.items())
    if isinstance(value, list):
        return all(_is_bounded(item, depth + 1) for item in value)
    return value is None or isinstance(value, bool) or _is_number(value) or _is_text(value)


def _is_window(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 2
        and all(map(_is_quantity, value))
        and value[0] < value[1]
    )


def _is_motor(value: Any) -> bool:
    """A motor file: what is a quantity in it is one that a motor can have."""
    return (
        _is_bounded(value)
        and isinstance(value, Mapping)
        and all(
            _is_quantity(value[name])
            for name in ("R_s", "L_d", "L_q", "psi_f", "n_p", "J", "i_max", "speed_max_rpm", "u_dc")
            if name in value
        )
    )


def _is_parameter(name: str, value: Any) -> bool:
    if name == "schedule":
        return isinstance(value, list) and all(map(_is_text, value))
    values = value if isinstance(value, list) else [value]
    return all(isinstance(v, bool) or _is_number(v) or _is_text(v) for v in values)


def _is_change(value: Any) -> bool:
    return (
        isinstance(value, Mapping)
        and _is_count(value.get("period"))
        and _is_label(value.get("node"))
        and _is_label(value.get("name"))
        and _is_parameter(value["name"], value.get("value"))
    )


def _is_fault(value: Any) -> bool:
    return (
        isinstance(value, Mapping)
        and _is_count(value.get("period"))
        and all(_is_label(value.get(name)) for name in ("node", "code"))
        and _is_text(value.get("detail"))
    )


def _are(check: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list) and all(map(check, value))


def _maps_to(check: Callable[[Any], bool], *names: str) -> Callable[[Any], bool]:
    """A mapping to what passes a check, with at least these names."""
    return lambda value: (
        isinstance(value, Mapping)
        and set(names) <= set(value)
        and all(_is_label(k) and check(v) for k, v in value.items())
    )


_CONFIG: dict[str, Callable[[Any], bool]] = {
    **dict.fromkeys(("experiment", "scheme", "motor", "engine"), _is_label),
    "seed": _is_integer,
    "T_s": lambda value: _is_number(value) and 1e-7 <= value < 1.0,
    "window_s": _is_window,
    "n_p": lambda value: _is_integer(value) and 0 < value <= 1000,
    "R_s": lambda value: _is_quantity(value) and value > 0.0,
    "oversampling": _is_count,
    "parameters": _maps_to(lambda value: isinstance(value, Mapping)),
    "motor_file": _is_motor,
    "versions": _maps_to(_is_label),
    "scenario": lambda value: isinstance(value, Mapping) and _is_bounded(value),
}

_SUMMARY: dict[str, Callable[[Any], bool]] = {
    "step_time_us": _maps_to(lambda value: value is None or _is_number(value)),
    "parameter_changes": _are(_is_change),
    "faults": _are(_is_fault),
    "lost_periods": _is_count,
    "missed_periods": _is_count,
    "real_time_factor": _maps_to(_is_quantity, "asked", "achieved"),
    "gaps": _maps_to(_is_count),
    "incomplete": _is_text,
}


def configuration(content: Mapping[str, Any]) -> tuple[dict[str, Any], list[Note]]:
    """
    The part of a stored configuration that makes sense.

    Parameters
    ----------
    content : mapping
        As it was stored.

    Returns
    -------
    dict
        Without what makes no sense.
    list of Note
        What was left out.
    """
    found, notes = _sound(content, _CONFIG, "the stored configuration")
    for node, values in found.get("parameters", {}).items():
        bad = [name for name, value in values.items() if not _is_parameter(name, value)]
        found["parameters"] = {
            **found["parameters"],
            node: {name: value for name, value in values.items() if name not in bad},
        }
        notes += [_left_out(f"{node}'s parameter {shown(name)}", values[name]) for name in bad]
    return found, notes


def summary(content: Mapping[str, Any]) -> tuple[dict[str, Any], list[Note]]:
    """The part of a stored summary that makes sense; as of `configuration`."""
    return _sound(content, _SUMMARY, "the stored summary")


def _sound(
    content: Mapping[str, Any], checks: Mapping[str, Callable[[Any], bool]], what: str
) -> tuple[dict[str, Any], list[Note]]:
    found: dict[str, Any] = {}
    notes = []
    for key, value in content.items():
        if value is None:
            continue  # not stored
        if _is_label(key) and checks.get(key, _is_bounded)(value):
            found[key] = value
        else:
            notes.append(_left_out(f"{shown(key)} of {what}", value))
    return found, notes


def _left_out(name: str, value: Any) -> Note:
    return warning(f"{name} makes no sense and is left out: {shown(value)}")


def shown(value: Any) -> str:
    """A value of a stranger in one short line."""
    try:
        text = value if isinstance(value, str) else repr(value)
    except (ValueError, RecursionError):
        text = f"a {type(value).__name__} of absurd size"
    text = "".join(c if c.isprintable() else " " for c in text[: 2 * _SHOWN])
    return text if len(text) <= _SHOWN else text[:_SHOWN] + " ..."
