"""Python's garbage collector, kept out of a loop at PWM rate.

By itself it runs whenever so many objects have come into being, and then it looks at all that
there are: milliseconds, in the middle of a period. Here it is off, and what there is at the start
is left out of account (`gc.freeze`). Objects that refer to each other in a circle are collected
between two turns, when so many are there that memory would begin to count; that takes a fraction
of a millisecond. The loop itself leaves none: those are of services and of parameters that are set.
"""

from __future__ import annotations

import gc
from types import TracebackType

_AT_MOST = 2000  # objects in which circles may hide: some hundred KB


class NoGarbageCollector:
    """Off while the context lasts; `look` bounds what may gather meanwhile.

    Attributes
    ----------
    collections : int
        How many times circles were collected.
    """

    def __init__(self) -> None:
        self.collections = 0
        self._limit = _AT_MOST
        self._was_on = False

    def __enter__(self) -> NoGarbageCollector:
        self._was_on = gc.isenabled()
        gc.collect()
        gc.freeze()
        gc.disable()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        gc.unfreeze()
        if self._was_on:
            gc.enable()

    def look(self) -> None:
        """Collect if there is reason to; to be called now and then, between two periods."""
        if gc.get_count()[0] < self._limit:
            return
        gc.collect()
        self.collections += 1
        # Who keeps many objects, a recorder say, must not have them looked through all the time.
        self._limit = max(_AT_MOST, len(gc.get_objects()) // 4)
