"""Normal noise as a pure function of (seed, period, channel).

A counter-based generator keeps no state: period k of channel c has the same noise in every run
with the same seed, whichever scheme is in control and whichever engine runs it. Comparisons are
therefore paired, sample by sample.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pwm_node.compiled import kernel

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S27, _S30, _S31, _S11 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(11)
_ONE = np.uint64(1)
_TO_UNIT = 1.0 / 9007199254740992.0  # 2^-53

# The ziggurat: 128 layers of equal area below exp(-x^2 / 2). Layer 0 is the base, with the tail
# beyond _TAIL; layer n reaches to _EDGE[n], and is inside the curve up to _RATIO[n] of that.
_LAYERS = 128
_LAYER_MASK = np.uint64(_LAYERS - 1)
_TAIL = 3.442619855899
_AREA = 9.91256303526217e-3


def _ziggurat() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    edge = np.zeros(_LAYERS + 1)
    density = math.exp(-0.5 * _TAIL**2)
    edge[0], edge[1] = _AREA / density, _TAIL
    for n in range(2, _LAYERS):
        density += _AREA / edge[n - 1]
        edge[n] = math.sqrt(-2.0 * math.log(density))
    return edge, edge[1:] / edge[:-1], np.exp(-0.5 * edge**2)


_EDGE, _RATIO, _DENSITY = _ziggurat()


@kernel
def _mixed(x):
    """SplitMix64's output function (Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195)."""
    x = (x ^ (x >> _S30)) * _MIX_1
    x = (x ^ (x >> _S27)) * _MIX_2
    return x ^ (x >> _S31)


@kernel
def _uniform(bits):
    """A number in (0, 1) from the upper 53 bits."""
    return (float(bits >> _S11) + 0.5) * _TO_UNIT


@kernel
def normal(seed, period, channel):
    """A standard normal number for one period and channel.

    The ziggurat method (Marsaglia and Tsang 2000, doi:10.18637/jss.v005.i08) with the sharper
    test of Doornik (2005, "An improved ziggurat method to generate normal random samples"): 99 of
    100 numbers cost one multiplication and one comparison. Where it needs more random bits, they
    come from the same counter, further on.

    Parameters
    ----------
    seed, period, channel : np.uint64
    """
    stream = _mixed(seed + _GOLDEN * (channel + _ONE))
    bits = _mixed(stream + _GOLDEN * (period + _ONE))
    while True:
        layer = bits & _LAYER_MASK
        u = 2.0 * _uniform(bits) - 1.0
        x = u * _EDGE[layer]
        if abs(u) < _RATIO[layer]:
            return x
        # rare: on from here with the chain of this very period and channel
        bits = _mixed(bits + _GOLDEN)
        v = _uniform(bits)
        if layer == 0:  # the tail beyond the last edge
            while True:
                bits = _mixed(bits + _GOLDEN)
                a = -math.log(v) / _TAIL
                b = -math.log(_uniform(bits))
                if 2.0 * b > a * a:
                    return _TAIL + a if u > 0.0 else -(_TAIL + a)
                bits = _mixed(bits + _GOLDEN)
                v = _uniform(bits)
        top, bottom = _DENSITY[layer + np.uint64(1)], _DENSITY[layer]
        if bottom + v * (top - bottom) < math.exp(-0.5 * x * x):
            return x
        bits = _mixed(bits + _GOLDEN)
