"""
What a result says beside its figures: plain sentences, and how much each of them matters.

A note is made once, where something is found out, and says the same words wherever it is shown: on
the terminal, in ``metrics.json`` (key ``notes``) and in the report. Its severity decides about the
exit code of the command, and nothing else does.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

#: Exit code of a verb that did its work, while what was asked for did not happen.
NOT_AS_ASKED = 3


class Severity(str, enum.Enum):
    """How much a note matters."""

    #: To be known in order to read the figures; all went as it was asked for.
    INFO = "info"
    #: Something is not as it should be, such as messages that the figures leave out.
    WARNING = "warning"
    #: What was asked for did not happen.
    FAILURE = "failure"


@dataclass(frozen=True)
class Note:
    """
    One thing that a result says beside its figures.

    Attributes
    ----------
    severity : Severity
        How much it matters.
    text : str
        One plain sentence, without a full stop.
    """

    severity: Severity
    text: str

    def __str__(self) -> str:
        return self.text

    def to_json(self) -> dict[str, str]:
        """As it stands in ``metrics.json``."""
        return {"severity": self.severity.value, "text": self.text}


def info(text: str) -> Note:
    """Make a note of `Severity.INFO`."""
    return Note(Severity.INFO, text)


def warning(text: str) -> Note:
    """Make a note of `Severity.WARNING`."""
    return Note(Severity.WARNING, text)


def failure(text: str) -> Note:
    """Make a note of `Severity.FAILURE`."""
    return Note(Severity.FAILURE, text)


def exit_code(rows: Iterable[Mapping[str, Any]], *, strict: bool = False) -> int:
    """
    Exit code that the notes of some results ask for.

    Parameters
    ----------
    rows : iterable of mapping
        Objects of ``metrics.json``.
    strict : bool
        Whether a warning counts as a failure.
    """
    bad = {Severity.FAILURE, Severity.WARNING} if strict else {Severity.FAILURE}
    found = {note["severity"] for row in rows for note in row["notes"]}
    return NOT_AS_ASKED if found & bad else 0


def lines(rows: Iterable[Mapping[str, Any]], labels: Iterable[str]) -> list[str]:
    """
    Notes as lines for the terminal, each with its severity and whose it is.

    Parameters
    ----------
    rows : iterable of mapping
        Objects of ``metrics.json``.
    labels : iterable of str
        Their names.
    """
    return [
        f"{note['severity']}: {label}: {note['text']}"
        for row, label in zip(rows, labels, strict=True)
        for note in row["notes"]
    ]
