"""Kinds of arguments on the command line."""

from __future__ import annotations

import argparse
from argparse import ArgumentTypeError
from typing import Any

from ros2_standin.catalogue import not_here


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


class _Missing(argparse.Action):
    """An option that only ROS 2's own command has: names that one, and ends."""

    def __call__(self, parser: argparse.ArgumentParser, *rest: Any) -> None:
        raise SystemExit(not_here(f"{parser.prog} {rest[-1]}"))


def add_missing(parser: argparse.ArgumentParser, *options: str) -> None:
    """Accept options of the real command only to say that they are not here."""
    for option in options:
        parser.add_argument(
            option, action=_Missing, nargs="*", dest="missing", help=argparse.SUPPRESS
        )
