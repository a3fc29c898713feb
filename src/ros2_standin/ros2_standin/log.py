"""Log lines as ROS 2 prints them, also when the node they speak for is gone."""

from __future__ import annotations

import sys
import time


def info(name: str, text: str) -> None:
    """Log what goes on."""
    _log("INFO", name, text)


def warning(name: str, text: str) -> None:
    """Log what one should know."""
    _log("WARN", name, text)


def error(name: str, text: str) -> None:
    """Log what went wrong."""
    _log("ERROR", name, text)


def _log(level: str, name: str, text: str) -> None:
    seconds, nanoseconds = divmod(time.time_ns(), 10**9)
    stamp = f"{seconds}.{nanoseconds:09d}"
    print(f"[{level}] [{stamp}] [{name}]: {text}", file=sys.stderr, flush=True)
