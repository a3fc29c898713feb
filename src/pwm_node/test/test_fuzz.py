"""Any bytes as a message: taken whole, or refused whole with a reason."""

from __future__ import annotations

import fuzz
import numpy as np
import pytest
from mfpcc_msgs import msg
from rclpy.serialization import deserialize_message

from pwm_node.wire import HEADER, MAX_STRING, Wire, WireError

LENGTHS = {"DriveState": {"i_abc_oversampled": 6, "legs_oversampled": 2}}
MESSAGES = ("PhaseFeedback", "DutyCommand", "DriveReference", "LutDiagnostics", "DriveState")


def spoilt(rng: np.random.Generator, data: bytes) -> bytes:
    """A message cut, padded, with other bits, or nothing of the kind at all."""
    kind = rng.integers(6)
    if kind == 0:
        return rng.bytes(int(rng.integers(0, 2 * len(data))))
    if kind == 1:
        return HEADER + rng.bytes(len(data) - 4)
    if kind == 2:
        return data[: rng.integers(len(data))]
    if kind == 3:
        return data + rng.bytes(int(rng.integers(1, 300)))
    other = bytearray(data)
    for _ in range(rng.integers(1, 9)):
        other[rng.integers(len(other))] = rng.choice([0, 1, 127, 128, 255, rng.integers(256)])
    if kind == 4:  # a length that lies
        at = int(rng.integers(0, len(other) - 3))
        other[at : at + 4] = fuzz.any_integer(rng).to_bytes(8, "little")[:4]
    return bytes(other)


@pytest.mark.parametrize("name", MESSAGES)
def test_any_bytes_are_loaded_whole_or_refused_whole(name: str) -> None:
    msg_class = getattr(msg, name)
    wire = Wire(msg_class, **LENGTHS.get(name, {}))
    text = "scheme" if name == "LutDiagnostics" else None
    if text:
        wire.set_string(text, "mls_mfpcc")
    good = wire.to_bytes()
    for rng in fuzz.cases(2000):
        wire.load(good)
        data = spoilt(rng, good)
        _, refusal = fuzz.outcome(WireError, wire.load, data)
        if refusal:
            assert name in refusal and "\n" not in refusal
            assert wire.to_bytes() == good
            continue
        taken = wire.to_bytes()
        assert taken[4:] == data[4 : len(taken)] and len(data) - len(taken) <= 3
        if text:
            assert len(wire.get_string(text)) <= MAX_STRING
        # what it hands on is a message for everybody
        deserialize_message(taken, msg_class)
