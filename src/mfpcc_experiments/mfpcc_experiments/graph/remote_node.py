"""A node of the drive, as those who listen to it know it."""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

_CHANGES_KEPT = 10_000
_ANY_PERIOD = 1 << 63


class DriveNode(Protocol):
    """What the box has to know of a node of the drive; a `PwmNode` knows it of itself."""

    @property
    def values(self) -> Mapping[str, Any]:
        """Its parameters as they are now; empty where they are not known."""

    @property
    def changes(self) -> Sequence[Mapping[str, Any]]:
        """The latest changes of them: period, name, value, and what it `was` before, if known."""

    @property
    def missed_periods(self) -> int:
        """Total since the start."""

    @property
    def lost_periods(self) -> int:
        """Total since the start."""


def at_begin(node: DriveNode, period: int) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Parameters of a node as they were in a period, and what changed since."""
    values, since = dict(node.values), []
    for change in reversed(node.changes):
        if change["period"] <= period:
            break
        if "was" in change:
            values[change["name"]] = change["was"]
        since.append(dict(change))
    return values, since[::-1]


class RemoteNode:
    """What is known here of a node of the drive in another process.

    Attributes
    ----------
    values : dict
        Its parameters; empty until it has told them.
    changes : deque of dict
        The latest changes of them: period, name, value, and what it `was` before, where known.
    missed_periods, lost_periods : int
        Totals since its start, as it told them last.
    """

    def __init__(self) -> None:
        self.values: dict[str, Any] = {}
        self.changes: deque[dict[str, Any]] = deque(maxlen=_CHANGES_KEPT)
        self.missed_periods = 0
        self.lost_periods = 0
        # Changes of which it is not known yet in which period they came, by their time (ns).
        self._news: list[tuple[int, str, Any]] = []

    @property
    def has_news(self) -> bool:
        """Whether there are changes whose period is not known yet."""
        return bool(self._news)

    def changed(self, time_ns: int, name: str, value: Any) -> None:
        """Take note of a changed parameter, told at this time."""
        self._news.append((time_ns, name, value))

    def date(self, sent: Sequence[tuple[int, int]], *, last: bool = False) -> None:
        """Find the periods of what has changed.

        A change acts from the first period of which the node tells after the change.

        Parameters
        ----------
        sent : sequence of (int, int)
            When the node sent its latest messages (ns), and of which period each was.
        last : bool
            No more will come: what changed after the last message acts in the period after it.
        """
        while self._news:
            time_ns, name, value = self._news[0]
            row = bisect.bisect_right(sent, (time_ns, _ANY_PERIOD))
            if row == len(sent) and not last:
                return
            period = sent[row][1] if row < len(sent) else sent[-1][1] + 1 if sent else 0
            change = {"period": period, "name": name, "value": value}
            if name in self.values:
                change["was"], self.values[name] = self.values[name], value
            self.changes.append(change)
            del self._news[0]
