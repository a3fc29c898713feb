"""The report of `mfpcc reproduce`: one HTML file that needs nothing but itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mfpcc_experiments.measuring import scheme_title
from mfpcc_experiments.notes import Severity
from mfpcc_experiments.paper.judging import (
    BY_CHANCE,
    CONFIRMED,
    DIFFERS,
    NOT_JUDGED,
    VERDICTS,
    Statement,
)
from mfpcc_experiments.paper.runs import TIMES, Results
from mfpcc_experiments.paper.statements import FITTED
from mfpcc_experiments.reporting import Line, html, lines
from mfpcc_experiments.running import scenario

# Of the verdicts, by the classes of the page: as it should be, in part, and (all others) not.
_COLOURS = {CONFIRMED: 0, DIFFERS: 1, BY_CHANCE: 1}


def render(
    results: Results,
    judged: Sequence[Statement],
    figures: Sequence[tuple[str, Path, str]],
    *,
    engine: str,
) -> str:
    """
    Make the report.

    Parameters
    ----------
    results : Results
        The runs.
    judged : sequence of Statement
        What the paper says of them.
    figures : sequence of (str, Path, str)
        From `figures.draw`.
    engine : str
        What the recordings were made with.

    Returns
    -------
    str
        A complete HTML page.
    """
    groups = _grouped(judged)
    parts = ", ".join(title for title, _ in groups)
    return html.page(
        "reproduce.html",
        subtitle=f"{parts} · engine {engine} · {_seeds(results)}",
        note=FITTED,
        counts=counts(judged),
        judged=groups,
        total=len(judged),
        seeds=len(results.seeds),
        notes=[
            (label, note)
            for label, run in zip(labels(results), results.runs, strict=True)
            for note in run.row["notes"]
            if run.seed == results.seeds[0] or note["severity"] != Severity.INFO
        ],
        figures=[(caption, path.name, html.embedded(path)) for _, path, caption in figures],
        tables=_tables(results),
        times=_times(results),
        made=_made(results, engine),
    )


def counts(judged: Sequence[Statement]) -> list[tuple[str, int]]:
    """How many statements have each verdict; that some are not judged is an exception."""
    found = [(verdict, sum(s.verdict == verdict for s in judged)) for verdict in VERDICTS]
    return [entry for entry in found if entry[1] or entry[0] != NOT_JUDGED]


def agreement(s: Statement) -> str:
    """How the seeds judged, where they do not all agree."""
    if len(s.seeds) == 1:
        return ""
    return ", ".join(f"{v} {s.seeds[v]}" for v in VERDICTS if v in s.seeds)


def labels(results: Results) -> list[str]:
    """Names of the runs, for their notes."""
    return [
        f"{scheme_title(run.row['scheme'])}, {run.experiment}, seed {run.seed}"
        for run in results.runs
    ]


def _seeds(results: Results) -> str:
    first, last = results.seeds[0], results.seeds[-1]
    return f"seed {first}" if first == last else f"seeds {first} to {last}"


def _grouped(judged: Sequence[Statement]) -> list[tuple[str, list[dict[str, Any]]]]:
    """Statements by figure, in the order they come."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for s in judged:
        title = "Computing times" if s.figure == "times" else f"Figure {s.figure}"
        entry = {**asdict(s), "colour": _COLOURS.get(s.verdict, 2), "agreement": agreement(s)}
        groups.setdefault(title, []).append(entry)
    return list(groups.items())


def _tables(results: Results) -> list[tuple[str, str, list[Line], list[str]]]:
    """One table of metrics per experiment, one column per scheme, over all seeds."""
    tables = []
    for experiment in dict.fromkeys(run.experiment for run in results.recorded):
        runs = [run for run in results.runs if run.experiment == experiment]
        rows = [{**run.row, "setup": run.scheme} for run in runs]
        # the time of a step is measured apart
        table = [line for line in lines(rows) if line.metric.path[0] != "step_time_us"]
        begin, end = runs[0].row["window_s"]
        description = f"{scenario.load(experiment).description}. From {begin:g} to {end:g} s."
        schemes = dict.fromkeys(scheme_title(run.scheme) for run in runs)
        tables.append((experiment, description, table, list(schemes)))
    return tables


def _times(results: Results) -> list[tuple[str, str, str, str, str]]:
    if not results.times:
        return []
    lines = []
    for scheme, ours in sorted(results.times.items(), key=lambda item: item[1]):
        published = TIMES.get(scheme)
        lines.append(
            (
                scheme_title(scheme),
                "–" if published is None else f"{published:.0f} µs",
                f"{ours:.3f} µs",
                "–" if published is None else f"{published / TIMES['mfpcc']:.2f}",
                f"{ours / results.times['mfpcc']:.2f}",
            )
        )
    return lines


def _made(results: Results, engine: str) -> str:
    how = {
        "ros": "both nodes on a real ROS 2 graph, every message recorded",
        "inprocess": "the same plant and controller code as the nodes', without the graph",
    }[engine]
    recorded = results.recorded
    periods = sum(run.row["periods"] for run in recorded)
    lost = sum(run.row["lost_periods"] for run in recorded)
    others = len(results.runs) - len(recorded)
    also = (
        f" {others} more runs, with other seeds of the noise, were made in process, where they "
        "give the same samples as on the graph; they leave no recording, and metrics.json holds "
        "what was measured."
        if others
        else " No other seed was run: what depends on chance cannot be told."
    )
    return (
        f"{len(recorded)} recorded runs of seed {results.seeds[0]}, {periods} periods of the PWM, "
        f"{lost} of them lost; engine '{engine}': {how}. The figures are of these, the tables of "
        f"numbers of all seeds.{also} The recordings lie beside this page, one folder per "
        "experiment: 'mfpcc compare' and 'mfpcc replay' take them. Current sensors with 20 mA rms "
        "of noise on i_d and i_q, ideal encoder and inverter: the paper's are not known."
    )
