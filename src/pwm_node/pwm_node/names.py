"""Sentences about names that do not exist, with the nearest one that does; and values in them."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_LONGEST = 60


def shown(value: object) -> str:
    """Return a value as part of a sentence, cut where it is long."""
    if isinstance(value, int) and value.bit_length() > 4 * _LONGEST:
        return f"a whole number of {value.bit_length()} bits"  # Python refuses to write it out
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that looks most like `name`, or None if none does."""
    by_lower = {candidate.lower(): candidate for candidate in known}
    matches = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=0.6)
    return by_lower[matches[0]] if matches else None


def unknown(kind: str, name: str, known: Iterable[str]) -> str:
    """Say that `name` is not one of the `known` names of this `kind`.

    >>> unknown("scheme", "mbpc", ["mbpcc", "mfpcc"])
    "unknown scheme 'mbpc'; did you mean 'mbpcc'? There are: mbpcc, mfpcc"
    """
    known = list(known)
    best = nearest(name, known)
    text = name if name.isprintable() else repr(name)[1:-1]
    sentence = f"unknown {kind} '{text if len(text) <= _LONGEST else text[: _LONGEST - 3] + '...'}'"
    if best is not None:
        sentence += f"; did you mean '{best}'?"
    else:
        sentence += "."
    if not known:
        return f"{sentence} There are none"
    return f"{sentence} There are: {', '.join(sorted(known))}"
