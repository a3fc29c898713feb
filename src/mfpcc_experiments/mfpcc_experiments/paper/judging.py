"""How a sentence of the paper is judged: in every seed by itself, then over all of them.

A sentence is judged in every seed by itself, as the paper judges its one experiment. Its verdict is
the one that nine of ten seeds give; where they do not agree, it depends on chance, and that is the
verdict then. The numbers are medians of the seeds, with the interval that holds nine of ten.
"""

from __future__ import annotations

import string
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

CONFIRMED, DIFFERS, NOT_CONFIRMED = "confirmed", "differs", "not confirmed"

#: Of what could not have come out otherwise; it is judged nevertheless, and may fail.
BY_CONSTRUCTION = "by construction"

#: Of what comes out otherwise in more than one of ten seeds.
BY_CHANCE = "depends on chance"

#: Of a figure whose runs did not do what they were to do.
NOT_JUDGED = "not judged"

VERDICTS = (CONFIRMED, BY_CONSTRUCTION, DIFFERS, BY_CHANCE, NOT_CONFIRMED, NOT_JUDGED)

#: Share of the seeds that have to agree, and that the intervals hold.
AGREEMENT = 0.9


@dataclass(frozen=True)
class Statement:
    """
    A sentence of the paper, held against our runs.

    Attributes
    ----------
    figure : str
        Where it belongs: a figure's number, or ``times``.
    says : str
        What the paper says.
    published, ours : str
        The numbers that decide; ours with the interval that holds nine of ten seeds.
    verdict : str
        One of `VERDICTS`; `DIFFERS` is the same tendency with another number.
    remark : str
        How ours was measured, and what else has to be known to judge it.
    seeds : dict of int
        How many seeds gave which verdict.
    """

    figure: str
    says: str
    published: str
    ours: str
    verdict: str
    remark: str
    seeds: dict[str, int]


@dataclass(frozen=True)
class Judged:
    """A sentence in one seed; `form` says how the numbers are printed."""

    says: str
    published: str
    form: str
    numbers: Sequence[float]
    verdict: str
    remark: str = ""


def together(figure: str, same: Sequence[Judged], unfit: int) -> Statement:
    """One sentence over all seeds; those that are `unfit` agree with nothing."""
    seeds = Counter(judged.verdict for judged in same)
    if unfit:
        seeds[NOT_JUDGED] = unfit
    verdict, count = seeds.most_common(1)[0]
    if count < AGREEMENT * seeds.total():
        verdict = BY_CHANCE
    first = same[0]
    return Statement(
        figure=figure,
        says=first.says,
        published=first.published,
        ours=_printed(first.form, [judged.numbers for judged in same]),
        verdict=verdict,
        remark=first.remark,
        seeds=dict(seeds),
    )


def _printed(form: str, numbers: Sequence[Sequence[float]]) -> str:
    """Numbers of several seeds in a text: median, and the interval where it has one to show."""
    columns = iter(np.transpose(np.asarray(numbers, dtype=np.float64)))
    text = ""
    for literal, field, spec, _ in string.Formatter().parse(form):
        text += literal
        if field is None:
            continue
        column = next(columns)
        low, high = np.quantile(column, (0.5 - AGREEMENT / 2.0, 0.5 + AGREEMENT / 2.0))
        ends = [format(float(value), spec or "") for value in (low, high)]
        text += format(float(np.median(column)), spec or "")
        text += f" ({ends[0]} to {ends[1]})" if ends[0] != ends[1] else ""
    return text


# --- In one seed ---------------------------------------------------------------------------------


def near(ours: float, published: float, band: float = 0.25) -> str:
    """A number that is given: confirmed within a share of it."""
    return CONFIRMED if abs(ours - published) <= band * published else DIFFERS


def within(ours: float, limit: float) -> str:
    """A bound that is given."""
    if ours <= limit:
        return CONFIRMED
    return DIFFERS if ours <= 1.25 * limit else NOT_CONFIRMED


def holding(holds: bool) -> str:
    """Something that is so or not."""
    return CONFIRMED if holds else NOT_CONFIRMED


def graded(holds: bool, in_part: bool) -> str:
    """Something that is so, so in part, or not."""
    return CONFIRMED if holds else DIFFERS if in_part else NOT_CONFIRMED


def several(count: int, unit: str, digits: int = 2) -> str:
    """Form of so many numbers of one unit."""
    return f"{' / '.join([f'{{:.{digits}f}}'] * count)} {unit}"
