"""
Which of the messages of a recording belong together, in the order of time, and what is missing.

The log times of a file say in which order its messages came; in which order they lie in it says
nothing. Within one run of a drive the period numbers rise with time. Where these two do not agree
on one order, a recording is refused rather than guessed at.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.bags.columns import ALL, Column, Rows
from mfpcc_experiments.bags.errors import BagError
from mfpcc_experiments.bags.topics import EVERY_PERIOD, LEAD
from mfpcc_experiments.notes import Note, warning

_Array = NDArray[np.int64]

# A drive that is restarted while it is recorded begins with a period below this one.
_BEGIN = 1000
# So many runs may be in one recording before it counts as several drives at the same time.
_RUNS = 10


@dataclass
class Selection:
    """
    What of the messages the figures are made of.

    Attributes
    ----------
    rows : dict
        Rows of each topic, in the order of time.
    period : dict of ndarray
        Their period numbers.
    lost_periods : int
        Periods, within what was recorded, of which a message is missing.
    span : tuple of float, or None
        Log times between which the messages lie, if only one of several runs is used (ns).
    notes : list of Note
        What is left out, and what is missing.
    """

    rows: dict[str, Rows] = field(default_factory=dict)
    period: dict[str, _Array] = field(default_factory=dict)
    lost_periods: int = 0
    span: tuple[float, float] | None = None
    notes: list[Note] = field(default_factory=list)


def select(
    columns: Mapping[str, Column], path: Path, *, decimation: Mapping[str, int], joined_late: bool
) -> Selection:
    """
    Find the messages that belong together.

    Parameters
    ----------
    columns : mapping of Column
        All topics; `phase_feedback` has messages.
    path : Path
        Recording, for messages.
    decimation : mapping of int
        Periods from one message to the next, of the topics where it is known.
    joined_late : bool
        Whether a recorder may have found the topics one after the other.

    Raises
    ------
    BagError
        If no order can be told.
    """
    found = Selection()
    time = {name: column.log_time() for name, column in columns.items()}
    period = {name: column.period() for name, column in columns.items()}
    rows = {name: _by_time(time[name]) for name in columns}
    first = rows["phase_feedback"]
    span = _run(period["phase_feedback"][first], time["phase_feedback"][first], path, found)
    found.span = span
    for name, column in columns.items():
        if span is not None:
            rows[name] = _within(time[name], rows[name], span)
        rows[name] = _answers(column, rows[name])
        rows[name] = _rising(column, period[name], rows[name], path, found)
        period[name] = period[name][rows[name]]
    del time
    found.rows, found.period = rows, period
    if joined_late or all(p[0] > 0 for p in period.values() if len(p)):
        _trim(found, decimation)
    _count_lost(found, decimation)
    return found


# --- Order -------------------------------------------------------------------------------------


def _by_time(time: _Array) -> Rows:
    """All rows, ordered by their log time."""
    return ALL if (time[1:] >= time[:-1]).all() else np.argsort(time, kind="stable")


def _run(period: _Array, time: _Array, path: Path, found: Selection) -> tuple[float, float] | None:
    """Log times between which the longest of several runs lies; None where there is one run."""
    back = np.flatnonzero(period[1:] < period[:-1]) + 1
    if not len(back) or time[0] == time[-1]:
        return None
    borders = np.array([0, *back.tolist(), len(period)])
    one = _is_one_drive(period, borders)
    lengths = np.diff(borders)
    longest = int(np.argmax(lengths))
    short = len(back) > _RUNS and 2 * lengths[longest] < len(period)
    if _are_mixed(period, time) if one else short:
        raise BagError(
            f"{path}: the period number of phase_feedback goes back {len(back)} times: several "
            "drives were recorded at the same time; record each into a bag of its own"
        )
    if one:
        return None
    times = "once" if len(back) == 1 else f"{len(back)} times"
    found.notes.append(
        warning(
            f"the period number goes back {times} (was the drive restarted?); only the longest "
            f"run is used, from period {period[borders[longest]]} on; "
            f"{len(period) - lengths[longest]} periods of the others are left out"
        )
    )
    begin, end = -np.inf, np.inf
    if longest > 0:
        begin = 0.5 * (float(time[borders[longest] - 1]) + float(time[borders[longest]]))
    if longest < len(lengths) - 1:
        end = 0.5 * (float(time[borders[longest + 1] - 1]) + float(time[borders[longest + 1]]))
    return begin, end


def _is_one_drive(period: _Array, borders: _Array) -> bool:
    """Whether runs, in the order of their log times, are one drive whose log times are wrong."""
    ordered = np.sort(period)
    if (ordered[1:] == ordered[:-1]).any():
        return False
    if len(borders) != 3:
        return True
    # Two runs without a common period: a drive that was restarted begins anew, before its old run.
    begin, end = int(period[borders[1]]), int(period[-1])
    return end > period[0] or begin > _BEGIN or end + 1 == period[0]


def _are_mixed(period: _Array, time: _Array) -> bool:
    """Whether numbers far apart came at the same times: of two drives without a common period."""
    order = np.argsort(period, kind="stable")
    period, time = period[order], time[order]
    gaps = np.flatnonzero(np.diff(period) > _BEGIN) + 1
    latest = np.maximum.accumulate(time)
    return any(time[gap:].min() < latest[gap - 1] for gap in gaps.tolist())


def _within(time: _Array, rows: Rows, span: tuple[float, float]) -> Rows:
    """Rows whose log time lies within `span`."""
    index = np.arange(len(time))[rows]
    inside = time[index]
    return index[(inside > span[0]) & (inside < span[1])]


def _answers(column: Column, rows: Rows) -> Rows:
    """Rows that belong to a period of the loop."""
    out = column.answers_nothing(rows)
    return np.arange(column.count)[rows][~out] if out.any() else rows


def _rising(column: Column, period: _Array, rows: Rows, path: Path, found: Selection) -> Rows:
    """Rows of one run with rising period numbers: sorted, and repeats dropped."""
    there = period[rows]
    if (there[1:] > there[:-1]).all():
        return rows
    index = np.arange(len(period))[rows]
    index = index[np.argsort(there, kind="stable")]
    there = period[index]
    again = np.flatnonzero(there[1:] == there[:-1]) + 1
    if not len(again):
        return index
    # Of those that come more than twice each is held against the first of its period.
    first = np.searchsorted(there, there[again])
    differs = column.first_difference(index[first], index[again])
    if differs is not None:
        raise BagError(
            f"{path}: {column.name} holds period {there[again[differs]]} more than once with other "
            "contents, and the log times do not tell them apart: were two drives recorded? Record "
            "each into a bag of its own"
        )
    count = len(again)
    found.notes.append(
        warning(f"{column.name}: {count} period numbers come twice; the first counts")
    )
    return np.delete(index, again)


# --- Completeness ------------------------------------------------------------------------------


def _trim(found: Selection, decimation: Mapping[str, int]) -> None:
    """Keep of each topic the periods that all topics have; what that leaves out is noted."""
    there = {name: period for name, period in found.period.items() if len(period)}
    ends = _ends(there)
    last = max(ends.values())
    begin, end, ragged = 0, last, False
    for name, period in there.items():
        # A message of a decimated topic stands for the periods up to the next one.
        more = _step(name, period, decimation) - 1
        begin = max(begin, int(period[0]) - LEAD.get(name, 0) - more)
        end = min(end, ends[name] + more)
        # The last message of a topic that answers the samples may be missing.
        ragged |= ends[name] + more + int(name != "phase_feedback") < last
    if not ragged:
        end = last
    out: list[int] = []
    for name, period in there.items():
        lead = LEAD.get(name, 0)
        first = int(np.searchsorted(period, begin))  # with the command for the first period
        behind = int(np.searchsorted(period, end + lead, side="right")) if end < last else None
        kept = period[first:behind]
        if 0 < len(kept) < len(period):
            out.append(len(period) - len(kept))
            keep = found.rows[name]
            found.rows[name] = (
                slice(first, behind) if isinstance(keep, slice) else keep[first:behind]
            )
            found.period[name] = kept
    if out:
        found.lost_periods = last - end
        each = ", ".join(f"{name} {p[0]} to {p[-1]}" for name, p in there.items())
        found.notes.append(
            warning(
                f"the topics do not begin and end at the same period ({each}); {sum(out)} messages "
                f"outside of the periods {begin} to {end}, which all topics have, are left out"
            )
        )


def _ends(period: Mapping[str, _Array]) -> dict[str, int]:
    """The sample to which the last message of each topic belongs."""
    return {name: int(p[-1]) - LEAD.get(name, 0) for name, p in period.items() if len(p)}


def _step(name: str, period: _Array, decimation: Mapping[str, int]) -> int:
    """Periods from one message of a topic to the next."""
    if name in EVERY_PERIOD:
        return 1
    if decimation.get(name, 0) > 0:
        return decimation[name]
    return max(1, int(np.median(np.diff(period)))) if len(period) > 1 else 1


def _count_lost(found: Selection, decimation: Mapping[str, int]) -> None:
    """Count the periods of which a message is missing, and note which topics have gaps."""
    feedback = found.period["phase_feedback"]
    first, last = int(feedback[0]), max(_ends(found.period).values())
    gaps: list[_Array] = []  # begin and end of spans of periods, end not included
    for name, period in found.period.items():
        if not len(period):
            continue
        step = _step(name, period, decimation)
        # A command is recorded for the period after its sample. The last one of a topic may be
        # missing: the run ended before.
        begin = first + LEAD.get(name, 0)
        end = last if name in EVERY_PERIOD else last - 1
        where = np.flatnonzero(np.diff(period) > step)
        spans = np.stack([period[where] + step, period[where + 1]], axis=1)
        ahead = max(0, int(period[0]) - begin) // step * step
        behind = max(0, end - int(period[-1])) // step * step
        edges = [(int(period[0]) - ahead, int(period[0]))] if ahead else []
        edges += [(int(period[-1]) + step, int(period[-1]) + step + behind)] if behind else []
        spans = np.concatenate([spans, np.array(edges, np.int64).reshape(-1, 2)])
        # Of a decimated topic only whole steps are missing.
        spans[:, 1] = spans[:, 0] + (spans[:, 1] - spans[:, 0] + step - 1) // step * step
        count = int((spans[:, 1] - spans[:, 0]).sum()) // step
        if count:
            at = f"first after period {period[where[0]]}" if len(where) else "at its begin or end"
            found.notes.append(warning(f"{name}: {count} messages are missing, {at}"))
            gaps.append(spans)
    found.lost_periods += _union(gaps)


def _union(gaps: list[_Array]) -> int:
    """Periods that lie in one span or several."""
    if not gaps:
        return 0
    spans = np.concatenate(gaps)
    spans = spans[np.argsort(spans[:, 0], kind="stable")]
    reach = np.maximum.accumulate(spans[:, 1])
    begin = spans[:, 0].copy()
    begin[1:] = np.maximum(begin[1:], reach[:-1])
    return int(np.maximum(reach - begin, 0).sum())
