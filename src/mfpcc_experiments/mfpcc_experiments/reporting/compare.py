"""From recordings to a comparison: metrics, figures and a report in one folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mfpcc_experiments.bags import BagError, recording
from mfpcc_experiments.files import write_rows, write_whole
from mfpcc_experiments.measuring import Measured, cut, evaluate, labels, shown
from mfpcc_experiments.measuring.signals import signals
from pwm_node.lags import bins_of

Progress = Callable[[float], None]

# Shares of the time that a comparison takes: reading, figures, report.
_READING, _DRAWING = 0.6, 0.9


def compare(
    paths: Sequence[Path],
    out: Path,
    *,
    window_s: Sequence[float] | None = None,
    namespace: str | None = None,
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
    namespace : str, optional
        Which axis, of recordings that hold several (``/axis1``).
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
    if not paths:
        raise BagError("no recordings to compare")

    def tell(share: float) -> None:
        if progress is not None:
            progress(share)

    runs = measure(paths, lambda share: tell(_READING * share), window_s, namespace)
    rows = [run.row for run in runs]
    # matplotlib takes its time to load: only for what can be compared
    from mfpcc_experiments.reporting import figures, report

    out = Path(out)
    (out / "figures").mkdir(parents=True, exist_ok=True)
    drawn = figures.draw(shown(runs), out / "figures")
    tell(_DRAWING)
    write_whole(out / "report.html", report.render(runs, drawn))
    write_rows(out, rows)
    tell(1.0)
    return rows


def measure(
    paths: Sequence[Path],
    progress: Progress | None = None,
    window_s: Sequence[float] | None = None,
    namespace: str | None = None,
) -> list[Measured]:
    """
    Read and measure recordings one after the other, so that only one is in memory at a time.

    Parameters
    ----------
    paths : sequence of Path
        Bags.
    progress : callable, optional
        Told the share that is done, 0 to 1.
    window_s, namespace
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

        parts.append(_measure_one(Path(path), tell, window_s, namespace))
    names = labels([part["row"] for part in parts], [Path(path) for path in paths])
    numbers = setups(
        [Path(path) for path in paths],
        [part["row"] for part in parts],
        [part["config"] for part in parts],
    )
    for part, number in zip(parts, numbers, strict=True):
        part["row"]["setup"] = number
    return [
        Measured(path=Path(path), label=name, **part)
        for path, name, part in zip(paths, names, parts, strict=True)
    ]


def setups(
    paths: Sequence[Path], rows: Sequence[Mapping[str, Any]], configs: Sequence[Mapping[str, Any]]
) -> list[int]:
    """
    Number of the setup of each recording, the same for those that differ in their seed alone.

    Parameters
    ----------
    paths : sequence of Path
        Recordings. Those in other folders are other results: they may be of other code.
    rows : sequence of mapping
        Their objects of ``metrics.json``. Where another scheme controlled it is another setup.
    configs : sequence of mapping
        Their configurations. One without a seed, or with a seed that is there already, is a setup
        of its own: it is no second opinion.
    """
    numbers: dict[Any, int] = {}
    seen: set[tuple[int, str]] = set()
    found = []
    for n, (path, row, config) in enumerate(zip(paths, rows, configs, strict=True)):
        seed = json.dumps(config.get("seed"))
        others = json.dumps(_without_seed(config), sort_keys=True)
        number = numbers.setdefault((path.resolve().parent, row["scheme"], others), n)
        if config.get("seed") is None or (number, seed) in seen:
            number = n
        seen.add((number, seed))
        found.append(number)
    order = {number: k for k, number in enumerate(dict.fromkeys(found))}
    return [order[number] for number in found]


def _without_seed(config: Mapping[str, Any]) -> dict[str, Any]:
    """A configuration less the seed, which stands in the parameters of the nodes, too."""
    parameters = config.get("parameters")
    if isinstance(parameters, dict):
        parameters = {
            node: {name: v for name, v in values.items() if name != "seed"}
            if isinstance(values, dict)
            else values
            for node, values in parameters.items()
        }
    return {k: v for k, v in config.items() if k != "seed"} | {"parameters": parameters}


def _measure_one(
    path: Path,
    progress: Progress,
    window_s: Sequence[float] | None,
    namespace: str | None,
) -> dict[str, Any]:
    found = recording.read(path, namespace=namespace, progress=progress)
    return {
        "row": evaluate(found, window_s),
        "window": cut(found, window_s),
        "signals": signals(found),
        "config": found.config,
        "lags": _lags(found.summary.get("lags")),
    }


def _lags(stored: object) -> dict[str, Any]:
    """The histograms that a recording holds of a paced run."""
    given = stored if isinstance(stored, dict) else {}
    found = {name: bins_of(given.get(name)) for name in ("start", "round_trip")}
    return {name: bins for name, bins in found.items() if bins is not None}
