"""What lies in the rings of a black box: the messages around a fault, in the order of the loop."""

from __future__ import annotations

import bisect
import heapq
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

from mfpcc_experiments.graph import loop_messages
from pwm_node import stamps

#: Told on change, and kept beside the topics of the loop.
STATUS = "drive_status"

# Of messages with the same stamp, this is the order of the loop: a command is stamped with the
# begin of the period that it acts in.
_ORDER = ("duty_command", "phase_feedback", "drive_state", "lut_diagnostics", STATUS)

# The thread that writes gives the interpreter back for so long after so many messages (20 us).
_REST = 5e-4  # s
_AT_ONCE = 20

_Item = TypeVar("_Item")


@dataclass(frozen=True)
class Excerpt:
    """Messages of one topic, and their period numbers, which rise."""

    messages: Sequence[bytes]
    periods: Sequence[int]

    def at(self, period: int) -> bytes | None:
        """Message of a period, or the last one before it; None if there is none."""
        row = bisect.bisect_right(self.periods, period) - 1
        return self.messages[row] if row >= 0 else None


def gently(items: Iterable[_Item]) -> Iterator[_Item]:
    """Iterate in the thread that writes, without holding up the loop."""
    for n, item in enumerate(items, 1):
        yield item
        if n % _AT_ONCE == 0:
            time.sleep(_REST)


def excerpt(messages: Sequence[bytes], begin: int, end: int, fault: int) -> Excerpt:
    """Messages from one period to another; of several runs of the plant, from that of the fault."""
    periods = [loop_messages.period(data) for data in gently(messages)]
    borders = [k for k in range(1, len(periods)) if periods[k] < periods[k - 1]]
    runs = list(pairwise([0, *borders, len(periods)]))
    of_fault = [run for run in runs if periods and periods[run[1] - 1] >= fault]
    low = bisect.bisect_left(periods, begin, *(of_fault or runs)[-1])
    high = bisect.bisect_right(periods, end, *(of_fault or runs)[-1])
    return Excerpt(messages[low:high], periods[low:high])


def in_order(
    excerpts: Mapping[str, Excerpt], statuses: Sequence[bytes], begin_ns: int, end_ns: int
) -> Iterator[tuple[int, int, str, bytes]]:
    """Messages of all topics as time passes: stamp (ns), rank, topic, message.

    Of `drive_status`, which is told on change, what was said before is in force at the begin.
    """

    def stamped(topic: str, messages: Sequence[bytes]) -> Iterator[tuple[int, int, str, bytes]]:
        for data in messages:
            yield stamps.at(*loop_messages.stamp(data)), _ORDER.index(topic), topic, data

    earlier = [
        (max(stamp, begin_ns), rank, topic, data)
        for stamp, rank, topic, data in stamped(STATUS, statuses)
        if stamp <= end_ns
    ]
    streams = [stamped(topic, excerpt.messages) for topic, excerpt in excerpts.items()]
    return heapq.merge(*streams, sorted(earlier, key=lambda each: each[0]))
