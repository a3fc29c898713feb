"""
One scheme, one repeat: the optimiser asks, the drives answer, the optimiser is told.

Tree-structured Parzen estimators (Bergstra et al. 2011, in Optuna) make the score small. They are
asked for a generation at once, so that all cores have work. What they ask depends on their seed and
on what they were told, so a study that was broken off goes on from its trials alone.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any

from mfpcc_controller.parameters import TABLE
from mfpcc_experiments.sweeping.errors import SweepError
from mfpcc_experiments.sweeping.space import Space
from mfpcc_experiments.tuning.criteria import score
from mfpcc_experiments.tuning.scenarios import Choice

#: Choices that are asked for at once.
GENERATION = 10

# Random choices before the optimiser has something to go by.
_RANDOM_FIRST = 10


@dataclass(frozen=True)
class Trial:
    """A choice, and its figures."""

    choice: Choice
    figures: dict[str, float]


@dataclass
class Study:
    """
    The search for a scheme's parameters.

    Parameters
    ----------
    scheme : str
        Whose.
    repeat : int
        Seed of the optimiser, and which draws and which noise it sees.
    budget : int
        Choices that are looked at; the first are the defaults.
    spaces : dict of str to Space
        What may be moved.
    trials : list of Trial
        What was looked at, in its order.
    """

    scheme: str
    repeat: int
    budget: int
    spaces: dict[str, Space]
    trials: list[Trial] = field(default_factory=list)

    def __post_init__(self) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            sampler = optuna.samplers.TPESampler(
                n_startup_trials=_RANDOM_FIRST,
                seed=self.repeat,
                multivariate=True,
                constant_liar=True,
            )
        self._study = optuna.create_study(sampler=sampler)
        self._asked: list[Any] = []
        known, self.trials = self.trials, []
        while known:
            wanted = self.generation()
            found, known = known[: len(wanted)], known[len(wanted) :]
            if [trial.choice for trial in found] != wanted:
                raise SweepError(
                    f"{self.scheme}: the optimiser asks for other choices now than when this was "
                    "begun: choose another --out"
                )
            self.tell([trial.figures for trial in found])

    @property
    def left(self) -> int:
        """Choices still to be looked at."""
        return self.budget - len(self.trials)

    @property
    def best(self) -> Trial:
        """The choice with the smallest score, the earliest of them."""
        return min(self.trials, key=lambda trial: score(trial.figures))

    def generation(self) -> list[Choice]:
        """What to look at next; the first choice of all are the defaults, which are none."""
        first: list[Choice] = [] if self.trials else [{}]
        count = min(GENERATION, self.left) - len(first)
        distributions = {name: _distribution(name, space) for name, space in self.spaces.items()}
        self._asked = [self._study.ask(distributions) for _ in range(count)]
        return [*first, *(dict(trial.params) for trial in self._asked)]

    def tell(self, found: list[dict[str, float]]) -> None:
        """Figures of the last generation."""
        if not self.trials:
            self.trials.append(Trial({}, found[0]))
            found = found[1:]
        for trial, figures in zip(self._asked, found, strict=True):
            self._study.tell(trial, score(figures))
            self.trials.append(Trial(dict(trial.params), figures))


def _distribution(name: str, space: Space) -> Any:
    """Of Optuna."""
    from optuna.distributions import FloatDistribution, IntDistribution

    low, high = space.values
    kind: Any = IntDistribution if TABLE[name].kind == "int" else FloatDistribution
    return kind(low, high, log=space.kind == "log_uniform")
