"""Sentences about names that do not exist, with the nearest one that does; and values in them."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping

_LONGEST = 60


def shown(value: object) -> str:
    """Return a value as part of a sentence, cut where it is long."""
    if isinstance(value, int) and value.bit_length() > 4 * _LONGEST:
        return f"a whole number of {value.bit_length()} bits"  # Python refuses to write it out
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def nearest(name: str, known: Iterable[str], also: Mapping[str, str] | None = None) -> str | None:
    """
    Return the known name that is most probably meant by `name`, or None if none is.

    In this order: another name for it; the name with the fewest parts beside those that are
    given, whole or begun (`mls` for `mls_mfpcc`, `dead` for `inverter.dead_time`); the name that
    is spelt most alike.

    Parameters
    ----------
    name : str
        What somebody typed. Neither case nor dots, dashes and underscores matter.
    known : iterable of str
        What there is.
    also : mapping, optional
        Other names that people use, and the known ones they stand for.
    """
    known = list(known)
    for other, meant in (also or {}).items():
        if meant in known and _parts(other, join=True) == _parts(name, join=True):
            return meant
    given = _parts(name)
    holding = [each for each in known if given and _holds(_parts(each), given)]
    if holding:
        alike = difflib.SequenceMatcher
        return min(
            holding, key=lambda each: (len(_parts(each)), -alike(None, name, each).ratio(), each)
        )
    by_lower = {candidate.lower(): candidate for candidate in known}
    matches = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=0.6)
    return by_lower[matches[0]] if matches else None


def _parts(name: str, *, join: bool = False) -> list[str]:
    """The words of a name, in lower case; or all of it as one."""
    words = re.findall(r"[^\W_]+", name.lower())
    return ["".join(words)] if join else words


def _holds(parts: list[str], begun: list[str]) -> bool:
    """Whether parts begin with these, in their order; one letter alone begins nothing."""
    rest = iter(parts)
    return all(
        any(part == word or (len(word) > 1 and part.startswith(word)) for part in rest)
        for word in begun
    )


def unknown(
    kind: str, name: str, known: Iterable[str], also: Mapping[str, str] | None = None
) -> str:
    """Say that `name` is not one of the `known` names of this `kind`.

    >>> unknown("scheme", "mbpc", ["mbpcc", "mfpcc"])
    "unknown scheme 'mbpc'; did you mean 'mbpcc'? There are: mbpcc, mfpcc"
    """
    known = list(known)
    best = nearest(name, known, also)
    text = name if name.isprintable() else repr(name)[1:-1]
    sentence = f"unknown {kind} '{text if len(text) <= _LONGEST else text[: _LONGEST - 3] + '...'}'"
    if best is not None:
        sentence += f"; did you mean '{best}'?"
    else:
        sentence += "."
    if not known:
        return f"{sentence} There are none"
    return f"{sentence} There are: {', '.join(sorted(known))}"
