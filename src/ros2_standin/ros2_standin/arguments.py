"""Kinds of numbers on the command line."""

from __future__ import annotations

from argparse import ArgumentTypeError


def positive_int(text: str) -> int:
    """Read an integer above zero."""
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value <= 0:
        raise ArgumentTypeError("value must be a positive integer")
    return value


def non_negative_int(text: str) -> int:
    """Read an integer, zero or above."""
    try:
        value = int(text)
    except ValueError:
        value = -1
    if value < 0:
        raise ArgumentTypeError("value must be non-negative integer")
    return value


def positive_float(text: str) -> float:
    """Read a number above zero."""
    try:
        value = float(text)
    except ValueError:
        raise ArgumentTypeError("Expects a floating point number") from None
    if not value > 0.0:
        raise ArgumentTypeError("Value must be positive")
    return value


def non_negative_float(text: str) -> float:
    """Read a number, zero or above."""
    try:
        value = float(text)
    except ValueError:
        raise ArgumentTypeError(f"{text} is not the valid type (float)") from None
    if not value >= 0.0:
        raise ArgumentTypeError(f"Value {text} is less than zero.")
    return value
