"""What a launch prints, and the error that ends it."""

from __future__ import annotations


class LaunchError(Exception):
    """A launch file cannot be run; the text says why."""


def log(level: str, name: str, message: str) -> None:
    """Print a line as the real launch does."""
    print(f"[{level}] [{name}]: {message}", flush=True)
