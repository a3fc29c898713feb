"""
What the nodes said of themselves on ``drive_status``, as others record it.

A recording of ours holds the latched faults in its summary. One of others has the messages, in
which texts of any length stand between the numbers.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass, field

#: Relative name of the topic, and its type.
TOPIC, TYPE = "drive_status", "mfpcc_msgs/msg/DriveStatus"

_HEADER = 4  # of a message in CDR
_MOST_FAULTS = 1000


class StatusError(ValueError):
    """The message is not what its type says."""


@dataclass(frozen=True)
class Status:
    """
    One message.

    Attributes
    ----------
    log_time : int
        When it was recorded (ns).
    period : int
        In which it was so.
    node, scheme : str
        Who says so, and who controls the current (of the controller).
    faults : list of (str, int, str)
        Latched: code, period of the first occurrence, what was seen.
    """

    log_time: int
    period: int
    node: str
    scheme: str
    faults: list[tuple[str, int, str]] = field(default_factory=list)


def parse(data: bytes, log_time: int) -> Status:
    """
    Read one message.

    Parameters
    ----------
    data : bytes
        In CDR, little-endian.
    log_time : int
        When it was recorded (ns).

    Raises
    ------
    StatusError
        If it is something else.
    """
    reader = _Reader(data)
    reader.take("<iI", 4)
    (period,) = reader.take("<Q", 8)
    node, _state = reader.text(), reader.text()
    reader.take("<B", 1)
    scheme = reader.text()
    (count,) = reader.take("<I", 4)
    if count > _MOST_FAULTS:
        raise StatusError(f"{count} faults")
    faults = []
    for _ in range(count):
        code, detail = reader.text(), reader.text()
        reader.take("<iI", 4)
        (at,) = reader.take("<Q", 8)
        faults.append((code, at, detail))
    return Status(log_time, period, node, scheme, faults)


class _Reader:
    """Numbers and texts one after the other, each aligned to its own size."""

    def __init__(self, data: bytes) -> None:
        if data[:2] != b"\x00\x01":
            raise StatusError("not little-endian CDR")
        self._data, self._at = data, _HEADER

    def take(self, form: str, size: int) -> tuple[int, ...]:
        at = _HEADER + -(-(self._at - _HEADER) // size) * size
        self._at = at + struct.calcsize(form)
        if self._at > len(self._data):
            raise StatusError("it is cut")
        return struct.unpack_from(form, self._data, at)

    def text(self) -> str:
        (length,) = self.take("<I", 4)
        raw = self._data[self._at : self._at + length]
        if len(raw) < length or raw[-1:] != b"\x00":
            raise StatusError("a text is cut")
        self._at += length
        return raw[:-1].decode("utf-8", "replace")


def latched(said: Iterable[Status]) -> list[dict[str, object]]:
    """Faults of all messages, each once, as the summary of a recording holds them."""
    found = []
    for status in said:
        for code, period, detail in status.faults:
            fault = {"node": status.node, "code": code, "period": period, "detail": detail}
            if fault not in found:
                found.append(fault)
    return found
