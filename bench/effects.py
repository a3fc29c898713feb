"""What each effect of the plant costs in a period."""

from __future__ import annotations

from figures import Figure, figure

from mfpcc_experiments.proofs import validation


def measure(*, quick: bool) -> list[Figure]:
    """One period of the plant with each effect by itself, beside one without any."""
    rounds = [validation.costs(repeats=3 if quick else 7) for _ in range(2 if quick else 5)]
    plain = [costs["none"] for costs in rounds]
    return [
        figure(
            f"plant, one period, {name}",
            [costs[name] for costs in rounds],
            "us",
            "all effects off",
            plain,
        )
        for name in validation.EFFECTS
    ]
