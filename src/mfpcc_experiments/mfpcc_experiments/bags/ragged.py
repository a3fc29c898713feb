"""
The ragged end of a recording whose writer was killed: topics that end at different periods.

What lies behind the last period that all topics have belongs to no whole period. It is told from
the last messages of each topic, in the order in which they were written.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise

from mfpcc_experiments.bags.disk.mcap_file import Topic
from mfpcc_experiments.bags.topics import EVERY_PERIOD, LEAD, LOOP_TOPICS

#: A topic that ended so many periods before the others was not cut off by the end: it fell silent,
#: and what the others hold is no remnant.
LONGEST = 6_000

_PERIOD = slice(12, 20)  # of a message in CDR: behind its header and its stamp
_LITTLE_ENDIAN = b"\x00\x01"

_Tail = deque[tuple[int, int]]  # log time (ns) and period


class Tails:
    """The last periods of the topics of the loop, of all axes."""

    def __init__(self) -> None:
        self._periods: dict[str, _Tail] = {}

    def see(self, topic: Topic, log_time: int, message: bytes | memoryview) -> None:
        """
        Take note of a message.

        Parameters
        ----------
        topic : Topic
            Its topic; any.
        log_time : int
            When it was recorded (ns).
        message : bytes-like
            Its content.
        """
        name = topic.name.rpartition("/")[2]
        if LOOP_TOPICS.get(name) != topic.type_name or topic.encoding != "cdr":
            return
        if len(message) < _PERIOD.stop or bytes(message[:2]) != _LITTLE_ENDIAN:
            return
        period = int.from_bytes(message[_PERIOD], "little") - LEAD.get(name, 0)
        tail = self._periods.setdefault(topic.name, deque(maxlen=LONGEST))
        tail.append((log_time, period))

    def too_many(self) -> dict[str, int]:
        """How many messages at the end of each topic belong to no whole period; those with any."""
        found: dict[str, int] = {}
        for tails, end in self._axes():
            for topic, tail in tails.items():
                if count := sum(1 for _, period in tail if period > end):
                    found[topic] = count
        return found

    def ends(self) -> list[int]:
        """The last period that all topics of an axis have, of each axis where it can be told."""
        return [end for _, end in self._axes()]

    def _axes(self) -> Iterator[tuple[Mapping[str, _Tail], int]]:
        """Topics of each axis, and the last period that all of them have."""
        for axis in sorted({topic.rpartition("/")[0] for topic in self._periods}):
            tails = {t: p for t, p in self._periods.items() if t.rpartition("/")[0] == axis}
            if not all(map(_rises, tails.values())):
                continue  # restarted, or out of order: what its end is cannot be told
            steps = {topic: _step(topic, tail) for topic, tail in tails.items()}
            ends = [tails[topic][-1][1] + step - 1 for topic, step in steps.items() if step]
            if ends and max(tail[-1][1] for tail in tails.values()) - min(ends) < LONGEST:
                yield tails, min(ends)


def _rises(tail: Iterable[tuple[int, int]]) -> bool:
    order = list(tail)
    return all(b[0] >= a[0] and b[1] > a[1] for a, b in pairwise(order))


def _step(topic: str, tail: _Tail) -> int:
    """Periods from one message to the next; 0 where it cannot be told."""
    if topic.rpartition("/")[2] in EVERY_PERIOD:
        return 1
    return tail[-1][1] - tail[-2][1] if len(tail) > 1 else 0
