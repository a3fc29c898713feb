"""
What happened in a recorded drive: who controlled the current, and when the gates were off.

It is read from the messages, period by period, not from the configuration: a run is what was
recorded, not what was planned. The parameters that were set, and the faults that the nodes latched,
tell why. `notes` says it in sentences, the same ones wherever a result is shown.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_controller import firmware
from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.measuring.events import Change, Fault, Off, Reign
from mfpcc_experiments.notes import Note, failure, info, warning
from pmsm_sim.parameters import TABLE as PLANT
from pwm_node import schedule
from pwm_node.parameters import ParameterError

if TYPE_CHECKING:
    from mfpcc_experiments.bags import Recording

_TABLES = {"pmsm_sim": PLANT, "mfpcc_controller": CONTROLLER}

#: Events of one kind that are told one by one; of more, their number.
_SHOWN = 3
# A fault switches the gates off with the command after its sample, at the latest.
_REACTION = 2
# Periods within which the change of a parameter in another process is dated.
_DATED_WITHIN = 2
# Faults that let the fallback scheme take over; the gates stay on.
_OF_SCHEMES = ("SCHEME", "PREDICTION")


def scheme_title(name: str) -> str:
    """Name of a scheme as it is printed: ``mls_mfpcc`` is MLS-MFPCC, ``firmware:F`` F in C."""
    return " -> ".join(_title(part) for part in name.split(" -> "))


def _title(name: str) -> str:
    folder = firmware.folder_of(name)
    return f"{folder.name} in C" if folder else name.upper().replace("_", "-")


@dataclass(frozen=True)
class History:
    """
    What happened in a recorded drive.

    Attributes
    ----------
    T_s : float
        PWM period (s).
    first, last : int
        First and last recorded period.
    reigns : tuple of Reign
        Who controlled; empty where nothing tells.
    offs : tuple of Off
        When the gates were off.
    faults : tuple of Fault
        What was latched.
    changes : tuple of Change
        Parameters that were set.
    """

    T_s: float
    first: int
    last: int
    reigns: tuple[Reign, ...]
    offs: tuple[Off, ...]
    faults: tuple[Fault, ...]
    changes: tuple[Change, ...]

    def reigns_in(self, first: int, end: int) -> list[Reign]:
        """Who controlled in the periods from `first` to before `end`."""
        return [reign for reign in self.reigns if reign.begin < end and reign.end > first]

    def scheme_in(self, first: int, end: int) -> str:
        """
        Name of what controlled in some periods, in the order of time.

        Parameters
        ----------
        first, end : int
            From and to (not included).
        """
        names: list[str] = []
        for reign in self.reigns_in(first, end):
            for name in reign.title.split(" -> "):
                if not names or names[-1] != name:
                    names.append(name)
        return " -> ".join(names) or "unknown"

    def is_off_in(self, first: int, end: int) -> bool:
        """Whether the gates were off in any of the periods from `first` to before `end`."""
        return any(off.begin < end and off.end > first for off in self.offs)

    def cause(self, off: Off) -> str:
        """Why the gates went off: the fault, or who had them off."""
        near = [
            fault
            for fault in self.faults
            if off.begin - _REACTION <= fault.period <= off.begin
            and (fault.code not in _OF_SCHEMES or off.commanded)
        ]
        if near:
            return str(near[0])
        if before := self._before(off):
            return f"{before[0]} (latched at {self._at(before[0].period)}, before the recording)"
        return "disabled by the controller" if off.commanded else "blocked by the inverter"

    def _before(self, off: Off) -> list[Fault]:
        """Faults latched before the recording began that keep its gates off from the first period.

        Cleared ones are not among those that nodes tell of to who comes late.
        """
        if off.begin > self.first + 1:  # the command for the first period may not be recorded
            return []
        return [
            fault
            for fault in self.faults
            if fault.period < self.first - _REACTION and fault.code not in _OF_SCHEMES
        ]

    def notes(self, first: int, end: int) -> list[Note]:
        """
        Say what happened, in sentences.

        Parameters
        ----------
        first, end : int
            The evaluated periods, from and to (not included).
        """
        return [*self._of_gates(first, end), *self._of_faults(), *self._of_schemes()]

    def _at(self, period: int) -> str:
        return f"{period * self.T_s:.3f} s"

    def _of_gates(self, first: int, end: int) -> list[Note]:
        tripped = {fault.period for fault in self.faults}
        found = []
        for off in self.offs:
            until = "" if off.end > self.last else f" to {self._at(off.end)}"
            text = f"gates off from {self._at(off.begin)}{until}: {self.cause(off)}"
            inside = off.begin < end and off.end > first
            by_fault = any(off.begin - _REACTION <= period <= off.begin for period in tripped)
            by_fault |= bool(self._before(off))
            found.append(failure(text) if inside or by_fault else warning(text))
        return _few(found, "times more the gates were off")

    def _of_faults(self) -> list[Note]:
        """Faults that neither switched the gates off nor let another scheme take over."""
        found = []
        for fault in self.faults:
            if any(
                off.begin - _REACTION <= fault.period < off.end or fault in self._before(off)
                for off in self.offs
            ):
                continue
            when = self._at(fault.period)
            if fault.code not in _OF_SCHEMES:
                found.append(warning(f"fault at {when}, and the drive went on: {fault}"))
            elif not any(reign.fell_back for reign in self.reigns):
                found.append(failure(f"the scheme failed at {when}: {fault}"))
        return _few(found, "more faults")

    def _of_schemes(self) -> list[Note]:
        found = []
        before: Reign | None = None
        for reign in self.reigns:
            scheme, when = scheme_title(reign.scheme), self._at(reign.begin)
            if reign.fell_back:
                failed = [fault for fault in self.faults if fault.code in _OF_SCHEMES]
                failed.sort(key=lambda fault, at=reign.begin: abs(fault.period - at))  # type: ignore[misc]
                why = f": {failed[0].detail}" if failed else ""
                chosen = scheme_title(str(reign.chosen))
                began = "from the begin on" if before is None else f"at {when}"
                found.append(failure(f"{chosen} failed {began}, {scheme} took over{why}"))
            elif before is not None:
                text = f"{scheme} controlled from {when} on, {scheme_title(before.scheme)} before"
                found.append(info(text))
            before = reign
        return _few(found, "more changes of the scheme")


def _few(notes: Sequence[Note], more: str) -> list[Note]:
    """The first notes of a kind, and how many more there are: as severe as the worst of them."""
    shown, left = list(notes[:_SHOWN]), list(notes[_SHOWN:])
    if left:
        worst = max(left, key=lambda note: ("info", "warning", "failure").index(note.severity))
        shown.append(Note(worst.severity, f"{len(left)} {more}"))
    return shown


# --- From the messages -------------------------------------------------------------------------


def history(recording: Recording) -> History:
    """
    Read what happened.

    Parameters
    ----------
    recording : Recording
        From `recording.read`.
    """
    changed, faults = changes(recording), _faults(recording)
    return History(
        T_s=recording.T_s,
        first=int(recording.feedback["period"][0]),
        last=int(recording.feedback["period"][-1]),
        reigns=_reigns(recording, changed, faults),
        offs=_offs(recording),
        faults=faults,
        changes=changed,
    )


def changes(recording: Recording) -> tuple[Change, ...]:
    """Parameters that changed while the drive ran: as recorded, or else as scheduled."""
    recorded = recording.summary.get("parameter_changes")
    if isinstance(recorded, list):
        found = [Change(int(c["period"]), c["node"], c["name"], c["value"]) for c in recorded]
        return tuple(sorted(found, key=lambda change: change.period))
    found = []
    for node, table in _TABLES.items():
        values = parameters(recording, node)
        try:
            entries = schedule.parse(values.get("schedule", []), table, recording.T_s, values)
        except (schedule.ScheduleError, ParameterError, KeyError):
            continue  # of another version
        found += [Change(at, node, name, v) for at, each in entries for name, v in each.items()]
    return tuple(sorted(found, key=lambda change: change.period))


def parameters(recording: Recording, node: str) -> Mapping[str, Any]:
    """Parameters that a node began with, as far as they are stored."""
    stored = recording.config.get("parameters")
    values = stored.get(node) if isinstance(stored, dict) else None
    return values if isinstance(values, dict) else {}


def value_at(
    recording: Recording, changed: Sequence[Change], node: str, name: str, period: int
) -> Any:
    """Value of a parameter in a period; None where it is not stored."""
    value = parameters(recording, node).get(name)
    for change in changed:
        if (change.node, change.name) == (node, name) and change.period <= period:
            value = change.value
    return value


def _reigns(
    recording: Recording, changed: Sequence[Change], faults: Sequence[Fault]
) -> tuple[Reign, ...]:
    """Who answered the samples, and who had been chosen to."""
    last = int(recording.feedback["period"][-1])
    period, names = _controlled(recording)
    began_with = recording.config.get("scheme")
    choices: list[tuple[int, str | None]]
    if isinstance(began_with, str):
        choices = [(0, began_with)]
        choices += [(c.period, c.value) for c in changed if c.name == "scheme"]
    else:
        choices = _choices(period, names, faults)
    if not len(period):
        # nothing tells but what was chosen
        ends = [begin for begin, _ in choices[1:]] + [last + 1]
        return tuple(
            Reign(begin, end, name, name)
            for (begin, name), end in zip(choices, ends, strict=True)
            if name is not None and end > begin
        )
    borders = np.flatnonzero(names[1:] != names[:-1]) + 1
    # also where another was chosen: it may have failed at once, and nothing else shows it
    starts = {0, *borders.tolist()}
    starts |= {int(row) for row in np.searchsorted(period, [at for at, _ in choices[1:]])}
    rows = sorted(row for row in starts if row < len(period))
    found: list[Reign] = []
    for row, following in zip(rows, [*rows[1:], None], strict=True):
        begin, scheme = int(period[row]), str(names[row])
        end = max(last, int(period[-1])) + 1 if following is None else int(period[following])
        chosen = [name for at, name in choices if at <= begin][-1]
        # a change from outside may be dated a little late, or act a little later
        if scheme in [name for at, name in choices if begin < at <= begin + _DATED_WITHIN]:
            chosen = scheme
        if found and found[-1].scheme == scheme and end - begin <= _DATED_WITHIN:
            chosen = found[-1].chosen
        if found and (found[-1].scheme, found[-1].chosen) == (scheme, chosen):
            begin = found.pop().begin
        found.append(Reign(begin, end, scheme, chosen))
    return tuple(found)


def _controlled(recording: Recording) -> tuple[NDArray[np.int64], NDArray[np.str_]]:
    """Periods, and who controlled in them: by `lut_diagnostics`, or else by `drive_status`."""
    said = [status for status in recording.statuses if status.scheme]
    if len(recording.lut) or not said:
        return recording.lut["period"].astype(np.int64), recording.scheme
    first = int(recording.feedback["period"][0])
    return (
        np.array([max(status.period, first) for status in said], np.int64),
        np.array([status.scheme for status in said]),
    )


def _choices(
    period: NDArray[np.int64], names: NDArray[np.str_], faults: Sequence[Fault]
) -> list[tuple[int, str | None]]:
    """
    Who had been chosen, where no configuration tells: whoever came to control without a fault.

    A scheme that takes over as another one fails is the fallback. Of one that had failed before
    the recording began, nobody knows the name.
    """
    failed = [fault.period for fault in faults if fault.code in _OF_SCHEMES]
    found: list[tuple[int, str | None]] = [(0, None)]
    before = None
    for at, name in zip(period.tolist(), names.tolist(), strict=True):
        fell = any(at - _REACTION <= fault <= at for fault in failed)
        if before is None and any(fault < at for fault in failed):
            fell = True
        if name != before and not fell:
            found.append((at if before is not None else 0, name))
        before = name
    return found


def gates(recording: Recording) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """
    Tell in which periods the gates were on.

    The plant's own word counts where it is recorded; else the command, and what the inverter
    tells with its samples.

    Parameters
    ----------
    recording : Recording
        From `recording.read`.

    Returns
    -------
    on : ndarray of bool, shape (n,)
        For each row of `Recording.feedback`.
    commanded_off : ndarray of bool, shape (n,)
        Whether the controller had them off.
    """
    feedback = recording.feedback
    period = feedback["period"]
    row, there = rows_of(recording.command["period"], period)
    enable = recording.command["enable"]
    # where there is no command the one before holds; before the first, the zero vector
    latest = np.searchsorted(recording.command["period"], period, side="right") - 1
    commanded_off = np.where(
        there, ~enable[row], np.where(latest >= 0, ~enable[np.maximum(latest, 0)], False)
    )
    on = ~commanded_off & (feedback["derating"] > 0.0)
    if len(recording.state):
        row, there = rows_of(recording.state["period"], period)
        on = np.where(there, recording.state["gates_on"][row], on)
    return on, commanded_off


def _offs(recording: Recording) -> tuple[Off, ...]:
    on, commanded_off = gates(recording)
    edges = np.flatnonzero(np.diff(on.astype(np.int8), prepend=1, append=1))
    period = recording.feedback["period"].astype(np.int64)
    return tuple(
        Off(int(period[begin]), int(period[end - 1]) + 1, bool(commanded_off[begin]))
        for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    )


def latched(node: str, faults: Iterable[tuple[str, int, str]]) -> list[dict[str, Any]]:
    """
    Faults as they are stored with a recording.

    Parameters
    ----------
    node : str
        Who latched them.
    faults : iterable of (str, int, str)
        Code, period of the first occurrence, what was seen.
    """
    return [
        {"node": node, "code": code, "period": period, "detail": detail}
        for code, period, detail in faults
    ]


def _faults(recording: Recording) -> tuple[Fault, ...]:
    recorded = recording.summary.get("faults")
    if not isinstance(recorded, list):
        return ()
    found = [
        Fault(int(f["period"]), str(f["node"]), str(f["code"]), str(f["detail"])) for f in recorded
    ]
    return tuple(sorted(found, key=lambda fault: fault.period))


def rows_of(
    rising: NDArray[np.uint64], wanted: NDArray[np.uint64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """
    Find periods in a topic.

    Parameters
    ----------
    rising : ndarray of uint64, shape (m,)
        Period numbers of the topic.
    wanted : ndarray of uint64, shape (n,)
        What to find.

    Returns
    -------
    row : ndarray of int64, shape (n,)
        Row of each period, 0 where there is none.
    there : ndarray of bool, shape (n,)
        Whether there is one.
    """
    row = np.searchsorted(rising, wanted)
    there = row < len(rising)
    row[~there] = 0
    if len(rising):
        there &= rising[row] == wanted
    row[~there] = 0
    return row, there
