"""
Makes the tables and figures of docs/method.md anew: ``python -m mfpcc_experiments.method``.

Each table stands in the page between ``<!-- NAME -->`` and ``<!-- end -->`` and is written there;
the figures go into the folder ``images`` beside the page.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import matplotlib as mpl

from mfpcc_experiments.files import write_whole
from mfpcc_experiments.method.figures import FIGURES
from mfpcc_experiments.method.tables import TABLES, Rows
from mfpcc_experiments.reporting import STYLE


def markdown(rows: Rows) -> str:
    """A table, its first row as heading."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines.insert(1, "|" + "---|" * len(rows[0]))
    return "\n".join(lines)


def update(page: Path, names: Iterable[str], say: Callable[[str], None]) -> None:
    """
    Make tables and figures anew.

    Parameters
    ----------
    page : Path
        docs/method.md.
    names : iterable of str
        Which; none: all.
    say : callable
        Told what is being made.
    """
    wanted = set(names) or {*TABLES, *FIGURES}
    text = page.read_text()
    for name in wanted & {*TABLES}:
        say(f"table {name}")
        place = re.search(rf"<!-- {name} -->\n(.*?)<!-- end -->", text, re.DOTALL)
        if place is None:
            raise SystemExit(f"{page} has no place <!-- {name} --> ... <!-- end -->")
        text = f"{text[: place.start(1)]}{markdown(TABLES[name]())}\n{text[place.end(1) :]}"
    images = page.parent / "images"
    images.mkdir(exist_ok=True)
    with mpl.rc_context(STYLE):
        for name in wanted & {*FIGURES}:
            say(f"figure {name}")
            FIGURES[name]().savefig(images / f"method_{name}.png")
    write_whole(page, text)


def main(arguments: Sequence[str]) -> None:
    """``python -m mfpcc_experiments.method PAGE [NAME ...]``."""
    if not arguments or arguments[0] in ("-h", "--help"):
        raise SystemExit(
            "usage: python -m mfpcc_experiments.method PAGE [NAME ...]\n"
            f"PAGE: docs/method.md; NAME: {', '.join([*TABLES, *FIGURES])}; none: all"
        )
    unknown = set(arguments[1:]) - {*TABLES, *FIGURES}
    if unknown:
        raise SystemExit(f"unknown: {', '.join(sorted(unknown))}")
    update(Path(arguments[0]), arguments[1:], lambda text: print(text, flush=True))


if __name__ == "__main__":
    main(sys.argv[1:])
