"""Messages of several topics, written period by period although they come topic by topic.

A recorder takes what has come of one topic, and then of the next. Written like that, a recording
that is cut off would end at a different period in each topic.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping

from mfpcc_experiments.bags.topics import LEAD, LOOP_TOPICS
from mfpcc_experiments.bags.writer import CHUNK_NS

_RANK = {topic: rank for rank, topic in enumerate(LOOP_TOPICS)}

#: A topic that is behind by more than this (ns) may have fallen silent; see the head of
#: `bags.writer`.
_BEHIND = CHUNK_NS
#: It has if nothing of it came before so many releases. Few tell nothing: where the machine is
#: busy, the middleware sends again what was lost on the way, long after the other topics.
_SILENT = 100
#: Messages of a topic that wait at most, where stamps do not tell how far behind others are.
_WAITING = 20_000

_Message = tuple[int, int, str, int, bytes]  # period, rank, and what is written


class InStep:
    """
    Holds messages until those of the same period of the other topics are there.

    Parameters
    ----------
    write : callable
        Takes topic, stamp (ns) and content of each message.
    steps : mapping of int
        Periods from one message to the next of each topic, as far as they are known; it may change.
    """

    def __init__(self, write: Callable[[str, int, bytes], None], steps: Mapping[str, int]) -> None:
        self._write = write
        self._steps = steps
        self._held: dict[str, deque[_Message]] = {}
        self._last: dict[str, tuple[int, int]] = {}  # sample and stamp (ns) of each topic
        self._releases: dict[str, int] = {}  # of each topic, since its last message

    def add(self, topic: str, period: int, stamp: int, data: bytes) -> None:
        """Take a message; it is written by `release`."""
        sample = period - LEAD.get(topic, 0)
        if topic in self._last and sample <= self._last[topic][0]:
            self.release(everything=True)  # the drive began anew
            self._last.clear()
        self._last[topic] = sample, stamp
        self._releases[topic] = 0
        self._held.setdefault(topic, deque()).append((sample, _RANK[topic], topic, stamp, data))

    def release(self, *, everything: bool = False) -> None:
        """Write the periods of which all topics have come, or all there is."""
        ready: list[_Message] = []
        for topic in self._releases:
            self._releases[topic] += 1
        until = None if everything else self._complete_until()
        for held in self._held.values():
            while held and (until is None or held[0][0] <= until):
                ready.append(held.popleft())
        ready.sort()
        for _, _, topic, stamp, data in ready:
            self._write(topic, stamp, data)

    def _complete_until(self) -> int | None:
        """The last period that no topic has to be waited for; None where nobody is to be."""
        if any(len(held) > _WAITING for held in self._held.values()) or not self._last:
            return None
        newest = max(stamp for _, stamp in self._last.values())
        return min(
            sample + self._steps.get(topic, 1) - 1
            for topic, (sample, stamp) in self._last.items()
            if newest - stamp <= _BEHIND or self._releases[topic] <= _SILENT
        )
