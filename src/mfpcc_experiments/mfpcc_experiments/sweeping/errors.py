"""What can be wrong with a sweep."""

from __future__ import annotations

from importlib.util import find_spec

from pwm_node.errors import ForPeople


class SweepError(ForPeople, ValueError):
    """A sweep that cannot be made, or cannot go on; the text says why and what to do."""


def needs(package: str) -> None:
    """
    Look for a package that only sweeps need.

    Raises
    ------
    SweepError
        If it is not installed.
    """
    if find_spec(package) is None:
        raise SweepError(f"sweeps need the package '{package}': 'make sweeps' installs it")
