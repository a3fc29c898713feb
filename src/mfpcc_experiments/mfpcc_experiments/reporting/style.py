"""What figures and pages look like: colours, marks, lines and files."""

from __future__ import annotations

from typing import Any

#: Colours of Okabe and Ito, told apart by everybody, in an order that keeps their distance; and two
#: of Tol's, for a ninth scheme.
COLOURS = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#882255",
    "#999933",
)  # fmt: skip

#: Marks that tell recordings apart where colours do not, as in a grey print. Their number has no
#: factor in common with that of the colours, so that ninety recordings differ in one or the other.
MARKS = "●■▲▼◆✚✖★◀▶"

#: Phases a, b, c, with marks for a grey print, and references.
PHASES = (COLOURS[0], COLOURS[1], COLOURS[2])
PHASE_MARKS = ("o", "s", "^")
REFERENCE = "#000000"

#: What all figures are drawn with: `with mpl.rc_context(STYLE)`.
STYLE: Any = {
    "font.size": 8.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 8.0,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.5,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.direction": "out",
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "lines.linewidth": 0.9,
    "savefig.dpi": 220,
    "savefig.facecolor": "white",
    "figure.facecolor": "white",
    "agg.path.chunksize": 20_000,
    "path.simplify_threshold": 0.3,
    "svg.hashsalt": "mfpcc",  # the same names inside the file each time
    "pdf.fonttype": 42,  # text that can be searched and edited
}

#: Files of each figure, and what they say of their making: nothing that differs from run to run.
FORMATS: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None, "Creator": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


def mark(n: int) -> str:
    """What tells the recording number `n` apart besides its colour."""
    return MARKS[n % len(MARKS)]
