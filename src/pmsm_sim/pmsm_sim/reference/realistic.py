"""A realistic drive: dead time, diodes, iron loss, saturation, DC link, shaft.

The state is the machine current in the rotor frame, SciPy evaluates the flux map's spline, the
magnets' harmonics are written phase by phase, and DOP853 integrates from one switching instant to
the next.

Which legs conduct is not searched for. Each phase x has one unknown y_x, which falls with the
voltage v_n of the star point; the three of them sum up to zero. The voltage of
leg x is low_x while y_x > 0, high_x while y_x < 0, and lies between them while y_x = 0:

    iron loss: y_x is the current at the terminals,  v_x - r y_x = v_n + R_s y_x + (y_x - i_x) / G
    none:      y_x is the derivative of a current that is zero,  v_x = v_n + emf_x + L y_x

The sum is a broken line in v_n, so its zero is found exactly. Without iron loss the sign of a
current belongs to the state; a change of it ends an integration (an event). There L_d = L_q.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmsm_sim.flux_map import FluxMap
from pmsm_sim.plant import Plant

_ORDERS = (5, 7, 11, 13)
_SHIFT = (0.0, 2.0 * math.pi / 3.0, 4.0 * math.pi / 3.0)  # by which phases a, b, c come later
_AXES = tuple(complex(math.cos(x), math.sin(x)) for x in _SHIFT)
_PLAIN = (
    *("R_s", "L_d", "L_q", "psi_f", "psi_map", "n_p", "J", "B", "T_s", "u_dc", "tau_L"),
    *("R_20", "psi_20", "temperature", "thermal_rate", "copper_coefficient", "magnet_coefficient"),
    *("iron_conductance", "dead_time", "cogging_torque", "cogging_periods"),
    *("switch_voltage", "switch_resistance", "diode_voltage", "diode_resistance"),
    *("capacitance", "grid_peak", "grid_w", "grid_conductance", "filter_rate", "encoder_latency"),
    *("coulomb_friction", "quadratic", "J_load", "shaft_stiffness", "shaft_damping"),
)
# A current below this has ended (A).
_ENDED = 1e-9


def _space_vector(x: Sequence[float]) -> complex:
    return 2.0 / 3.0 * (x[0] * _AXES[0] + x[1] * _AXES[1] + x[2] * _AXES[2])


def _phase(x: complex, k: int) -> float:
    return x.real * _AXES[k].real + x.imag * _AXES[k].imag


def _balance(
    low: Sequence[float], high: Sequence[float], for_p: Sequence[float], for_n: Sequence[float]
) -> list[float]:
    """The three y_x that sum up to zero.

    y_x = for_p_x (low_x - v_n) where that is positive, for_n_x (high_x - v_n) where that is
    negative, and 0 otherwise.
    """

    def at(v_n: float) -> list[float]:
        return [
            for_p[k] * max(low[k] - v_n, 0.0) + for_n[k] * min(high[k] - v_n, 0.0) for k in range(3)
        ]

    corners = sorted((*low, *high))
    below, above = corners[0], corners[-1]  # there the sum is >= 0, and <= 0
    for v_n in corners:
        rest = sum(at(v_n))
        if rest >= 0.0:
            below = v_n
        else:
            above = v_n
            break
    a, b = sum(at(below)), sum(at(above))
    return at(below + (above - below) * a / (a - b) if a > b else below)


class ReferenceDrive:
    """
    An independent integration of a drive with many effects.

    Parameters
    ----------
    plant : Plant
        Gives parameters and the state to start with, at period 0.
    flux_map : FluxMap, optional
        Of a saturated machine.
    rtol, atol : float
        Tolerances of DOP853.

    Raises
    ------
    ValueError
        For a salient machine without iron loss; when a current leaves the flux map.

    Attributes
    ----------
    y : array
        i_d, i_q (A), w_M (rad/s), theta_M (rad), u_dc (V), w_L (rad/s), twist of the shaft (rad),
        and what the current sensors show, alpha and beta (A).
    theta_seen : float
        Rotor angle (rad) that the encoder's latency leaves for the next sample.
    """

    def __init__(
        self,
        plant: Plant,
        flux_map: FluxMap | None = None,
        *,
        rtol: float = 1e-10,
        atol: float = 1e-12,
    ) -> None:
        par, st = plant.par[0], plant.st[0]
        self.par = {name: float(par[name]) for name in _PLAIN}
        self.psi_h = [float(x) for x in par["psi_h"]]
        self.rectifier, self.shaft = bool(par["rectifier"]), bool(par["shaft"])
        self.drifts = bool(par["drifts"])
        if self.par["iron_conductance"] == 0.0 and self.par["L_d"] != self.par["L_q"]:
            raise ValueError("without iron loss only for a machine with L_d = L_q")
        self.spline = None if flux_map is None else _spline(flux_map)
        self._tolerances = {"rtol": rtol, "atol": atol}
        self.time = 0.0
        i, w_M, theta_M = complex(st["i_d"], st["i_q"]), float(st["w_M"]), float(st["theta_M"])
        i_ab = i * np.exp(1j * self.par["n_p"] * theta_M)
        self.y = np.array(
            [i.real, i.imag, w_M, theta_M, self.par["u_dc"], w_M, 0.0, i_ab.real, i_ab.imag]
        )
        self.theta_seen = theta_M
        # when each leg was told last to change, and to what
        self._told: list[tuple[float, int]] = []
        self._signs = [0, 0, 0]

    def period(self, duty: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
        """One PWM period with these duties; returns the state at its end."""
        T_s, start = self.par["T_s"], self.time
        if self.drifts:
            self._warm(start + T_s)
        told = [self._commands(k, float(duty[k])) for k in range(3)]
        limits = {0.0, T_s, T_s - self.par["encoder_latency"]}
        for edges in told:
            for t, _ in edges:
                limits |= {t, t + self.par["dead_time"]}
        for a, b in pairwise(sorted(t for t in limits if 0.0 <= t <= T_s)):
            middle = 0.5 * (a + b)
            legs = [self._gates(edges, middle) for edges in told]
            self._integrate(legs, start, a, b)
            if b == T_s - self.par["encoder_latency"]:
                self.theta_seen = float(self.y[3])
        self._told = [(edges[-1][0] - T_s, edges[-1][1]) for edges in told]
        self.time = start + T_s
        return self.y

    # -- inverter --------------------------------------------------------------------------------

    def _commands(self, k: int, d: float) -> list[tuple[float, int]]:
        """When leg k is told to change (s), and to what (1 high, 0 low); also the last time."""
        half = 0.5 * self.par["T_s"]
        first = 1 if d == 1.0 else 0
        edges = [self._told[k]] if self._told else [(-1.0, first)]
        if edges[0][1] != first:
            edges.append((0.0, first))
        if 0.0 < d < 1.0:
            edges += [(half * (1.0 - d), 1), (half * (1.0 + d), 0)]
        return edges

    def _gates(self, edges: list[tuple[float, int]], t: float) -> tuple[bool, bool]:
        """Whether upper and lower switch of a leg are on."""
        since, level = max(edge for edge in edges if edge[0] < t)
        on = t - since > self.par["dead_time"]
        return on and level == 1, on and level == 0

    def _clamps(
        self, legs: list[tuple[bool, bool]], u_dc: float
    ) -> tuple[list[float], list[float], list[float], list[float]]:
        """Of each leg: low, high (V), and the resistances for positive and negative current."""
        p = self.par
        low, high, r_p, r_n = [], [], [], []
        for upper, lower in legs:
            low.append(u_dc - p["switch_voltage"] if upper else -p["diode_voltage"])
            high.append(p["switch_voltage"] if lower else u_dc + p["diode_voltage"])
            r_p.append(p["switch_resistance"] if upper else p["diode_resistance"])
            r_n.append(p["switch_resistance"] if lower else p["diode_resistance"])
        return low, high, r_p, r_n

    # -- machine ---------------------------------------------------------------------------------

    def _warm(self, t: float) -> None:
        """Temperature without self-heating; the plant holds it for a period."""
        p = self.par
        T = p["temperature"] + (20.0 - p["temperature"]) * math.exp(-p["thermal_rate"] * t)
        p["R_s"] = p["R_20"] * (1.0 + p["copper_coefficient"] * (T - 20.0))
        p["psi_f"] = p["psi_20"] * (1.0 + p["magnet_coefficient"] * (T - 20.0))

    def _map(self, i: complex) -> tuple[complex, float, float, float]:
        """Flux linkage psi_d + j psi_q (V s), and L_dd, L_dq, L_qq (H)."""
        p = self.par
        if self.spline is None:
            return (
                complex(p["psi_f"] + p["L_d"] * i.real, p["L_q"] * i.imag),
                p["L_d"],
                0.0,
                p["L_q"],
            )
        psi_d, psi_q, L_dd, L_dq, L_qq = self.spline(i.real, i.imag)
        return complex(psi_d + p["psi_f"] - p["psi_map"], psi_q), L_dd, L_dq, L_qq

    def _harmonics(self, theta_m: float) -> list[float]:
        """Derivative of each phase's harmonic flux linkage with the angle (V s/rad)."""
        harmonics = list(zip(_ORDERS, self.psi_h, strict=True))
        return [
            -sum(n * psi * math.sin(n * (theta_m - shift)) for n, psi in harmonics)
            for shift in _SHIFT
        ]

    def _seen(self, y: NDArray[np.float64]) -> tuple[complex, complex, list[float], complex]:
        """Of a state: exp(j theta_m); current (A); slopes of the harmonics; EMF of magnets (V).

        In the stationary frame.
        """
        p = self.par
        theta_m = p["n_p"] * y[3]
        turn = complex(math.cos(theta_m), math.sin(theta_m))
        slopes = self._harmonics(theta_m)
        emf = p["n_p"] * y[2] * (1j * turn * p["psi_f"] + _space_vector(slopes))
        return turn, turn * complex(y[0], y[1]), slopes, emf

    # -- together --------------------------------------------------------------------------------

    def _derivative(
        self, t: float, y: NDArray[np.float64], legs: list[tuple[bool, bool]], signs: list[int]
    ) -> list[float]:
        p = self.par
        i_d, i_q, w_M, theta_M, u_dc, w_L, twist, f_a, f_b = y
        n_p, R, G = p["n_p"], p["R_s"], p["iron_conductance"]
        w_m, i = n_p * w_M, complex(i_d, i_q)
        turn, i_ab, slopes, emf = self._seen(y)
        psi, L_dd, L_dq, L_qq = self._map(i)
        if G > 0.0:
            i_x, e = self._with_iron(legs, u_dc, i_ab)
            i_s = _space_vector(i_x)
        else:
            i_s = i_ab
            i_x = [_phase(i_ab, k) for k in range(3)]
            v, _ = self._without_iron(legs, u_dc, i_x, emf, signs)
            e = _space_vector(v) - R * i_ab
        # e = turn (L di + j w_m psi) + w_m dpsi_h/dtheta_m
        rest = (e - w_m * _space_vector(slopes)) / turn - 1j * w_m * psi
        determinant = L_dd * L_qq - L_dq * L_dq
        di_d = (L_qq * rest.real - L_dq * rest.imag) / determinant
        di_q = (L_dd * rest.imag - L_dq * rest.real) / determinant

        tau = 1.5 * n_p * (psi.conjugate() * i).imag
        tau += n_p * sum(_phase(i_ab, k) * slopes[k] for k in range(3))
        tau -= p["cogging_torque"] * math.sin(p["cogging_periods"] * theta_M)
        friction = p["B"] * w_M + p["coulomb_friction"] * w_M / math.hypot(w_M, 0.1)
        if self.shaft:
            tau_shaft = p["shaft_stiffness"] * twist + p["shaft_damping"] * (w_M - w_L)
            load = p["tau_L"] + p["quadratic"] * w_L * abs(w_L)
            dw_M = (tau - friction - tau_shaft) / p["J"]
            dw_L, dtwist = (tau_shaft - load) / p["J_load"], w_M - w_L
        else:
            load = p["tau_L"] + p["quadratic"] * w_M * abs(w_M)
            dw_M, dw_L, dtwist = (tau - friction - load) / p["J"], 0.0, 0.0

        du = 0.0
        if self.rectifier:
            grid = max(math.cos(p["grid_w"] * t - (k + 0.5) * math.pi / 3.0) for k in range(6))
            i_grid = max(0.0, (p["grid_peak"] * grid - u_dc) * p["grid_conductance"])
            i_dc = 0.0
            for k, (upper, lower) in enumerate(legs):
                # the upper switch carries either direction; with both off, the upper diode
                if upper or (not lower and i_x[k] < 0.0):
                    i_dc += i_x[k]
            du = (i_grid - i_dc) / p["capacitance"]
        df_a = p["filter_rate"] * (i_s.real - f_a)
        df_b = p["filter_rate"] * (i_s.imag - f_b)
        return [di_d, di_q, dw_M, w_M, du, dw_L, dtwist, df_a, df_b]

    def _with_iron(
        self, legs: list[tuple[bool, bool]], u_dc: float, i_ab: complex
    ) -> tuple[list[float], complex]:
        """Currents at the terminals (A), and the induced voltage (V)."""
        low, high, r_p, r_n = self._clamps(legs, u_dc)
        R_iron = 1.0 / self.par["iron_conductance"]
        K = self.par["R_s"] + R_iron
        own = [R_iron * _phase(i_ab, k) for k in range(3)]
        i_x = _balance(
            [low[k] + own[k] for k in range(3)],
            [high[k] + own[k] for k in range(3)],
            [1.0 / (K + r) for r in r_p],
            [1.0 / (K + r) for r in r_n],
        )
        return i_x, R_iron * (_space_vector(i_x) - i_ab)

    def _without_iron(
        self,
        legs: list[tuple[bool, bool]],
        u_dc: float,
        i_x: list[float],
        magnets: complex,
        signs: list[int],
    ) -> tuple[list[float], list[float]]:
        """Terminal voltages (V) for these signs of the currents; and how far the signs hold.

        The latter: i sign of legs with current (A), the distance from the nearest limit of those
        without (V); one value for all if none conducts.
        """
        low, high, r_p, r_n = self._clamps(legs, u_dc)
        emf = [_phase(magnets, k) for k in range(3)]
        v, hold = [0.0] * 3, [0.0] * 3
        for k in range(3):
            if signs[k] > 0:
                v[k] = low[k] - r_p[k] * i_x[k]
            elif signs[k] < 0:
                v[k] = high[k] - r_n[k] * i_x[k]
        flowing = [k for k in range(3) if signs[k] != 0]
        if not flowing:
            first = max(low[k] - emf[k] for k in range(3))
            last = min(high[k] - emf[k] for k in range(3))
            return emf, [last - first] * 3
        R = self.par["R_s"]
        v_n = sum(v[k] - R * i_x[k] - emf[k] for k in flowing) / len(flowing)
        for k in range(3):
            if signs[k] == 0:
                v[k] = v_n + emf[k]
                hold[k] = min(v[k] - low[k], high[k] - v[k])
            else:
                hold[k] = signs[k] * i_x[k]
        return v, hold

    def _find_signs(
        self, legs: list[tuple[bool, bool]], y: NDArray[np.float64], ended: int | None
    ) -> list[int]:
        """Signs of the currents after a switching instant, or after that of leg `ended` is over."""
        _, i_ab, _, magnets = self._seen(y)
        low, high, r_p, r_n = self._clamps(legs, float(y[4]))
        signs = [0, 0, 0]
        for k in range(3):
            i = _phase(i_ab, k)
            emf = _phase(magnets, k) + self.par["R_s"] * i
            if k != ended and abs(i) > _ENDED:
                signs[k] = 1 if i > 0.0 else -1
                low[k] = high[k] = (low[k] - r_p[k] * i if i > 0.0 else high[k] - r_n[k] * i) - emf
            else:
                low[k], high[k] = low[k] - emf, high[k] - emf
        ones = [1.0, 1.0, 1.0]
        rates = _balance(low, high, ones, ones)
        return [
            s or (0 if y_x == 0.0 else 1 if y_x > 0.0 else -1)
            for s, y_x in zip(signs, rates, strict=True)
        ]

    def _integrate(self, legs: list[tuple[bool, bool]], start: float, a: float, b: float) -> None:
        """From a to b (s after the period's start), between which no switch changes."""
        from scipy.integrate import solve_ivp

        ironless = self.par["iron_conductance"] == 0.0
        signs = self._find_signs(legs, self.y, None) if ironless else [0, 0, 0]
        t = start + a
        while True:
            events = [self._hold(legs, signs, k) for k in range(3)] if ironless else None
            answer = solve_ivp(
                self._derivative,
                (t, start + b),
                self.y,
                method="DOP853",
                args=(legs, signs),
                first_step=start + b - t,
                events=events,
                **self._tolerances,
            )
            if answer.status < 0:
                raise RuntimeError(answer.message)
            self.y, t = answer.y[:, -1], float(answer.t[-1])
            if answer.status == 0:
                return
            ended = next(k for k in range(3) if len(answer.t_events[k]))
            signs = self._after(legs, signs, ended)

    def _hold(self, legs: list[tuple[bool, bool]], signs: list[int], k: int) -> Callable[..., Any]:
        """Event: the sign of leg k holds no longer."""

        def hold(t: float, y: NDArray[np.float64], *_: Any) -> float:
            i_ab, emf = self._seen(y)[1::2]
            i_x = [_phase(i_ab, j) for j in range(3)]
            return self._without_iron(legs, y[4], i_x, emf, signs)[1][k]

        hold.terminal, hold.direction = True, -1  # type: ignore[attr-defined]
        return hold

    def _after(self, legs: list[tuple[bool, bool]], signs: list[int], k: int) -> list[int]:
        """Signs after that of leg k has ended."""
        if signs[k] != 0:
            return self._find_signs(legs, self.y, k)
        _, i_ab, _, emf = self._seen(self.y)
        low, high, _, _ = self._clamps(legs, float(self.y[4]))
        i_x = [_phase(i_ab, j) for j in range(3)]
        v, _ = self._without_iron(legs, float(self.y[4]), i_x, emf, signs)
        signs = list(signs)
        if any(signs):
            signs[k] = 1 if v[k] - low[k] < high[k] - v[k] else -1
        else:  # a pair begins
            signs[max(range(3), key=lambda j: low[j] - v[j])] = 1
            signs[min(range(3), key=lambda j: high[j] - v[j])] = -1
        return signs


def _spline(flux_map: FluxMap) -> Callable[[float, float], tuple[float, ...]]:
    """The co-energy's derivatives by SciPy: psi_d, psi_q (V s), L_dd, L_dq, L_qq (H)."""
    from scipy.interpolate import bisplev

    map_ = flux_map.map_[0]
    n_d, n_q = (int(n) for n in map_["cells"])
    knots = [
        float(start) + np.arange(-5, n + 6) / float(rate)
        for start, rate, n in zip(map_["start"], map_["rate"], (n_d, n_q), strict=True)
    ]
    tck = (*knots, map_["spline"][: n_d + 5, : n_q + 5].ravel(), 5, 5)
    ends = [(axis[5], axis[-6]) for axis in knots]

    def derivatives(i_d: float, i_q: float) -> tuple[float, ...]:
        for i, (first, last) in zip((i_d, i_q), ends, strict=True):
            if not first <= i <= last:
                raise ValueError(f"a current of {i:g} A is beyond the flux map")
        orders = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
        return tuple(float(bisplev(i_d, i_q, tck, dx, dy)) for dx, dy in orders)

    return derivatives
