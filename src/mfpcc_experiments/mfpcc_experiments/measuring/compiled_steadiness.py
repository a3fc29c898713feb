"""
Whether a window is steady, as compiled kernels: `steadiness` and what it needs of `waveform`.

The limits are those of `steadiness`; angles are the electrical one, unwrapped (rad).
"""

from __future__ import annotations

import math

import numpy as np

from mfpcc_experiments.measuring.steadiness import (
    EXCURSION_BY_CHANCE,
    FEWEST_PERIODS,
    FEWEST_SAMPLES,
    MOVEMENT,
    MOVEMENT_BY_CHANCE,
    NO_CHANGE,
    SLOW_PARTS,
    SMALL,
    TRANSIENT,
    TREND,
    TREND_BY_CHANCE,
)
from mfpcc_experiments.measuring.waveform import PARTS_AT_STANDSTILL, STANDSTILL, TWO_PI
from pwm_node.compiled import kernel
from pwm_node.units import RPM


@kernel
def mean(x):
    """Mean of `x`."""
    total = 0.0
    for k in range(x.shape[0]):
        total += x[k]
    return total / x.shape[0]


@kernel
def ripple_pp(x):
    """`waveform.ripple_pp`."""
    low = high = x[0]
    for k in range(x.shape[0]):
        low, high = min(low, x[k]), max(high, x[k])
    return high - low


@kernel
def unwrap(x):
    """`waveform.unwrap`, in place."""
    correction, before = 0.0, x[0]
    for k in range(1, x.shape[0]):
        here = x[k]
        step = here - before
        before = here
        if abs(step) >= math.pi:
            inside = (step + math.pi) % TWO_PI - math.pi
            if inside == -math.pi and step > 0.0:
                inside = math.pi
            correction += inside - step
        x[k] = here + correction


@kernel
def turns(theta):
    """`waveform.turns`, shape (n + 1,): the last entry is extrapolated."""
    n = theta.shape[0]
    turned = np.empty(n + 1)
    most = 0.0
    for k in range(n):
        most = max(most, abs(theta[k] - theta[0]))
        turned[k] = most / TWO_PI
    turned[n] = 2.0 * turned[n - 1] - turned[n - 2]
    return turned


@kernel
def period_means(x, turned, periods):
    """`waveform.period_means` of real `x`; `turned` is that of `turns`."""
    n = x.shape[0]
    if turned[n - 1] < STANDSTILL:
        if n < PARTS_AT_STANDSTILL:
            return np.empty(0)
        means = np.empty(PARTS_AT_STANDSTILL)
        each, more = n // PARTS_AT_STANDSTILL, n % PARTS_AT_STANDSTILL
        begin = 0
        for part in range(PARTS_AT_STANDSTILL):
            end = begin + each + (1 if part < more else 0)
            means[part] = mean(x[begin:end])
            begin = end
        return means
    total = np.empty(n + 1)
    total[0] = 0.0
    for k in range(n):
        total[k + 1] = total[k] + x[k]
    means = np.empty(n)
    most = turned[n] + 0.5 * (turned[n] / n)
    count, j = 0, 0
    while count < n and turned[count] + periods <= most:
        wanted = turned[count] + periods
        while j < n and turned[j + 1] <= wanted:
            j += 1
        end, at_end = float(n), total[n]
        if j < n:
            share = (wanted - turned[j]) / (turned[j + 1] - turned[j])
            end, at_end = j + share, total[j] + share * x[j]
        means[count] = (at_end - total[count]) / (end - count)
        count += 1
    return means[:count]


@kernel
def can_be_judged(turned):
    """`steadiness.can_be_judged`."""
    n = turned.shape[0] - 1
    if turned[n - 1] < STANDSTILL:
        return n >= PARTS_AT_STANDSTILL * FEWEST_SAMPLES
    return turned[n - 1] * (1.0 + 1.5 / (n - 1)) >= FEWEST_PERIODS


@kernel
def _content(d, q):
    """Rms distance of a current from its mean."""
    centre_d, centre_q, total = mean(d), mean(q), 0.0
    for k in range(d.shape[0]):
        total += (d[k] - centre_d) ** 2 + (q[k] - centre_q) ** 2
    return math.sqrt(total / d.shape[0])


@kernel
def _excursion(d, q):
    """Largest distance of a current from its mean."""
    centre_d, centre_q, most = mean(d), mean(q), 0.0
    for k in range(d.shape[0]):
        most = max(most, math.hypot(d[k] - centre_d, q[k] - centre_q))
    return most


@kernel
def is_steady(i_d, i_q, turned, i_max, fine_d, fine_q):
    """`steadiness.is_steady`; without an oversampled current, `fine_d` is empty."""
    n = i_d.shape[0]
    means_d, means_q = period_means(i_d, turned, 1), period_means(i_q, turned, 1)
    if means_d.shape[0] == 0:
        return False
    size = max(math.hypot(mean(means_d), mean(means_q)), SMALL * i_max)
    each = max(1, int(turned[n - 1]) // SLOW_PARTS)
    slow_d, slow_q = means_d, means_q
    if each > 1:
        slow_d, slow_q = period_means(i_d, turned, each), period_means(i_q, turned, each)
    m = slow_d.shape[0]
    centre_d, centre_q = mean(slow_d), mean(slow_q)
    along_d = along_q = line_sq = 0.0
    for k in range(m):
        line = -1.0 + 2.0 * k / (m - 1) if m > 1 else -1.0
        along_d += line * (slow_d[k] - centre_d)
        along_q += line * (slow_q[k] - centre_q)
        line_sq += line * line
    trend = math.hypot(along_d, along_q) / max(math.sqrt(line_sq * m), 1.0)
    noise = _content(i_d, i_q)
    content = _content(fine_d, fine_q) if fine_d.shape[0] > 0 else noise
    samples = n / (turned[n - 1] if turned[n - 1] >= STANDSTILL else PARTS_AT_STANDSTILL)
    least = NO_CHANGE * size
    far = EXCURSION_BY_CHANCE * noise / math.sqrt(samples)
    slope = TREND_BY_CHANCE * noise / math.sqrt(n)
    moved = MOVEMENT_BY_CHANCE * noise / math.sqrt(samples * each)
    return (
        _excursion(means_d, means_q) <= max(TRANSIENT * size, far)
        and trend <= max(least, TREND * content, slope)
        and _content(slow_d, slow_q) <= max(least, MOVEMENT * content, moved)
    )


@kernel
def reference_changes(speed_ref, i_d_ref, i_q_ref):
    """Whether what is asked for from outside does: a speed, or in current control a current."""
    finite = 0
    for k in range(speed_ref.shape[0]):
        if np.isfinite(speed_ref[k]):
            finite += 1
    if finite == speed_ref.shape[0]:
        return ripple_pp(speed_ref) != 0.0
    return finite > 0 or ripple_pp(i_d_ref) != 0.0 or ripple_pp(i_q_ref) != 0.0


@kernel
def load_changes(load, tau_max, turned):
    """Whether the torque of the load changes, which may be up to `tau_max` (N m)."""
    n = load.shape[0]
    if n < 8 or ripple_pp(load) == 0.0:
        return False
    size = jump = 0.0
    for k in range(n):
        size += abs(load[k])
        if k > 0:
            jump = max(jump, abs(load[k] - load[k - 1]))
    small = SMALL * max(size / n, tau_max)
    if jump > small:
        return True
    means = period_means(load, turned, 1)
    return means.shape[0] > 0 and ripple_pp(means) > 2.0 * small


@kernel
def speed_changes(speed, w_max, turned):
    """Whether the speed (rad/s) changes, which may be up to `w_max`."""
    means = period_means(speed, turned, 1)
    if means.shape[0] == 0:
        return False
    size = 0.0
    for k in range(means.shape[0]):
        size += abs(means[k])
    small = TRANSIENT * max(size / means.shape[0] / RPM, SMALL * w_max / RPM, 1e-3)
    return ripple_pp(means) / RPM > small
