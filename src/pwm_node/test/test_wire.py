"""The records are the messages: held against rclpy's own serialization of each message type."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

rclpy_serialization = pytest.importorskip("rclpy.serialization")
messages = pytest.importorskip("mfpcc_msgs.msg")

from pwm_node.wire import HEADER, Wire, WireError, fixed_dtype, fixed_size  # noqa: E402

TAILS = {
    "PhaseFeedback": {},
    "DutyCommand": {},
    "DriveReference": {},
    "LutDiagnostics": {},
    "DriveState": {"i_abc_oversampled": 60, "legs_oversampled": 20},
}
WIRES = st.sampled_from(sorted(TAILS))


def random_bytes(array, rng):
    """Fill an array with random bits; booleans may only be 0 or 1."""
    raw = rng.integers(0, 256, array.nbytes, np.uint8).view(array.dtype)
    array[...] = raw.view(np.uint8) & 1 if array.dtype == bool else raw.reshape(array.shape)


def random_wire(name, seed, tails):
    rng = np.random.default_rng(seed)
    wire = Wire(getattr(messages, name), **tails)
    record = wire.fixed
    for field in record.dtype.names:
        if record[field].dtype.names:
            for inner in record[field].dtype.names:
                random_bytes(record[field][inner], rng)
        else:
            random_bytes(record[field], rng)
    for values in wire.tail.values():
        random_bytes(values, rng)
    if name == "LutDiagnostics":
        wire.set_string("scheme", "scheme µ"[: seed % 9])
    return wire


def used_bytes(wire):
    """Which bytes of the serialized message carry values: all but the padding."""
    empty = np.frombuffer(wire.to_bytes(), np.uint8)
    used = np.zeros(empty.size, bool)
    used[:4] = True
    for field, offset in _leaves(wire.fixed.dtype):
        used[4 + offset : 4 + offset + field.itemsize] = True
    used[4 + fixed_size(wire.msg_class) + 3 & ~3 :] = True
    return used


def _leaves(dtype, base=0):
    for name in dtype.names:
        field, offset = dtype.fields[name][:2]
        if field.names:
            yield from _leaves(field, base + offset)
        else:
            yield field, base + offset


def same_values(one, other):
    """Compare messages field by field, with NaN equal to itself."""
    for name in one.get_fields_and_field_types():
        left, right = getattr(one, name), getattr(other, name)
        if hasattr(left, "get_fields_and_field_types"):
            same_values(left, right)
        elif isinstance(left, str):
            assert left == right
        else:
            np.testing.assert_array_equal(np.asarray(left), np.asarray(right))


@settings(max_examples=60, deadline=None)
@given(name=WIRES, seed=st.integers(0, 2**32), full=st.booleans())
def test_bytes_are_those_of_rclpy(name, seed, full):
    wire = random_wire(name, seed, TAILS[name] if full else {})
    data = wire.to_bytes()
    message = rclpy_serialization.deserialize_message(data, wire.msg_class)
    for field in wire.fixed.dtype.names:
        if field == "stamp":
            stamp = wire.fixed["stamp"][0]
            assert (message.stamp.sec, message.stamp.nanosec) == (stamp["sec"], stamp["nanosec"])
        else:
            np.testing.assert_array_equal(np.asarray(getattr(message, field)), wire.fixed[field][0])
    for field, values in wire.tail.items():
        np.testing.assert_array_equal(np.asarray(getattr(message, field)), values)

    reference = np.frombuffer(rclpy_serialization.serialize_message(message), np.uint8)
    # rclpy may add padding at the end, and leaves the bytes between the fields to chance.
    assert 0 <= reference.size - len(data) <= 3
    ours = np.frombuffer(data, np.uint8)
    used = used_bytes(wire)
    np.testing.assert_array_equal(ours[used], reference[: ours.size][used])
    assert not ours[~used].any()


@settings(max_examples=60, deadline=None)
@given(name=WIRES, seed=st.integers(0, 2**32), full=st.booleans())
def test_loads_what_rclpy_serializes(name, seed, full):
    tails = TAILS[name] if full else {}
    source = random_wire(name, seed, tails)
    message = rclpy_serialization.deserialize_message(source.to_bytes(), source.msg_class)
    wire = Wire(source.msg_class, **tails)
    wire.load(rclpy_serialization.serialize_message(message))
    same_values(rclpy_serialization.deserialize_message(wire.to_bytes(), wire.msg_class), message)
    if name == "LutDiagnostics":
        assert wire.get_string("scheme") == message.scheme
    assert len(wire.to_bytes()) == len(source.to_bytes())


def test_record_is_a_view_on_a_multiple_of_8():
    wire = Wire(messages.DutyCommand)
    assert wire.fixed.ctypes.data % 8 == 0
    assert wire.fixed.flags.aligned and wire.fixed.dtype.isalignedstruct
    wire.fixed["duty"][0, 2] = 0.75
    message = rclpy_serialization.deserialize_message(wire.to_bytes(), messages.DutyCommand)
    assert list(message.duty) == [0.0, 0.0, 0.75]


def test_fixed_part_of_a_message_that_is_not_fixed():
    assert fixed_dtype(messages.DriveStatus).names == ("stamp", "period")
    with pytest.raises(WireError, match=r"DriveStatus\.node .* leaves no fixed layout"):
        Wire(messages.DriveStatus)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "not little-endian CDR"),
        (b"\x00\x00\x00\x00" + bytes(64), "not little-endian CDR"),
        (HEADER + bytes(63), "67 bytes came where 68 are expected"),
        (HEADER + bytes(68), "72 bytes came where 68 are expected"),
    ],
)
def test_refuses_other_messages_and_keeps_the_last(data, says):
    wire = Wire(messages.PhaseFeedback)
    wire.fixed["period"] = 7
    with pytest.raises(WireError, match=says):
        wire.load(data)
    assert wire.fixed["period"][0] == 7


def test_up_to_three_bytes_of_padding_are_ignored():
    wire = Wire(messages.PhaseFeedback)
    wire.load(HEADER + bytes(67))
    assert len(wire.to_bytes()) == 68


def test_refuses_lists_of_other_lengths_and_texts_too_long():
    state = Wire(messages.DriveState, i_abc_oversampled=3, legs_oversampled=1)
    before = state.to_bytes()
    other = Wire(messages.DriveState, i_abc_oversampled=2, legs_oversampled=9)
    with pytest.raises(WireError):
        state.load(other.to_bytes())
    assert state.to_bytes() == before
    lut = Wire(messages.LutDiagnostics)
    with pytest.raises(WireError, match="longer than"):
        lut.set_string("scheme", "x" * 256)
    broken = bytearray(lut.to_bytes())
    broken[-5:-1] = b"\xff\xff\xff\xff"
    with pytest.raises(WireError, match="too long"):
        lut.load(bytes(broken))
    with pytest.raises(WireError, match="no list 'voltages'"):
        Wire(messages.DriveState, voltages=3)
    with pytest.raises(WireError, match="no text 'name'"):
        lut.set_string("name", "x")
