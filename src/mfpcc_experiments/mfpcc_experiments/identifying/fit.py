"""Fitting the model to a recording: parameters, and how far they can be trusted."""

from __future__ import annotations

import cmath
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mfpcc_experiments.identifying.linear import FEWEST, one_step
from mfpcc_experiments.identifying.model import NAMES, direction, simulate
from mfpcc_experiments.identifying.steps import Steps

# Steps that are used at most: more of them take time and tell little more.
_MOST = 60_000
# Of the largest current: below it the sign of a leg's current is not certain.
_UNCERTAIN = 0.03
# How far parameters may be from where the fit begins: natural logarithms of R, L and tau, and the
# others in units of their scale; where the data do not tell, this is what is not known.
_PRIOR = np.array([3.0, 3.0, 3.0, 3.0, 1.0, 10.0, 3.0, 3.0, 3.0, 3.0, 3.0])
_LOGARITHMIC = np.array([name in ("R_s", "L_d", "L_q", "tau") for name in NAMES])
_BLOCKS = 60
# Share of the current's variance: a fit that leaves less began at the right place.
_WELL = 0.05
_MOST_ITERATIONS = 30
# Where the fit of a lag begins, in periods.
_LAG = 0.3
# Natural logarithm of how much likelier a lag has to make the data.
_BETTER = 10.0
# Normal distribution: 95 % lie within so many standard deviations.
_TWO_SIDED = 1.96
# Share of a value that the model itself may be off: means over periods, straight lines between
# samples. No interval is narrower than that.
_MODEL = np.array([0.006, 0.005, 0.005, 0.003] + [0.0] * 7)


@dataclass(frozen=True)
class Fit:
    """
    A fitted model.

    Attributes
    ----------
    values : dict of float
        By the names of `model.NAMES`, SI units.
    low, high : dict of float
        Limits between which the truth lies with a probability of 95 %.
    rms : float
        What is left of the measured current (A).
    explained : float
        Share of the current's variance that the model explains, 0 to 1.
    steps : int
        How many were used.
    residual : ndarray of complex, shape (n,)
        Measured minus simulated, in the stationary frame (A).
    """

    values: dict[str, float]
    low: dict[str, float]
    high: dict[str, float]
    rms: float
    explained: float
    steps: int
    residual: NDArray[np.complex128]

    def told(self, name: str, within: float = 0.5) -> bool:
        """Whether the data tell a value: the interval is no wider than this share of it."""
        half = 0.5 * (self.high[name] - self.low[name])
        return bool(half <= within * abs(self.values[name]))


class _Problem:
    """Residuals of a stretch of a recording, in scaled parameters."""

    def __init__(self, steps: Steps, free: tuple[str, ...]) -> None:
        self.steps = steps
        self.free = np.array([name in free for name in NAMES])
        i_max = max(float(np.abs(steps.i_s_ab).max()), 1e-9)
        self.i_max = i_max
        u = steps.u_s_ab[:-1]
        self.u_s_ab = np.append(u, 0.0)
        i_abc = np.stack(
            [(steps.i_s_ab * np.exp(-2j * np.pi / 3.0 * n)).real for n in range(3)], axis=1
        )
        # Between two samples the mean of both counts.
        middle = np.concatenate([0.5 * (i_abc[1:] + i_abc[:-1]), i_abc[-1:]])
        self.s_ab = direction(middle, _UNCERTAIN * i_max)
        u_max = max(float(np.abs(u).max()), 1e-9)
        w_max = max(float(np.abs(steps.w_m).max()), 1.0)
        self.scale = np.array(
            [1.0, 1.0, 1.0, u_max / w_max, 1.0, 0.01 * u_max, 1.0]
            + [0.01 * i_max] * 2
            + [0.1 * i_max] * 2
        )
        i_0 = steps.i_s_ab[0] * np.exp(-1j * steps.theta_m[0])
        self.start = np.zeros(len(NAMES))
        self.start[9:] = [i_0.real, i_0.imag]

    def begin(self, at: NDArray[np.float64]) -> None:
        """Where the fit begins: all parameters, or the first of them."""
        self.start[: len(at)] = at

    def parameters(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        par = self.start.copy()
        moved = np.zeros(len(NAMES))
        moved[self.free] = x
        with np.errstate(over="ignore"):
            par[_LOGARITHMIC] *= np.exp(moved[_LOGARITHMIC])
        par[~_LOGARITHMIC] += moved[~_LOGARITHMIC] * self.scale[~_LOGARITHMIC]
        return par

    def residual(self, par: NDArray[np.float64]) -> NDArray[np.complex128]:
        out = np.empty(len(self.u_s_ab), np.complex128)
        s = self.steps
        simulate(par, s.T_s, s.theta_m, s.w_m, self.u_s_ab, self.s_ab, out)
        error: NDArray[np.complex128] = s.i_s_ab - out
        # What runs away is no better than nothing at all.
        bad = ~(np.abs(error) < 1e3 * self.i_max)
        error[bad] = 1e3 * self.i_max
        return error

    def vector(self, x: NDArray[np.float64], noise: float) -> NDArray[np.float64]:
        error = self.residual(self.parameters(x)) / noise
        return np.concatenate([error.real, error.imag, x / _PRIOR[self.free]])


def fit(
    steps: Steps,
    *,
    most: int = _MOST,
    rough: bool = False,
    near: Fit | None = None,
) -> Fit | None:
    """
    Fit the model to the longest stretch of a recording in which nothing is missing.

    Parameters
    ----------
    steps : Steps
        The recording.
    most : int
        Steps to use at most.
    rough : bool
        Motor and lag of the sensors only: no dead time, no offsets, and no judgement whether there
        is a lag at all.
    near : Fit, optional
        Another one, to begin with its values.

    Returns
    -------
    Fit or None
        None where the stretch is too short.
    """
    stretch = steps.cut(steps.longest(most))
    if len(stretch.period) < FEWEST + 1:
        return None
    free = ["R_s", "L_d", "L_q", "i_d0", "i_q0"]
    if _turns(stretch):
        free += ["psi_f", "zero"]
    begin = [] if near is None else [np.array([near.values[name] for name in NAMES[:5]])]
    starts = [*begin, *_starts(stretch)]
    lag = [0.0, _LAG * stretch.T_s]  # of u_dead and tau
    if rough:
        return _solve(stretch, (*free, "tau"), [np.append(start, lag) for start in starts])[0]
    free += ["u_dead", "offset_a", "offset_b"]
    plain, at = _solve(stretch, tuple(free), starts)
    # A low-pass only where it explains more than chance does.
    at[NAMES.index("tau")] = _LAG * stretch.T_s
    lagging, _ = _solve(stretch, (*free, "tau"), [at])
    better = 2 * plain.steps * np.log(plain.rms / max(lagging.rms, 1e-12))
    return lagging if better > _BETTER else plain


def _turns(stretch: Steps) -> bool:
    """Whether the rotor turns by so much that its EMF can be told from the rest."""
    return bool(np.ptp(stretch.theta_m) > np.pi)


def _starts(stretch: Steps) -> list[NDArray[np.float64]]:
    """Where to begin with R_s, L_d, L_q, psi_f, zero: what one step ahead tells, and guesses."""
    found = one_step(stretch)
    T = stretch.T_s
    u, i = np.abs(stretch.u_s_ab[:-1]), np.abs(stretch.i_s_ab)
    L = T * float(np.sqrt(np.mean(u**2))) / max(float(i.max()), 1e-9)
    guesses = [np.array([0.02 * L / T, L, L, 0.0, 0.0])]
    if found is not None:
        c = found.coefficients
        b_d, b_q = c[2, 0], c[3, 1]
        if b_d > 0.0 or b_q > 0.0:
            b_d, b_q = (b_d or b_q) if b_d > 0.0 else b_q, b_q if b_q > 0.0 else b_d
            L_d, L_q = T / b_d, T / b_q
            R = max(-c[1, 1] * L_q / T, 1e-3 * L_q / T)
            psi = complex(-c[4, 1] * L_q / T, c[4, 0] * L_d / T)
            if not _turns(stretch):
                psi = 0j
            told = np.array([R, L_d, L_q, abs(psi), cmath.phase(psi)])
            guesses = [told, *guesses, told * [1.0, 0.3, 0.3, 1.0, 1.0]]
    return guesses


def _solve(
    stretch: Steps, free: tuple[str, ...], starts: list[NDArray[np.float64]]
) -> tuple[Fit, NDArray[np.float64]]:
    problem = _Problem(stretch, free)
    best: tuple[float, NDArray[np.float64], NDArray[np.float64]] | None = None
    first = one_step(stretch)
    noise = 1e-3 * problem.i_max
    if first is not None:
        noise = max(float(np.sqrt(np.mean(np.abs(first.error) ** 2) / 2.0)), 1e-6 * problem.i_max)
    zero = np.zeros(int(problem.free.sum()))
    for guess in starts:
        problem.begin(guess)
        found = least_squares(
            problem.vector,
            zero,
            args=(noise,),
            method="lm",
            x_scale="jac",
            max_nfev=_MOST_ITERATIONS * (len(zero) + 1),
        )
        if best is None or found.cost < best[0]:
            best = found.cost, problem.parameters(found.x), found.jac
        left = 2.0 * best[0] * noise**2 / len(stretch.period)
        if left < _WELL * float(np.var(stretch.i_s_ab)):
            break  # this is the minimum, and no other
    assert best is not None
    problem.start = best[1]
    return _judged(problem, noise), best[1]


def _judged(problem: _Problem, noise: float) -> Fit:
    """Values with their intervals, by what is left of the data."""
    zero = np.zeros(int(problem.free.sum()))
    residual = problem.residual(problem.start)
    n = len(residual)
    variance = max(float(np.mean(np.abs(residual) ** 2)) / 2.0, 1e-24)
    sigma = np.sqrt(variance)
    step = 1e-5
    columns = []
    for k in range(len(zero)):
        x = zero.copy()
        x[k] = step
        up = problem.vector(x, 1.0)
        x[k] = -step
        down = problem.vector(x, 1.0)
        columns.append((up - down)[: 2 * n] / (2.0 * step))
    jacobian = np.stack(columns, axis=1) / sigma
    e = np.concatenate([residual.real, residual.imag]) / sigma
    prior = np.diag(1.0 / _PRIOR[problem.free] ** 2)
    inverse = np.linalg.pinv(jacobian.T @ jacobian + prior, hermitian=True)
    # What is left need not be white: sums over blocks of time keep what belongs together.
    gradient = (jacobian[:n] * e[:n, None]) + (jacobian[n:] * e[n:, None])
    blocks = np.add.reduceat(gradient, np.linspace(0, n, _BLOCKS, endpoint=False).astype(int))
    clustered = inverse @ (blocks.T @ blocks + prior) @ inverse
    spread = np.sqrt(np.maximum(np.diag(inverse), np.diag(clustered)))
    half = np.zeros(len(NAMES))
    half[problem.free] = _TWO_SIDED * spread
    low, high = problem.start.copy(), problem.start.copy()
    half_log = np.hypot(half, _MODEL)
    low[_LOGARITHMIC] *= np.exp(-half_log[_LOGARITHMIC])
    high[_LOGARITHMIC] *= np.exp(half_log[_LOGARITHMIC])
    plain = np.hypot(half * problem.scale, _MODEL * np.abs(problem.start))
    low[~_LOGARITHMIC] -= plain[~_LOGARITHMIC]
    high[~_LOGARITHMIC] += plain[~_LOGARITHMIC]
    i = problem.steps.i_s_ab
    total = float(np.mean(np.abs(i - i.mean()) ** 2))
    left = float(np.mean(np.abs(residual) ** 2))
    return Fit(
        values=dict(zip(NAMES, problem.start.tolist(), strict=True)),
        low=dict(zip(NAMES, low.tolist(), strict=True)),
        high=dict(zip(NAMES, high.tolist(), strict=True)),
        rms=float(np.sqrt(left)),
        explained=max(0.0, 1.0 - left / total) if total > 0.0 else 0.0,
        steps=n - 1,
        residual=residual,
    )
