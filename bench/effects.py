"""What the effects of the plant cost in a period: each by itself, and sets of them."""

from __future__ import annotations

from figures import Figure, figure

from mfpcc_experiments.proofs import effects

# What is asked for, over a period without any effect.
_MOST = dict.fromkeys(effects.EFFECTS, 6.0)
_MOST.update({"dead time 2 us": 4.0, "on-state drops": 4.0, "saturation": 15.0})
_MOST.update({"servo": 6.0, "everything": 30.0})


def measure(*, quick: bool) -> list[Figure]:
    """One period of the plant with effects, beside one without any."""
    rounds = [effects.costs(repeats=3 if quick else 7) for _ in range(2 if quick else 5)]
    plain = [costs["none"] for costs in rounds]
    return [
        figure(
            f"plant, one period, {name}",
            [costs[name] for costs in rounds],
            "us",
            "all effects off",
            plain,
            bar=f"ratio <= {_MOST[name]:g}" if name in _MOST else "",
        )
        for name in effects.COSTED
        if name != "none"
    ]
