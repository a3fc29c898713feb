"""Errors of recordings, in words for people."""

from __future__ import annotations

from pwm_node.errors import ForPeople


class BagError(ForPeople):
    """
    A recording that cannot be written or read; the text says which, why and what to do.

    It is one line that any terminal can show, whatever the name of a file or topic holds.
    """

    def __init__(self, text: str) -> None:
        super().__init__(printable(text))


class UnfinishedError(BagError):
    """A file that ends in the middle: its writer was killed, or it was cut."""


class DamagedError(BagError):
    """A file whose bytes are not those that were written."""


def printable(text: str) -> str:
    """`text` with everything escaped that a terminal or a file in UTF-8 cannot show."""
    return "".join(
        c
        if c.isprintable()
        else c.encode("unicode_escape", "backslashreplace").decode()
        if not 0xD800 <= ord(c) <= 0xDFFF
        else f"\\x{ord(c) & 0xFF:02x}"
        for c in text
    )
