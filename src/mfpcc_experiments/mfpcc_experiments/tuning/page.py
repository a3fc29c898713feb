"""The leaderboard: what was judged, as a page of Markdown."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from statistics import fmean
from typing import Any

import numpy as np

from mfpcc_experiments.reporting import html
from mfpcc_experiments.sweeping.space import Space
from mfpcc_experiments.tuning.criteria import BESIDES, CRITERIA, RIPPLE_BLIND, Criterion, score
from mfpcc_experiments.tuning.ranks import Interval, difference, ranks
from mfpcc_experiments.tuning.scenarios import Scenarios
from mfpcc_experiments.tuning.tune import SWITCHING_FREQUENCY, WHICH, Judged, Tuning

#: Whose wins and losses are told one by one.
OURS = "mls_mfpcc"

Table = list[list[str]]


class Scores:
    """
    All that was judged, by who and which and how.

    Parameters
    ----------
    rows : iterable of Judged
        Of every scheme, both choices, both ways, every repeat.
    """

    def __init__(self, rows: Iterable[Judged]) -> None:
        self._rows: dict[tuple[str, str, bool], list[Judged]] = {}
        for row in rows:
            self._rows.setdefault((row.scheme, row.which, row.equal), []).append(row)
        for same in self._rows.values():
            same.sort(key=lambda row: row.repeat)
        self.schemes = list(dict.fromkeys(scheme for scheme, _, _ in self._rows))

    def rows(self, scheme: str, which: str, *, equal: bool = False) -> list[Judged]:
        """Of a choice, repeat by repeat."""
        return self._rows[scheme, which, equal]

    def logs(
        self,
        scheme: str,
        which: str,
        criteria: Sequence[Criterion] = CRITERIA,
        *,
        equal: bool = False,
    ) -> list[float]:
        """Logarithm of the geometric mean of some criteria, repeat by repeat."""
        return [score(row.figures, criteria) for row in self.rows(scheme, which, equal=equal)]

    def ranks(
        self, which: str, criteria: Sequence[Criterion] = CRITERIA, *, equal: bool = False
    ) -> dict[str, int]:
        """Rank of each scheme by these criteria."""
        return ranks({s: self.logs(s, which, criteria, equal=equal) for s in self.schemes})

    def gain(self, scheme: str, criteria: Sequence[Criterion] = CRITERIA) -> Interval:
        """Tuned over default, as a difference of logarithms."""
        return difference(
            self.logs(scheme, "tuned", criteria), self.logs(scheme, "default", criteria)
        )


def render(tuning: Tuning, rows: Sequence[Judged], command: str, made_with: str) -> str:
    """
    The page.

    Parameters
    ----------
    tuning : Tuning
        What was tuned.
    rows : sequence of Judged
        What came of it.
    command : str
        That makes the page anew.
    made_with : str
        Versions and machine, for the page's head.
    """
    scores = Scores(rows)
    told = OURS in scores.schemes and len(scores.schemes) > 1
    blind, moved = _ripple(scores)
    text = html.page(
        "leaderboard.md",
        command=command,
        made_with=made_with,
        tuning=tuning,
        tuned_on=tuning.scenarios.tuned_on,
        judged_on=tuning.scenarios.judged_on,
        ours=OURS,
        kilohertz=f"{1e-3 * SWITCHING_FREQUENCY:g}",
        ranking=_markdown(_ranking(scores)),
        defaults=_markdown(_criteria(scores, "default")),
        tuned=_markdown(_criteria(scores, "tuned")),
        losses=_losses(scores) if told else [],
        gains=_markdown(_gains(scores)),
        verdict=_verdict(scores),
        equal=_markdown(_equal(scores)),
        blind=_markdown(blind),
        moved=moved,
        ranges=_markdown(_ranges(tuning.scenarios, scores.schemes)),
    )
    return _filled(text)


def _ranking(scores: Scores) -> Table:
    found = {which: scores.ranks(which) for which in WHICH}
    level = {(s, which): fmean(scores.logs(s, which)) for s in scores.schemes for which in WHICH}
    best = {which: min(level[s, which] for s in scores.schemes) for which in WHICH}
    rows = [["rank, tuned", "scheme", "score, tuned", "rank, defaults", "score, defaults"]]
    for s in sorted(scores.schemes, key=lambda s: (found["tuned"][s], level[s, "tuned"])):
        rows.append(
            [
                f"{found['tuned'][s]}",
                f"`{s}`",
                f"{math.exp(level[s, 'tuned'] - best['tuned']):.2f}",
                f"{found['default'][s]}",
                f"{math.exp(level[s, 'default'] - best['default']):.2f}",
            ]
        )
    return rows


def _criteria(scores: Scores, which: str) -> Table:
    """Means of the criteria; bold where rank 1."""
    first = {c.name: scores.ranks(which, (c,)) for c in CRITERIA}
    rows = [["scheme", *map(_heading, CRITERIA)]]
    for s in scores.schemes:
        cells = []
        for c in CRITERIA:
            text = _mean(scores.rows(s, which), c)
            cells.append(f"**{text}**" if first[c.name][s] == 1 else text)
        rows.append([f"`{s}`", *cells])
    return rows


def _losses(scores: Scores) -> list[tuple[str, list[str]]]:
    """By how much others are better, criterion by criterion: what is lost comes first."""
    found = []
    for which, title in zip(WHICH, ("With the defaults", "Tuned"), strict=True):
        lines = [_standing(scores, which, criterion) for criterion in CRITERIA]
        lost = [line for better, line in lines if better]
        found.append((title, [*lost, *(line for better, line in lines if not better)]))
    return found


def _standing(scores: Scores, which: str, criterion: Criterion) -> tuple[int, str]:
    """By a criterion: how many are better, and a sentence."""
    own = scores.logs(OURS, which, (criterion,))
    better, tied, worse = [], [], 0
    for s in scores.schemes:
        theirs = scores.logs(s, which, (criterion,))
        over = difference(theirs, own)
        if s == OURS:
            continue
        if over.is_less:
            better.append((over.mean, f"`{s}` by {_percent(over)}"))
        elif difference(own, theirs).is_less:
            worse += 1
        else:
            tied.append(s)
    who = ", ".join(text for _, text in sorted(better))
    text = (
        f"{criterion.title}: better {_are(len(better))} {who}"
        if who
        else (f"{criterion.title}: nobody is better")
    )
    if tied:
        text += f"; {_listed(tied)} cannot be told apart from it"
    return len(better), f"{text}; {worse} of {len(scores.schemes) - 1} are worse."


def _are(count: int) -> str:
    return "is" if count == 1 else "are"


def _gains(scores: Scores) -> Table:
    rows = [["scheme", "tuned over default", "a gain", "values chosen"]]
    for s in scores.schemes:
        gain = scores.gain(s)
        rows.append([f"`{s}`", _ratio(gain), "yes" if gain.is_less else "no", _values(scores, s)])
    return rows


def _verdict(scores: Scores) -> str:
    """Who has better parameters than its defaults, and what they cost."""
    won = [s for s in scores.schemes if scores.gain(s).is_less]
    if not won:
        return "No scheme gained more by tuning than its interval: the defaults stand."
    lines = ["Beyond the interval:", ""]
    for s in won:
        parts = []
        for c in CRITERIA:
            change = scores.gain(s, (c,))
            if abs(change.mean) > change.half and abs(change.mean) > 0.005:
                parts.append(f"{c.title} {_signed(change)}")
        lines.append(f"- `{s}`: {'; '.join(parts) or 'no criterion alone'}.")
    return "\n".join(lines)


def _equal(scores: Scores) -> Table:
    pwm, switching = BESIDES[1], BESIDES[0]
    found = {which: scores.ranks(which, equal=True) for which in WHICH}
    rows = [
        [
            "scheme",
            "PWM (kHz)",
            "legs (kHz)",
            *map(_heading, CRITERIA),
            "rank, tuned",
            "rank, defaults",
        ]
    ]
    for s in sorted(scores.schemes, key=lambda s: found["tuned"][s]):
        of = scores.rows(s, "tuned", equal=True)
        rows.append(
            [
                f"`{s}`",
                *(
                    f"{1e-3 * fmean(row.figures[c.name] for row in of):.1f}"
                    for c in (pwm, switching)
                ),
                *(_mean(of, c) for c in CRITERIA),
                *(f"{found[which][s]}" for which in reversed(WHICH)),
            ]
        )
    return rows


def _ripple(scores: Scores) -> tuple[Table, str]:
    """The same with criteria that a steady ripple does not count in, and whom that moves."""
    without, blind = (
        tuple(c for c in criteria if c.name != "prediction_error")
        for criteria in (CRITERIA, RIPPLE_BLIND)
    )
    columns = {
        "all six": scores.ranks("tuned"),
        "ripple-blind": scores.ranks("tuned", RIPPLE_BLIND),
        "without the prediction": scores.ranks("tuned", without),
        "ripple-blind, without it": scores.ranks("tuned", blind),
    }
    before, after = columns["all six"], columns["ripple-blind"]
    rows = [
        ["tuned", *(_heading(c) for c in blind), *(f"rank: {title}" for title in columns)],
        *(
            [
                f"`{s}`",
                *(_mean(scores.rows(s, "tuned"), c) for c in blind),
                *(f"{ranks[s]}" for ranks in columns.values()),
            ]
            for s in sorted(scores.schemes, key=before.__getitem__)
        ),
    ]
    moved = [
        f"`{s}` from {before[s]} to {after[s]}" for s in scores.schemes if before[s] != after[s]
    ]
    return rows, (
        f"That moves {', '.join(moved)}."
        if moved
        else "That moves nobody: the order does not rest on the ripple."
    )


def _heading(criterion: Criterion) -> str:
    return f"{criterion.title} ({criterion.unit})"


def _ranges(scenarios: Scenarios, schemes: Iterable[str]) -> Table:
    rows = [["scheme", "parameter", "from", "to", "on a scale that is"]]
    for s in schemes:
        for name, space in scenarios.spaces(s).items():
            low, high = (f"{x:g}" for x in space.values)
            rows.append([f"`{s}`", f"`{name}`", low, high, _scale(space)])
    return rows


def _scale(space: Space) -> str:
    return "logarithmic" if space.kind == "log_uniform" else "linear"


def _values(scores: Scores, scheme: str) -> str:
    """What the repeats chose."""
    chosen: dict[str, list[Any]] = {}
    of = scores.rows(scheme, "tuned")
    for row in of:
        for name, value in row.choice.items():
            chosen.setdefault(name, []).append(value)
    texts = [
        f"`{name}` {_short(np.median(values))} ({_short(min(values))} to {_short(max(values))})"
        for name, values in chosen.items()
    ]
    kept = sum(not row.choice for row in of)
    if kept:
        texts.append(f"the defaults in {kept} of {len(of)} repeats")
    return ", ".join(texts)


def _short(value: float) -> str:
    """With three digits, and none of an exponent."""
    return f"{float(f'{value:.3g}'):.10g}"


def _mean(rows: Sequence[Judged], criterion: Criterion) -> str:
    return f"{fmean(row.figures[criterion.name] for row in rows):.{criterion.digits}f}"


def _percent(less: Interval) -> str:
    """How much less, of a difference of logarithms."""
    low, high = (100.0 * (1.0 - math.exp(less.mean + h)) for h in (less.half, -less.half))
    return f"{100.0 * (1.0 - math.exp(less.mean)):.1f} % ({low:.1f} to {high:.1f} %)"


def _signed(change: Interval) -> str:
    return f"{100.0 * (math.exp(change.mean) - 1.0):+.1f} %"


def _ratio(change: Interval) -> str:
    low, high = math.exp(change.mean - change.half), math.exp(change.mean + change.half)
    return f"{math.exp(change.mean):.3f} ({low:.3f} to {high:.3f})"


def _listed(names: Sequence[str]) -> str:
    quoted = [f"`{name}`" for name in names]
    return quoted[0] if len(quoted) == 1 else f"{', '.join(quoted[:-1])} and {quoted[-1]}"


def _markdown(rows: Table) -> str:
    lines = [f"| {' | '.join(row)} |" for row in rows]
    lines.insert(1, "|" + "---|" * len(rows[0]))
    return "\n".join(lines)


def _filled(text: str) -> str:
    """The page with its paragraphs and list entries filled to lines of 100 characters."""
    blocks = []
    for block in re.split(r"\n{2,}", text.strip("\n")):
        if block[0] not in "|#<":
            entries = re.split(r"\n(?=- )", block)
            block = "\n".join(
                textwrap.fill(
                    " ".join(entry.split()),
                    100,
                    subsequent_indent="  " if entry.startswith("- ") else "",
                    break_long_words=False,
                    break_on_hyphens=False,
                )
                for entry in entries
            )
        blocks.append(block)
    return "\n\n".join(blocks) + "\n"
