"""Parameter changes at given simulated times.

A schedule is a list of texts such as ``0.2 load_torque 5.0``: the time (s), the parameter, its
new value. It is how a scenario steps the load, moves the speed or switches the scheme: the node
applies an entry at the beginning of the period that it falls due, through the same checks as a
change from outside, so that a run is the same each time and in each engine.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from pwm_node.errors import ForPeople
from pwm_node.parameters import ParameterError, Table, Value

Changes = dict[str, Value]


class ScheduleError(ForPeople, ValueError):
    """An entry that cannot be understood or accepted; the text says which and why."""


def period_of(time: float, T_s: float) -> int:
    """Return the first period that begins at or after a time.

    Parameters
    ----------
    time : float
        Simulated time (s).
    T_s : float
        PWM period (s).
    """
    # 0.3 / 0.0001 is 2999.9999999999995 or 3000.0000000000005 as it pleases: forgive a millionth.
    return math.ceil(time / T_s - 1e-6)


def parse(
    entries: Iterable[str],
    table: Table,
    T_s: float,
    initial: Mapping[str, Value] | None = None,
) -> list[tuple[int, Changes]]:
    """Read a schedule.

    Parameters
    ----------
    entries : iterable of str
        The entries, in any order.
    table : Table
        The node's parameters.
    T_s : float
        PWM period (s).
    initial : mapping, optional
        The complete values before the first entry; without them the defaults. Rules across
        several parameters are checked along the schedule, beginning with these.

    Returns
    -------
    list of (int, dict)
        Period number and the changes that are due at its beginning, one item per period, sorted.
        Of two entries for the same parameter and period the later in the list counts.

    Raises
    ------
    ScheduleError
        The text names the entry and the reason.
    """
    due: dict[int, list[tuple[str, str, Value]]] = {}
    for entry in entries:
        period, name, value = _parse_entry(entry, table, T_s)
        due.setdefault(period, []).append((entry, name, value))

    current = dict(table.defaults() if initial is None else initial)
    schedule: list[tuple[int, Changes]] = []
    for period in sorted(due):
        changes = {name: value for _, name, value in due[period]}
        try:
            current.update(table.validate(changes, current))
        except ParameterError as error:
            texts = ", ".join(f"'{entry}'" for entry, _, _ in due[period])
            raise ScheduleError(f"schedule entry {texts}: {error.reason}") from None
        schedule.append((period, changes))
    return schedule


def _parse_entry(entry: str, table: Table, T_s: float) -> tuple[int, str, Value]:
    parts = entry.split(None, 2)
    if len(parts) != 3:
        raise ScheduleError(
            f"schedule entry '{entry}': expected '<time in s> <parameter> <value>', "
            "for example '0.2 load_torque 5.0'"
        )
    time_text, name, value_text = parts
    try:
        time = float(time_text)
    except ValueError:
        time = math.nan
    if not (math.isfinite(time) and time >= 0.0):
        raise ScheduleError(
            f"schedule entry '{entry}': '{time_text}' is not a time; a number of seconds from 0 "
            "is expected"
        )
    try:
        return period_of(time, T_s), name, table[name].parse(value_text)
    except ParameterError as error:
        raise ScheduleError(f"schedule entry '{entry}': {error.reason}") from None
