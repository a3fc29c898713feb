"""Normal noise as a pure function of (seed, period, channel).

A counter-based generator keeps no state: period k of channel c has the same noise in every run
with the same seed, whichever scheme is in control and whichever engine runs it. Comparisons are
therefore paired, sample by sample.
"""

from __future__ import annotations

import math

import numpy as np

from pwm_node.compiled import kernel

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S27, _S30, _S31, _S11 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(11)
_ONE = np.uint64(1)
_TO_UNIT = 1.0 / 9007199254740992.0  # 2^-53


@kernel
def _mixed(x):
    """SplitMix64's output function (Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195)."""
    x = (x ^ (x >> _S30)) * _MIX_1
    x = (x ^ (x >> _S27)) * _MIX_2
    return x ^ (x >> _S31)


@kernel
def normal_pair(seed, period, channel):
    """Two independent standard normal numbers (Box and Muller) for one period and channel.

    Parameters
    ----------
    seed, period, channel : np.uint64

    Returns
    -------
    (float, float)
    """
    stream = _mixed(seed + _GOLDEN * (channel + _ONE))
    counter = stream + _GOLDEN * (period + period + _ONE)
    # 1 - u is in (0, 1], so that the logarithm is finite
    u_1 = 1.0 - float(_mixed(counter) >> _S11) * _TO_UNIT
    u_2 = float(_mixed(counter + _GOLDEN) >> _S11) * _TO_UNIT
    radius = math.sqrt(-2.0 * math.log(u_1))
    return radius * math.cos(2.0 * math.pi * u_2), radius * math.sin(2.0 * math.pi * u_2)
