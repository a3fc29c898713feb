"""A recording as steps: from one sample to the next, with the voltage that acted between them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.bags import Recording
from mfpcc_experiments.measuring import rows_of
from mfpcc_experiments.measuring.waveform import space_vector

_TWO_PI = 2.0 * np.pi
# Samples over which the angle is smoothed: an encoder's steps, but no motion, are shorter.
_SMOOTHED = 21
_DEGREE = 2


@dataclass(frozen=True)
class Steps:
    """
    Samples, and what acted from each of them to the next; one row per sample.

    Attributes
    ----------
    T_s : float
        PWM period (s).
    period : ndarray of int64, shape (n,)
        Rising; where a number is left out, something was lost.
    i_s_ab : ndarray of complex, shape (n,)
        Measured current in the stationary frame (A).
    theta_m : ndarray, shape (n,)
        Electrical angle (rad), smoothed.
    w_m : ndarray, shape (n,)
        Mean electrical speed from a sample to the next (rad/s).
    u_s_ab : ndarray of complex, shape (n,)
        Mean voltage that was commanded from a sample to the next (V); NaN where none is known.
    whole : ndarray of bool, shape (n,)
        Whether the voltage is known, and the next sample there.
    """

    T_s: float
    period: NDArray[np.int64]
    i_s_ab: NDArray[np.complex128]
    theta_m: NDArray[np.float64]
    w_m: NDArray[np.float64]
    u_s_ab: NDArray[np.complex128]
    whole: NDArray[np.bool_]

    def cut(self, rows: slice) -> Steps:
        """Some of the rows; the last of them leads nowhere."""
        return replace(
            self,
            **{
                name: getattr(self, name)[rows]
                for name in ("period", "i_s_ab", "theta_m", "w_m", "u_s_ab", "whole")
            },
        )

    def later(self, periods: int) -> Steps:
        """The same, if each voltage acted so many periods later than it was recorded."""
        n = len(self.period)
        at = np.searchsorted(self.period, self.period - periods)
        row = np.minimum(at, n - 1)
        there = (at < n) & (self.period[row] == self.period - periods)
        u_s_ab = np.where(there, self.u_s_ab[row], np.nan)
        followed = np.append(np.diff(self.period) == 1, False)
        return replace(self, u_s_ab=u_s_ab, whole=followed & np.isfinite(u_s_ab))

    def longest(self, most: int) -> slice:
        """The longest stretch in which nothing is missing, and the sample at its end."""
        borders = np.flatnonzero(np.diff(np.concatenate([[0], self.whole.astype(int), [0]])))
        begins, ends = borders[::2], borders[1::2]
        if not len(begins):
            return slice(0, 0)
        k = int(np.argmax(ends - begins))
        return slice(int(begins[k]), int(min(ends[k], begins[k] + most)) + 1)


def steps_of(
    i_s_ab: NDArray[np.complex128],
    theta_m: NDArray[np.float64],
    u_s_ab: NDArray[np.complex128],
    period: NDArray[np.int64],
    T_s: float,
) -> Steps:
    """
    Make steps of arrays with one row per sample.

    Parameters
    ----------
    i_s_ab, u_s_ab : ndarray of complex, shape (n,)
        Current (A), and the voltage from the sample to the next (V), NaN where not known.
    theta_m : ndarray, shape (n,)
        Electrical angle, modulo a turn (rad).
    period : ndarray of int64, shape (n,)
        Rising.
    T_s : float
        (s)
    """
    smooth, w_m = np.empty(len(theta_m)), np.zeros(len(theta_m))
    borders = np.flatnonzero(np.diff(period) != 1) + 1
    for rows in np.split(np.arange(len(period)), borders):
        angle = np.unwrap(theta_m[rows])
        if len(rows) > _SMOOTHED and np.ptp(angle) > 0.0:
            from scipy.signal import savgol_filter

            angle = savgol_filter(angle, _SMOOTHED, _DEGREE)
        smooth[rows] = angle
        if len(rows) > 1:
            w_m[rows] = np.append(np.diff(angle), angle[-1] - angle[-2]) / T_s
    followed = np.append(np.diff(period) == 1, False)
    return Steps(T_s, period, i_s_ab, smooth, w_m, u_s_ab, followed & np.isfinite(u_s_ab))


def of_recording(recording: Recording, n_p: int) -> Steps:
    """
    The steps of a recording.

    Parameters
    ----------
    recording : Recording
        From `bags.read`.
    n_p : int
        Pole pairs.

    Returns
    -------
    Steps
        Voltages are those of the recorded duties; where the gates were off, they are not known.
    """
    feedback = recording.feedback
    period = feedback["period"].astype(np.int64)
    row, there = rows_of(recording.command["period"], feedback["period"])
    command = recording.command[row]
    with np.errstate(invalid="ignore"):
        u_s_ab = space_vector(command["duty"]) * feedback["dc_voltage"]
    known = there & command["enable"]
    i_abc = np.stack([feedback[f"i_{leg}"] for leg in "abc"], axis=1)
    return steps_of(
        space_vector(i_abc),
        n_p * feedback["encoder_angle"] % _TWO_PI,
        np.where(known, u_s_ab, np.nan),
        period,
        recording.T_s,
    )
