"""Looking for the next message of the loop, and for the time at which a period begins.

Between two nodes of one process, publishing has delivered by the time it returns, so the loop takes
the message at once. From another process, to sleep and be woken takes most of the time that a
message needs, so the loop looks for the next one instead, and gives its core away in between:
without that, the middleware's own threads would have to wait for it.

Who gives a core away that others want gets it back late, later than one who slept. So where this
happens, the loop sleeps for a while, as it does when nothing has come for some milliseconds.

Who sleeps is woken by the executor, which serves one after the other what has come. Where more is
asked of the node than it can serve, the loop's next message would be behind all of that. So then it
is looked for too, and so are periods that a timer would begin.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Sequence

from pwm_node.ros.loop_topics import SERVE_EVERY, LoopSubscription
from pwm_node.ros.pace import Pace

_IDLE = 0.2  # s
# The executor takes longer than others wait for a message. So its turn begins right after one was
# handled and nothing else is there, if that comes within this time (s).
_GRACE = 0.001
# The middleware's threads give a core back within some 20 us. Beyond this (s) others have it; the
# scheduler's tick takes up to a millisecond now and then, and is no sign of others.
_AWAY = 0.0003
_AWAY_AT_MOST = 0.0015  # s in one turn
# A turn in vain costs its time, so it is tried again after a while (s) that grows.
_SLEEP_FOR = 0.1
_SLEEP_AT_MOST = 2.0
# Between two looks on a core that others want, where it cannot be slept until something comes (s).
_NAP = 5e-5
# A loop in which nothing has happened for so long (s) does not run, and nothing has to wait for it.
_RUNS_FOR = 0.1


class Look:
    """What a thread that serves nodes does between two turns of their executor."""

    def __init__(self) -> None:
        self._crowded_until = -math.inf
        self._sleep_for = _SLEEP_FOR
        self._heard_at = -math.inf

    def on(
        self,
        subscriptions: Sequence[LoopSubscription],
        paces: Sequence[Pace],
        *,
        paced: bool = False,
        behind: bool = False,
    ) -> float:
        """Handle the messages that come and the periods that are due, for a few milliseconds.

        Parameters
        ----------
        subscriptions : sequence of LoopSubscription
            Those that the executor does not serve.
        paces : sequence of Pace
            What begins periods.
        paced : bool
            Whether periods follow the wall clock: to sleep would be to come too late for certain,
            so that the core is asked for also where others want it.
        behind : bool
            Whether the executor has more to serve than it could so far.

        Returns
        -------
        float
            How long the executor may wait until it has something to serve (s); 0 if it shall serve
            what is due at once.
        """
        takes = [(each.take, each.msg_class, each.callback, each) for each in subscriptions]
        quiet = {each for each in subscriptions if each.lively}
        patient = bool(quiet)
        clock = time.monotonic
        now = clock()
        deadline = now + SERVE_EVERY
        waiting = patient or any(pace.due < math.inf for pace in paces)
        latest = deadline + (_GRACE if waiting else 0.0)
        answered = False
        crowded = now < self._crowded_until and not paced
        away = 0.0
        napping = crowded and behind
        while True:
            idle = True
            for take, msg_class, callback, each in takes:
                message = take(msg_class, True)
                if message is not None:
                    quiet.discard(each)
                    callback(message[0])
                    idle, answered = False, True
            now = clock()
            for pace in paces:
                if now >= (pace.next if behind else pace.due):
                    pace.on_tick()
                    idle = answered = False
            if not idle:
                self._heard_at = now
            elif behind and now - self._heard_at > _RUNS_FOR:
                return 0.0
            if now >= deadline and (now >= latest or (idle and answered)):
                break
            if not idle:
                continue
            if napping:
                time.sleep(_NAP)
                continue
            if (crowded or not patient) and not behind:
                due = min((pace.due for pace in paces), default=math.inf)
                if crowded or due == math.inf:
                    return max(min(due - now, _IDLE), 0.0)
            os.sched_yield()
            took = clock() - now
            if took > _AWAY:
                away += took
        crowded = away > _AWAY_AT_MOST and not paced
        if crowded:
            self._crowded_until = now + self._sleep_for
            self._sleep_for = min(2.0 * self._sleep_for, _SLEEP_AT_MOST)
        elif not (away or napping):
            self._sleep_for = _SLEEP_FOR
        for each in subscriptions:
            if each in quiet or crowded:
                each.sleep(self._crowded_until)
        return 0.0
