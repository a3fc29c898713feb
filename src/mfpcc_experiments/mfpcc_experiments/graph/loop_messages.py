"""What is read of a message of the loop without unpacking all of it: its stamp and its period."""

from __future__ import annotations

import struct
from collections.abc import Sequence

_STAMP_AND_PERIOD = struct.Struct("<4xiIQ")
_STAMP = struct.Struct("<4xiI")

#: Seconds, nanoseconds and period of a serialized message; raises `struct.error` if it is cut.
stamp_and_period = _STAMP_AND_PERIOD.unpack_from

#: Seconds and nanoseconds of any serialized message that begins with a stamp.
stamp = _STAMP.unpack_from


def period(data: bytes) -> int:
    """Period of a serialized message."""
    return int(stamp_and_period(data)[2])


def reaches(messages: Sequence[bytes], wanted: int) -> bool:
    """Whether a topic, which may be decimated, has come as far as this period."""
    last = period(messages[-1])
    step = last - period(messages[-2]) if len(messages) > 1 else 1
    return last + max(step, 1) > wanted
