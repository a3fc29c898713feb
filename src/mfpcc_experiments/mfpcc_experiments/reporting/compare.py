"""From recordings to a comparison: metrics, figures and a report in one folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mfpcc_experiments.bags import BagError, recording
from mfpcc_experiments.files import write_rows, write_whole
from mfpcc_experiments.measuring import Measured, cut, evaluate, labels
from mfpcc_experiments.measuring.signals import signals

Progress = Callable[[float], None]

# Shares of the time that a comparison takes: reading, figures, report.
_READING, _DRAWING = 0.6, 0.9


def compare(
    paths: Sequence[Path],
    out: Path,
    *,
    window_s: Sequence[float] | None = None,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """
    Measure recordings and compare them.

    Parameters
    ----------
    paths : sequence of Path
        Bags, in the order in which they shall appear.
    out : Path
        Folder for ``metrics.json``, ``figures/`` and ``report.html``; made if it is missing.
    window_s : sequence of two floats, optional
        Evaluation window of all (s); default: the one stored in each recording, else all of it.
    progress : callable, optional
        Told the share that is done, 0 to 1.

    Returns
    -------
    list of dict
        The objects of ``metrics.json``, one per recording.

    Raises
    ------
    BagError, MetricsError
        If a recording cannot be read or measured. Nothing is written then.
    """
    # matplotlib takes its time to load
    from mfpcc_experiments.reporting import figures, report

    if not paths:
        raise BagError("no recordings to compare")

    def tell(share: float) -> None:
        if progress is not None:
            progress(share)

    runs = measure(paths, lambda share: tell(_READING * share), window_s)
    rows = [run.row for run in runs]
    out = Path(out)
    (out / "figures").mkdir(parents=True, exist_ok=True)
    drawn = figures.draw(runs, out / "figures")
    tell(_DRAWING)
    write_whole(out / "report.html", report.render(runs, drawn))
    write_rows(out, rows)
    tell(1.0)
    return rows


def measure(
    paths: Sequence[Path],
    progress: Progress | None = None,
    window_s: Sequence[float] | None = None,
) -> list[Measured]:
    """
    Read and measure recordings one after the other, so that only one is in memory at a time.

    Parameters
    ----------
    paths : sequence of Path
        Bags.
    progress : callable, optional
        Told the share that is done, 0 to 1.
    window_s : sequence of two floats, optional
        See `compare`.

    Returns
    -------
    list of Measured
        With labels that tell them apart.
    """
    parts = []
    for n, path in enumerate(paths):

        def tell(share: float, n: int = n) -> None:
            if progress is not None:
                progress((n + share) / len(paths))

        parts.append(_measure_one(Path(path), tell, window_s))
    names = labels([part["row"] for part in parts], [Path(path) for path in paths])
    return [
        Measured(path=Path(path), label=name, **part)
        for path, name, part in zip(paths, names, parts, strict=True)
    ]


def _measure_one(
    path: Path, progress: Progress, window_s: Sequence[float] | None
) -> dict[str, Any]:
    found = recording.read(path, progress=progress)
    return {
        "row": evaluate(found, window_s),
        "window": cut(found, window_s),
        "signals": signals(found),
        "config": found.config,
    }
