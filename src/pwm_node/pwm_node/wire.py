"""Messages of fixed layout as memory: what travels is what the kernels work on.

A ROS message travels as CDR: a header of four bytes, then the fields, each aligned to its size
(up to 8). As long as no text or list comes, that is the layout of a C struct. So one buffer can be
both the serialized message and a NumPy record that compiled kernels read and write; on the
per-period path no Python message object is made, and nothing is converted.

`Wire` is such a buffer. It publishes with ``publisher.publish(wire.to_bytes())`` and takes from a
subscription with ``raw=True`` by ``wire.load(data)``.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Encapsulation: plain CDR (XCDR1), little endian, no options.
HEADER = b"\x00\x01\x00\x00"

MAX_STRING = 255

_SCALARS = {
    "boolean": np.bool_,
    "octet": np.uint8,
    "uint8": np.uint8,
    "int8": np.int8,
    "char": np.uint8,
    "uint16": np.uint16,
    "int16": np.int16,
    "uint32": np.uint32,
    "int32": np.int32,
    "uint64": np.uint64,
    "int64": np.int64,
    "float": np.float32,
    "double": np.float64,
}


class WireError(ValueError):
    """A message or a buffer that does not have the layout that is expected."""


def fixed_dtype(msg_class: Any) -> np.dtype[np.void]:
    """Return the record of a message's leading fields of fixed size.

    Parameters
    ----------
    msg_class : type
        A generated message class.

    Returns
    -------
    np.dtype
        Aligned structured dtype with the fields before the first text or list. `stamp` is a
        record of `sec` and `nanosec`; arrays of fixed length are subarrays.
    """
    return np.dtype(_split(msg_class)[0], align=True)


def fixed_size(msg_class: Any) -> int:
    """Return the bytes that the leading fields take on the wire, without header or padding.

    The record's ``itemsize`` may be larger, since it is padded to its alignment.
    """
    return _end(fixed_dtype(msg_class))


class Wire:
    """One serialized message in memory that kernels can work on.

    Parameters
    ----------
    msg_class : type
        A generated message class.
    **lengths : int
        Number of elements of each list that follows the fixed part; 0 unless given.

    Attributes
    ----------
    fixed : ndarray, shape (1,)
        The fields of fixed size as a record. Kernels take this array. Assign fields, not whole
        records: the record's padding overlaps what follows it in the message.
    tail : dict of ndarray
        The lists that follow, by field name, as views of the same memory.
    to_bytes : callable
        Returns the serialized message as bytes, as a subscriber gets it from a publisher that was
        given a message object. (`rclpy.serialization.serialize_message` alone leaves the padding
        between fields to chance; here it is zero.)
    """

    fixed: NDArray[np.void]
    tail: dict[str, NDArray[Any]]
    to_bytes: Callable[[], bytes]

    def __init__(self, msg_class: Any, **lengths: int) -> None:
        self.msg_class = msg_class
        self._name = msg_class.__name__
        fields, rest = _split(msg_class)
        dtype = np.dtype(fields, align=True)
        sequences, self._string = self._tail_fields(rest, lengths)

        layout = []  # (field, element type, number of elements, offset of the count, of the data)
        end = _end(dtype)
        for field, element in sequences:
            length = lengths.pop(field, 0)
            count = _align(end, 4)
            # No elements, no alignment: an empty list is its count alone.
            start = _align(count + 4, element.itemsize) if length else count + 4
            end = start + length * element.itemsize
            layout.append((field, element, length, count, start))
        if lengths:
            raise WireError(f"{self._name} has no list '{next(iter(lengths))}'")
        self._string_at = _align(end, 4)

        # The header is kept, so the body is placed such that it lies on a multiple of 8 in memory.
        room = max(dtype.itemsize, self._string_at + 4 + MAX_STRING + 1)
        buffer = np.zeros(room + 16, np.uint8)
        skip = 4 + -(buffer.ctypes.data + 8) % 8
        self._message = buffer[skip : skip + 4 + room]
        self._message[:4] = np.frombuffer(HEADER, np.uint8)
        body = self._message[4:]
        self.fixed = body[: dtype.itemsize].view(dtype)
        self.tail = {}
        self._counts: list[tuple[str, int, bytes]] = []
        for field, element, length, count, start in layout:
            body[count : count + 4] = np.frombuffer(_u32(length), np.uint8)
            self.tail[field] = body[start : start + length * element.itemsize].view(element)
            self._counts.append((field, 4 + count, _u32(length)))

        self._plain = not self._counts and self._string is None
        self._base = self._message.data
        self._resize(4 + end)
        if self._string is not None:
            self.set_string(self._string, "")

    def _tail_fields(
        self, rest: list[tuple[str, str]], lengths: dict[str, int]
    ) -> tuple[list[tuple[str, np.dtype[Any]]], str | None]:
        """Sort the fields after the fixed part into lists and one text at the end."""
        sequences: list[tuple[str, np.dtype[Any]]] = []
        for position, (field, text) in enumerate(rest):
            element = text.removeprefix("sequence<").split(",")[0].removesuffix(">")
            if text.startswith("sequence<") and element in _SCALARS:
                sequences.append((field, np.dtype(_SCALARS[element])))
            elif text.startswith("string") and position == len(rest) - 1:
                return sequences, field
            else:
                raise WireError(
                    f"{self._name}.{field} ({text}) leaves no fixed layout: after the fields of "
                    "fixed size only lists of numbers may come, and one text at the end"
                )
        return sequences, None

    def set_string(self, field: str, text: str) -> None:
        """Set the text at the end of the message, at most `MAX_STRING` bytes in UTF-8."""
        if field != self._string:
            raise WireError(f"{self._name} has no text '{field}' at its end")
        raw = text.encode("utf-8") + b"\x00"
        if len(raw) > MAX_STRING + 1:
            raise WireError(
                f"{self._name}.{field}: longer than {MAX_STRING} bytes: {text[:40]!r}..."
            )
        data = _u32(len(raw)) + raw
        start = 4 + self._string_at
        self._base[start : start + len(data)] = data
        self._resize(start + len(data))

    def get_string(self, field: str) -> str:
        """Return the text at the end of the message."""
        if field != self._string:
            raise WireError(f"{self._name} has no text '{field}' at its end")
        return bytes(self._used[4 + self._string_at + 4 : -1]).decode("utf-8", "replace")

    def load(self, data: bytes) -> None:
        """Take over a serialized message.

        Parameters
        ----------
        data : bytes
            CDR with its header, little endian. Up to three bytes of padding at the end are ignored.

        Raises
        ------
        WireError
            The message is not of this layout. The buffer is unchanged then.
        """
        # One length, one header: the way of the per-period messages, a plain copy.
        if self._plain and data[:4] == HEADER and len(data) == self._size:
            self._used[:] = data
        else:
            self._load_checked(data)

    def _load_checked(self, data: bytes) -> None:
        """Take over what is not a plain copy: lists, a text, padding; or say what is wrong."""
        # The options in the third and fourth byte tell of padding only.
        if data[:2] != HEADER[:2]:
            raise WireError(
                f"{self._name}: not little-endian CDR (the message begins with {data[:4].hex(' ')})"
            )
        size = self._size
        if self._string is not None:
            start = 4 + self._string_at
            length = int.from_bytes(data[start : start + 4], "little")
            size = start + 4 + length
            if length > MAX_STRING + 1:
                raise WireError(
                    f"{self._name}.{self._string}: a text of {length} bytes is too long"
                )
        if not size <= len(data) <= size + 3:
            raise WireError(f"{self._name}: {len(data)} bytes came where {size} are expected")
        for field, at, count in self._counts:
            if data[at : at + 4] != count:
                came = int.from_bytes(data[at : at + 4], "little")
                expected = int.from_bytes(count, "little")
                raise WireError(
                    f"{self._name}.{field}: {came} elements came where {expected} are expected"
                )
        if size != self._size:
            self._resize(size)
        self._used[4:] = data[4:size]

    def _resize(self, size: int) -> None:
        self._size = size
        self._used = self._base[:size]
        # A bound method of the view itself, since a method around it would cost as much again.
        self.to_bytes = self._used.tobytes


def _split(msg_class: Any) -> tuple[list[tuple[Any, ...]], list[tuple[str, str]]]:
    """Split the fields of a message into the fixed part, as a dtype list, and the rest."""
    fields = list(msg_class.get_fields_and_field_types().items())
    fixed: list[tuple[Any, ...]] = []
    for position, (name, text) in enumerate(fields):
        item = _fixed_field(msg_class, name, text)
        if item is None:
            return fixed, fields[position:]
        fixed.append(item)
    return fixed, []


def _fixed_field(msg_class: Any, name: str, text: str) -> tuple[Any, ...] | None:
    """Return one field of a dtype list, or None if the field has no fixed size."""
    element, bracket, length = text.partition("[")
    if element in _SCALARS:
        scalar = _SCALARS[element]
        return (name, scalar, (int(length[:-1]),)) if bracket else (name, scalar)
    if bracket or "/" not in text or text.startswith("sequence<"):
        return None
    package, _, nested_name = text.partition("/")
    nested_fields, rest = _split(getattr(importlib.import_module(f"{package}.msg"), nested_name))
    if rest:
        return None
    nested = np.dtype(nested_fields, align=True)
    first = nested[0].base.alignment
    if first != nested.alignment or _end(nested) != nested.itemsize:
        # CDR neither aligns a nested message as a whole nor pads it; a C struct does both.
        raise WireError(
            f"{msg_class.__name__}.{name} ({text}) is laid out otherwise in CDR than in a C struct"
        )
    return (name, nested)


def _end(dtype: np.dtype[Any]) -> int:
    """Return where the last field of an aligned record ends, without padding."""
    if dtype.names is None or not dtype.names:
        return 0
    field, offset = dtype.fields[dtype.names[-1]][:2]  # type: ignore[index]
    return int(offset + field.itemsize)


def _align(offset: int, size: int) -> int:
    return -(-offset // size) * size


def _u32(value: int) -> bytes:
    return value.to_bytes(4, "little")
