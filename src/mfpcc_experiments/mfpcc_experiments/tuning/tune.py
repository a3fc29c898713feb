"""All studies of a tuning side by side, then the judgement of what they chose."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from mfpcc_experiments.sweeping.local import Pool
from mfpcc_experiments.sweeping.progress import Progress
from mfpcc_experiments.tuning.criteria import NEAR, Judgement
from mfpcc_experiments.tuning.folder import Folder
from mfpcc_experiments.tuning.scenarios import Choice, Scenarios
from mfpcc_experiments.tuning.study import Study

#: What is compared (Hz).
SWITCHING_FREQUENCY = 10e3

#: Whose choices are judged: the defaults, and those of the studies.
WHICH = ("default", "tuned")


@dataclass(frozen=True)
class Tuning:
    """
    What is tuned, and how thoroughly.

    Attributes
    ----------
    scenarios : Scenarios
        What may be moved, and the drives.
    schemes : tuple of str
        Whose parameters.
    budget : int
        Choices that each study looks at.
    repeats : int
        Studies of each scheme; each has other draws, other noise, another seed of the optimiser.
    """

    scenarios: Scenarios
    schemes: tuple[str, ...]
    budget: int
    repeats: int

    @property
    def steps(self) -> int:
        """Choices to be looked at or judged, all in all."""
        return len(self.schemes) * self.repeats * (self.budget + 2 * len(WHICH))


@dataclass(frozen=True)
class Judged:
    """
    What a choice is worth on the drives that it was not tuned on.

    Attributes
    ----------
    scheme, which : str
        Whose choice, of `WHICH`.
    repeat : int
        Which study, draws and noise.
    equal : bool
        Whether the PWM frequency is that at which the legs switch with `SWITCHING_FREQUENCY`.
    choice : dict
        What is not at its default.
    figures : dict
        As `criteria.figures` gives them.
    """

    scheme: str
    which: str
    repeat: int
    equal: bool
    choice: Choice
    figures: dict[str, float]


def run(tuning: Tuning, folder: Folder, pool: Pool, progress: Progress) -> list[Judged]:
    """
    Tune, and judge.

    What is in the folder already is not done again.

    Returns
    -------
    list of Judged
        Of every scheme both choices, with the PWM of the experiments and at equal switching
        frequency, in every repeat.
    """
    studies = [
        Study(
            scheme,
            repeat,
            tuning.budget,
            tuning.scenarios.spaces(scheme),
            folder.trials(scheme, repeat),
        )
        for scheme in tuning.schemes
        for repeat in range(tuning.repeats)
    ]
    progress.add(sum(len(study.trials) for study in studies))
    while unfinished := [study for study in studies if study.left > 0]:
        _generation(tuning, folder, pool, progress, unfinished)
    found: list[Judged] = []
    for scheme in tuning.schemes:
        rows = folder.judged(scheme)
        if not rows:
            own = [study for study in studies if study.scheme == scheme]
            rows = [vars(each) for each in _judge(tuning, pool, progress, own)]
            folder.keep_judged(scheme, rows)
        else:
            progress.add(len(rows))
        found += [Judged(**row) for row in rows]
    return found


def _generation(
    tuning: Tuning, folder: Folder, pool: Pool, progress: Progress, studies: Sequence[Study]
) -> None:
    """One generation of each study; each is kept as soon as it is whole."""
    asked = [study.generation() for study in studies]
    places = [(s, n) for s, choices in enumerate(asked) for n in range(len(choices))]
    jobs = (
        Judgement(
            number,
            tuning.scenarios.tuned_on,
            studies[s].scheme,
            asked[s][n],
            studies[s].repeat,
        )
        for number, (s, n) in enumerate(places)
    )
    found: list[dict[int, dict[str, float]]] = [{} for _ in studies]
    for number, figures in pool.run(jobs):
        s, n = places[number]
        found[s][n] = figures
        progress.add(1)
        if len(found[s]) == len(asked[s]):
            study = studies[s]
            study.tell([found[s][n] for n in range(len(asked[s]))])
            folder.keep_trials(study.scheme, study.repeat, study.trials)


def _judge(
    tuning: Tuning, pool: Pool, progress: Progress, studies: Sequence[Study]
) -> Iterable[Judged]:
    """The defaults and the choices of a scheme's studies."""
    drives, scheme = tuning.scenarios.judged_on, studies[0].scheme
    wanted = [
        Judged(scheme, which, study.repeat, False, choice, {})
        for study in studies
        for which, choice in zip(WHICH, ({}, study.best.choice), strict=True)
    ]

    def figures(rows: Sequence[Judged], switching_frequency: float) -> list[dict[str, float]]:
        jobs: Iterator[Any] = (
            Judgement(n, drives, scheme, row.choice, row.repeat, switching_frequency)
            for n, row in enumerate(rows)
        )
        found = {}
        for number, result in pool.run(jobs):
            found[number] = result
            progress.add(1)
        return [found[n] for n in range(len(rows))]

    found = [
        replace(row, figures=own) for row, own in zip(wanted, figures(wanted, 0.0), strict=True)
    ]
    off = [
        row
        for row in found
        if abs(row.figures["switching_frequency"] / SWITCHING_FREQUENCY - 1.0) >= NEAR
    ]
    again = iter(figures(off, SWITCHING_FREQUENCY))
    for row in found:
        yield row
    progress.add(len(found) - len(off))
    for row in found:
        yield replace(row, equal=True, figures=next(again) if row in off else row.figures)
