"""Which differences are more than chance: intervals of 95 %, and ranks with ties."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Interval:
    """
    A mean and the half width of its interval of 95 %.

    Attributes
    ----------
    mean, half : float
    """

    mean: float
    half: float

    @property
    def is_less(self) -> bool:
        """Whether it lies below zero."""
        return self.mean + self.half < 0.0


def interval(values: Sequence[float]) -> Interval:
    """Student's interval of the mean of independent values; at least two."""
    from scipy.stats import t

    n = len(values)
    half = float(t.ppf(0.975, n - 1)) * float(np.std(values, ddof=1)) / math.sqrt(n)
    return Interval(float(np.mean(values)), half)


def difference(ours: Sequence[float], theirs: Sequence[float]) -> Interval:
    """Of values that belong together pair by pair: the same draws, the same noise."""
    return interval([a - b for a, b in zip(ours, theirs, strict=True)])


def ranks(values: Mapping[str, Sequence[float]]) -> dict[str, int]:
    """
    Rank of each of several by values of which less is better, repeat by repeat.

    Returns
    -------
    dict
        1 and how many are better by more than the interval of the difference; so what cannot be
        told apart from the one before has its rank.
    """
    return {
        name: 1
        + sum(difference(other, own).is_less for rival, other in values.items() if rival != name)
        for name, own in values.items()
    }
