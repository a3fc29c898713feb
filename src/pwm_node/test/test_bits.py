"""Bits of values: those of the fields, and none between them."""

import numpy as np

from pwm_node import bits

PADDED = np.dtype(
    [("period", "u8"), ("on", "?"), ("inner", [("a", "f4"), ("b", "f8")])], align=True
)


def rows(filling: int) -> np.ndarray:
    """Two rows of values, in memory that was filled with something else before."""
    array = np.frombuffer(bytearray([filling]) * (2 * PADDED.itemsize), PADDED)
    array["period"] = 3, 4
    array["on"] = True, False
    array["inner"]["a"] = np.nan, 1.0
    array["inner"]["b"] = -0.0, 2.0
    return array


def test_what_lies_between_fields_makes_no_difference():
    one, other = rows(0), rows(255)
    assert one.tobytes() != other.tobytes()
    assert bits.of(one) == bits.of(other)
    assert bits.of(one[0]) == bits.of(other[0])
    assert bits.with_clean_gaps(other).tobytes() == one.tobytes()


def test_each_bit_of_a_value_does():
    one, other = rows(0), rows(0)
    other["inner"]["b"][0] = 0.0
    assert (one["inner"]["b"] == other["inner"]["b"]).all()
    assert bits.of(one) != bits.of(other)
