"""
Whether currents, duties and angle belong together: signs, phases, the direction of rotation.

In the stationary frame, with complex coefficients,

    i(k+1) - i(k) = a u(k) + b u*(k) + N i(k) + w_m (e exp(j theta) + f exp(-j theta)) + c

where all is right, a is the period over the inductance, b is small (0 without saliency), and e is
the EMF's. Another order of the phases turns or mirrors what u does, a wrong sign turns it by half a
turn; an angle that runs backwards makes f larger than e.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from mfpcc_experiments.identifying.linear import FEWEST
from mfpcc_experiments.identifying.steps import Steps

_THIRD = 2.0 * math.pi / 3.0
# Share of the largest excitation: below it a direction is not excited.
_NO_EXCITATION = 1e-3
# How many times larger what is mirrored has to be.
_CLEARLY = 1.5

# What a turn by so many sixths says of the phases: which of the currents belongs to legs a, b, c.
_TURNED = {
    0: (1, "abc"),
    1: (-1, "cab"),
    2: (1, "bca"),
    3: (-1, "abc"),
    4: (1, "cab"),
    5: (-1, "bca"),
}
_MIRRORED = {
    0: (1, "acb"),
    1: (-1, "cba"),
    2: (1, "bac"),
    3: (-1, "acb"),
    4: (1, "cba"),
    5: (-1, "bac"),
}


@dataclass(frozen=True)
class Connection:
    """
    How a recording is connected.

    Attributes
    ----------
    sign : int
        -1 where the currents count the other way round than the voltages.
    order : str
        Which of the recorded currents belong to the legs a, b, c of the duties.
    backwards : bool
        Whether the angle runs against the order of the phases.
    one_axis : bool
        Whether voltage was applied in one direction only: then the order is not known.
    """

    sign: int = 1
    order: str = "abc"
    backwards: bool = False
    one_axis: bool = False

    @property
    def wrong(self) -> list[str]:
        """What is wrong, in sentences; empty where nothing is."""
        found = []
        if self.sign < 0:
            found.append(
                "the currents fall where the voltage should let them rise: turn their sign "
                "(scale: -1 in the map), or that of the voltages"
            )
        if self.order != "abc":
            belong = ", ".join(
                f"{leg}: {name}" for leg, name in zip("abc", self.order, strict=True)
            )
            found.append(
                "the currents do not belong to the legs that they are recorded for: of the "
                f"recorded ones those of the legs are {belong}"
            )
        if self.backwards:
            found.append(
                "the angle runs against the order of the phases: turn its sign, or exchange two "
                "phases of both currents and duties"
            )
        return found


def connection(steps: Steps) -> Connection | None:
    """
    Find out how a recording is connected.

    Parameters
    ----------
    steps : Steps
        The recording, with the voltages at the right delay.

    Returns
    -------
    Connection or None
        None where there are too few steps, or no voltage.
    """
    rows = np.flatnonzero(steps.whole)
    if len(rows) < FEWEST:
        return None
    u, i = steps.u_s_ab[rows], steps.i_s_ab[rows]
    change = steps.i_s_ab[rows + 1] - i
    middle = steps.theta_m[rows] + 0.5 * steps.T_s * steps.w_m[rows]
    emf = steps.w_m[rows] * np.exp(1j * middle)
    # A constant EMF of a rotor that turns evenly is told from the voltage by the noise in both.
    columns = np.stack([u, u.conj(), i, i.conj(), emf, emf.conj(), np.ones(len(rows))], axis=1)
    size = np.sqrt((np.abs(columns) ** 2).mean(axis=0))
    if size[0] == 0.0:
        return None
    size[size == 0.0] = 1.0
    spread = np.linalg.eigvalsh(np.cov(u.real, u.imag))
    if spread[0] < _NO_EXCITATION * spread[1]:
        # One axis: u and its mirror image are the same but for a constant turn.
        columns[:, [1, 3]] = 0.0
        found, *_ = np.linalg.lstsq(columns / size, change, rcond=1e-9)
        return Connection(sign=1 if found[0].real >= 0.0 else -1, one_axis=True)
    found, *_ = np.linalg.lstsq(columns / size, change, rcond=1e-9)
    a, b, _, _, e, f, _ = found / size
    mirrored = abs(b) > _CLEARLY * abs(a)
    sixth = round(cmath.phase(b if mirrored else a) / (math.pi / 3.0)) % 6
    sign, order = (_MIRRORED if mirrored else _TURNED)[sixth]
    # With two phases exchanged the EMF of the currents that were measured turns backwards too.
    with_, against = (f, e) if mirrored else (e, f)
    turning = float(np.abs(steps.w_m[rows]).max()) * (abs(e) + abs(f)) > 0.0
    backwards = turning and abs(against) > _CLEARLY * abs(with_)
    return Connection(sign=sign, order=order, backwards=bool(backwards))
