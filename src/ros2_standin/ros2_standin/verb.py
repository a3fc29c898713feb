"""What every verb returns, and how one ends early."""

from __future__ import annotations

#: What a verb returns: None or 0 if all went well, another code, or the text of an error.
Result = int | str | None


class Terminated(Exception):
    """The process was told to end (SIGTERM)."""
