"""
Why the simulated drive can be trusted: the proofs that take too long for a test, with figures.

Each proof is a function that makes figures in a folder and returns rows of the table: what was
compared, the result, and the limit it must keep. `docs/validation.md` shows them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mfpcc_experiments.proofs.effects import ALL_ON, COSTED, SETS
from mfpcc_experiments.reporting import COLOURS, STYLE
from mfpcc_experiments.running import Engine, Trace
from pmsm_sim import flux_map
from pmsm_sim.parameters import TABLE as PLANT
from pmsm_sim.plant import Plant, advance
from pmsm_sim.reference import ReferenceDrive, ReferencePlant

# How far the plant may be from an independent integration.
_CURRENT_LIMIT = 1e-6  # (A)
_SPEED_LIMIT = 1e-8  # (rad/s)
# The same where diodes switch by themselves. Measured are up to 1.1e-7 in 20 ms, ten times the
# limit of the simple machines; what adds up to it is not known in detail.
_REALISTIC_SPEED_LIMIT = 1e-6
# A realistic drive is held against it for at least so many periods, and for this part of the time
# of a simple one: there each period takes long.
_FEW_PERIODS, _REALISTIC_PART = 10, 0.1

_PHASES = ("a", "b", "c")
_SHIFT = np.array([0.0, 2.0, 4.0]) * np.pi / 3.0

#: The machines held against the independent integration.
MACHINES: Mapping[str, Mapping[str, Any]] = {
    "SPMSM": {"motor": "seed_750"},
    "IPMSM": {"motor": "ipmsm"},
    "harmonic": {"motor": "seed_750", "machine.emf_5": 0.04, "machine.emf_7": -0.03},
    "saturated": {"motor": "ipmsm", "machine.flux_map": "ipmsm_saturated"},
}


@dataclass(frozen=True)
class Result:
    """
    One row of the table.

    Attributes
    ----------
    what : str
        What was compared.
    value, limit : float
        The largest difference found, and what it must stay below.
    unit : str
    """

    what: str
    value: float
    limit: float
    unit: str

    @property
    def holds(self) -> bool:
        """Whether the limit is kept."""
        return self.value < self.limit


class Bench:
    """A plant driven period by period with given duties, without a controller."""

    def __init__(
        self, values: Mapping[str, Any], *, oversampling: int = 0, i_dq: complex = 0j
    ) -> None:
        self.plant = Plant(
            PLANT.complete({"fault.react": False, **values, "oversampling": oversampling})
        )
        self.plant.st["i_d"], self.plant.st["i_q"] = i_dq.real, i_dq.imag
        self._n = oversampling

    def run(
        self,
        periods: int,
        duty: Callable[[int], NDArray[np.float64]] = lambda _: np.full(3, 0.5),
        *,
        enable: bool = True,
    ) -> Trace:
        """Apply the duties for so many periods."""
        trace = Trace.empty(periods, self._n, "", "")
        st = self.plant.st
        for k in range(periods):
            st["duty"] = duty(int(st["period"][0])).reshape(1, 3)
            st["enable"], st["latched"] = enable, True
            row = slice(k, k + 1)
            advance(
                self.plant.par,
                st,
                trace.feedback[row],
                trace.state[row],
                trace.i_abc[k],
                trace.legs[k],
            )
        return trace


def _closed_loop(values: Mapping[str, Any], **more: Any) -> Engine:
    """A closed loop under `mbpcc` at 750 r/min and 2 N m, for a plant with these parameters."""
    from mfpcc_controller.parameters import TABLE as CONTROLLER

    plant = PLANT.complete({"initial_speed_rpm": 700.0, "load_torque": 2.0, **values, **more})
    controller = CONTROLLER.complete(
        {"scheme": "mbpcc", "speed_ref_rpm": 750.0, "motor": plant["motor"]}
    )
    return Engine(plant, controller)


def _save(figure: Figure, folder: Path, name: str) -> None:
    figure.savefig(folder / f"{name}.png")


def integration(folder: Path, *, duration: float, tick: Callable[[float], None]) -> list[Result]:
    """Closed loop against DOP853 (rtol 1e-11) on independently written equations."""
    results, courses = [], {}
    for name, values in MACHINES.items():
        engine = _closed_loop(values)
        plant = engine.plant
        reference = ReferencePlant(plant, _flux_map(values))
        periods = round(duration / float(plant.par["T_s"][0]))
        off = np.empty((periods, 2))
        for k in range(periods):
            next(engine.run(1))
            i, w_M = reference.period(plant.st["duty"][0])
            st = plant.st[0]
            off[k] = abs(i - complex(st["i_d"], st["i_q"])), abs(w_M - float(st["w_M"]))
            if k % 20 == 0:
                tick(20 / periods / len(MACHINES))
        courses[name] = off
        results += _against_dop853(name, off.max(axis=0), _SPEED_LIMIT)
    _draw_differences(courses, folder, "integration", _SPEED_LIMIT)
    return results


def realistic(folder: Path, *, duration: float, tick: Callable[[float], None]) -> list[Result]:
    """The same for realistic sets of effects (rtol 1e-10), and for what only they have."""
    results, courses = [], {}
    drives = {name: COSTED[name] for name in (*SETS, "everything")}
    for name, values in drives.items():
        engine = _closed_loop(values)
        plant = engine.plant
        reference = ReferenceDrive(plant, _flux_map(values))
        periods = max(_FEW_PERIODS, round(duration / float(plant.par["T_s"][0])))
        off = np.empty((periods, 5))
        for k in range(periods):
            next(engine.run(1))
            y = reference.period(plant.st["duty"][0])
            st = plant.st[0]
            off[k] = (
                abs(complex(y[0], y[1]) - complex(st["i_d"], st["i_q"])),
                abs(y[2] - st["w_M"]),
                abs(y[4] - st["u_dc"]),
                abs(y[5] - st["w_L"]) if plant.par["shaft"][0] else 0.0,
                abs(complex(y[7], y[8]) - complex(*st["i_sampled"])),
            )
            tick(1 / periods / len(drives))
        courses[name] = off
        i, w_M, u_dc, w_L, i_f = off.max(axis=0)
        results += _against_dop853(name, (i, max(w_M, w_L)), _REALISTIC_SPEED_LIMIT)
        if plant.par["rectifier"][0]:
            results.append(Result(f"{name}: DC-link voltage against DOP853", u_dc, 1e-5, "V"))
        if plant.par["filter_rate"][0] > 0.0:
            results.append(Result(f"{name}: sensed current against DOP853", i_f, 1e-5, "A"))
    _draw_differences(courses, folder, "realistic", _REALISTIC_SPEED_LIMIT)
    return results


def _flux_map(values: Mapping[str, Any]) -> flux_map.FluxMap | None:
    chosen = values.get("machine.flux_map")
    return flux_map.load(chosen) if chosen else None


def _against_dop853(
    name: str, off: Sequence[float] | NDArray[np.float64], speed_limit: float
) -> list[Result]:
    return [
        Result(f"{name}: current against DOP853", off[0], _CURRENT_LIMIT, "A"),
        Result(f"{name}: speed against DOP853", off[1], speed_limit, "rad/s"),
    ]


def _draw_differences(
    courses: Mapping[str, NDArray[np.float64]], folder: Path, file_name: str, speed_limit: float
) -> None:
    """Differences of current and speed, the first two columns, from period to period."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 2.6), layout="constrained")
        for k, (axes, limit, what) in enumerate(
            zip(
                figure.subplots(1, 2),
                (_CURRENT_LIMIT, speed_limit),
                ("difference of the current (A)", "difference of the speed (rad/s)"),
                strict=True,
            )
        ):
            for colour, (name, off) in zip(COLOURS, courses.items(), strict=False):
                t = 0.1 * (np.arange(len(off)) + 1)  # all run at 10 kHz
                axes.semilogy(t, np.maximum(off[:, k], 1e-14), color=colour, label=name)
            axes.axhline(limit, color="black", linestyle="--", linewidth=0.8)
            axes.set(xlabel="time (ms)", ylabel=what, ylim=(1e-14, 1e-5))
            place = 0.02, 1.3 * limit
            axes.annotate("limit", place, xycoords=("axes fraction", "data"), fontsize=7)
        figure.axes[0].legend(loc="lower right", ncols=2)
        _save(figure, folder, file_name)


def blocked_gates(folder: Path) -> list[Result]:
    """Free-wheeling through the diodes, until the currents end; and rectifying a high EMF."""
    n = 100
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 2.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        bench = Bench({"initial_speed_rpm": 750.0, "noise.current_rms": 0.0}, oversampling=n)
        duty = _rotating(bench, 12.0)
        on = bench.run(60, duty)
        off = bench.run(12, enable=False)
        i = np.concatenate([on.i_abc, off.i_abc]).reshape(-1, 3)[40 * n :]
        t = 0.1 * (np.arange(len(i)) / n - 20.0)
        for x in range(3):
            left.plot(t, i[:, x], color=COLOURS[x], label=_PHASES[x])
        left.axvline(0.0, color="black", linewidth=0.6, linestyle=":")
        left.set(xlabel="time after the gates are blocked (ms)", ylabel="phase current (A)")
        left.set_title("750 r/min: the currents end")
        left.legend(loc="lower right")
        ended = float(np.abs(off.i_abc[-2:]).max())

        fast = Bench({"initial_speed_rpm": 4000.0}, oversampling=n)
        trace = fast.run(40, enable=False)
        i = trace.i_abc.reshape(-1, 3)
        t = 0.1 * np.arange(len(i)) / n
        for x in range(3):
            right.plot(t, i[:, x], color=COLOURS[x])
        right.set(xlabel="time (ms)", ylabel="phase current (A)")
        right.set_title("4000 r/min: the EMF is rectified")
        _save(figure, folder, "blocked_gates")
    backward = float(np.maximum(trace.state["dc_current"], 0.0).max())
    return [
        Result("blocked gates: current left after it has ended", ended, 1e-12, "A"),
        Result("blocked gates: power out of the supply", backward, 1e-9, "A"),
    ]


def dead_time(folder: Path) -> list[Result]:
    """Mean leg voltage over the current: the textbook's step, and the clamping around zero."""
    t_d, n = 3e-6, 1000
    currents = np.concatenate([np.linspace(-2.0, 2.0, 80), np.linspace(-0.3, 0.3, 60)])
    currents.sort()
    means = np.empty(len(currents))
    for k, current in enumerate(currents):
        bench = Bench({"inverter.dead_time": t_d}, oversampling=n, i_dq=complex(current))
        par = bench.plant.par
        par["J"] = 1e12
        R, L, T_s, u_dc = (float(par[name][0]) for name in ("R_s", "L_d", "T_s", "u_dc"))
        bench.run(1)
        start = float(bench.plant.st["i_d"][0])
        i_a = bench.run(1).i_abc.reshape(n, 3)[:, 0]
        drop = L * (float(bench.plant.st["i_d"][0]) - start) / T_s + R * i_a.mean()
        # legs b and c err the other way, each carrying half: u_a = 4/3 of what one leg errs
        means[k] = 0.75 * drop / u_dc
        currents[k] = i_a.mean()
    step = t_d / T_s
    far = np.abs(currents) > 0.5
    off = np.abs(means[far] + np.sign(currents[far]) * step).max()
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 2.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        left.plot(currents, 100 * means, ".", color=COLOURS[0], markersize=3, label="simulated")
        ideal = -100 * step * np.sign(currents)
        left.plot(
            currents, ideal, color="black", linewidth=0.7, label="$-\\mathrm{sign}(i)\\,t_d/T_s$"
        )
        left.set(xlabel="phase current, mean (A)", ylabel="mean leg voltage - duty (% of $u_{dc}$)")
        left.legend()
        bench = Bench({"inverter.dead_time": 5e-6}, oversampling=n, i_dq=0.03 + 0j)
        bench.plant.par["J"] = 1e12
        trace = bench.run(3, lambda _: np.array([0.5, 0.497, 0.503]))
        i = trace.i_abc.reshape(-1, 3)
        t = 100.0 * np.arange(len(i)) / n
        for x in range(3):
            right.plot(t, 1e3 * i[:, x], color=COLOURS[x], label=_PHASES[x])
        right.set(xlabel="time (us)", ylabel="phase current (mA)")
        right.set_title("clamped to zero within the dead time")
        right.legend(ncols=3)
        _save(figure, folder, "dead_time")
    return [Result("dead time: mean leg voltage, of u_dc", float(off), 1e-4, "1")]


def power_balance(folder: Path) -> list[Result]:
    """Where the energy goes when every effect is on, and what is missing in the balance."""
    bench = Bench({**ALL_ON, "initial_speed_rpm": 800.0, "load_torque": 2.0})
    duty = _rotating(bench, 10.0)
    bench.run(1)
    before = bench.plant.energies()
    bench.run(3000, duty)
    after = bench.plant.energies()
    change = {name: after[name] - before[name] for name in after}
    lost = ("inverter", "copper", "iron", "friction", "chopper", "load")
    stored = ("field", "capacitor", "kinetic", "shaft", "cogging")
    missing = change["supply"] - sum(change[name] for name in (*lost, *stored))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 2.2), layout="constrained")
        axes = figure.subplots()
        names = ["supply", *lost, *stored, "missing"]
        energy = [change["supply"], *(change[n] for n in (*lost, *stored)), missing]
        colours = [COLOURS[0], *[COLOURS[1]] * len(lost), *[COLOURS[2]] * len(stored), "black"]
        bars = axes.barh(names, energy, color=colours)
        axes.bar_label(bars, [f"{e:.3g} J" for e in energy], padding=3, fontsize=7)
        axes.invert_yaxis()
        axes.set(xlabel="energy in 0.3 s (J)")
        axes.margins(x=0.12)
        axes.grid(axis="y", visible=False)
        _save(figure, folder, "power_balance")
    throughput = sum(abs(change[name]) for name in lost)
    return [Result("power balance, all effects on", abs(missing) / throughput, 1e-4, "1")]


def saturation(folder: Path) -> list[Result]:
    """The example flux map: incremental inductances, and the inverse map."""
    map_ = flux_map.load("ipmsm_saturated")
    grid = np.linspace(-30.0, 30.0, 61)
    L = np.array([[map_.inductances(d, q) for q in grid] for d in grid])
    worst = 0.0
    for d in np.linspace(-29.0, 29.0, 13):
        for q in np.linspace(-29.0, 29.0, 13):
            back = map_.current(*map_.flux(d, q))
            worst = max(worst, abs(back[0] - d), abs(back[1] - q))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 2.3), layout="constrained")
        for axes, (j, k), title in zip(
            figure.subplots(1, 3),
            ((0, 0), (1, 1), (0, 1)),
            ("$L_{dd}$", "$L_{qq}$", "$L_{dq}$"),
            strict=True,
        ):
            shown = axes.contourf(grid, grid, 1e3 * L[:, :, j, k].T, 14, cmap="viridis")
            figure.colorbar(shown, ax=axes, shrink=0.9, format="%.3g")
            axes.set(xlabel="$i_d$ (A)", title=f"{title} (mH)")
            axes.grid(visible=False)
        figure.axes[0].set_ylabel("$i_q$ (A)")
        _save(figure, folder, "saturation")
    return [Result("flux map: current after map and inverse map", worst, 1e-8, "A")]


def dc_link(folder: Path) -> list[Result]:
    """Rectifier-fed DC link under load, and braking with and without the chopper."""
    link = {"dc_link.kind": "rectifier", "dc_link.capacitance": 3e-4, "load.kind": "speed"}
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 2.4), layout="constrained")
        left, right = figure.subplots(1, 2)
        bench = Bench({**link, "initial_speed_rpm": 750.0, "load.speed_rpm": 750.0})
        u = bench.run(700, _rotating(bench, 15.0)).state["dc_voltage"]
        left.plot(0.1 * np.arange(300), u[400:], color=COLOURS[0])
        left.set(xlabel="time (ms)", ylabel="$u_{dc}$ (V)", title="motoring: 300 Hz")
        window = u[400:700] - u[400:700].mean()
        frequency = np.fft.rfftfreq(300, 1e-4)[np.abs(np.fft.rfft(window)).argmax()]
        for R, label, colour in ((0.0, "without chopper", COLOURS[1]), (50.0, "with", COLOURS[2])):
            bench = Bench(
                {
                    **link,
                    "initial_speed_rpm": 1500.0,
                    "load.speed_rpm": 1500.0,
                    "dc_link.chopper_resistance": R,
                    "dc_link.chopper_on": 340.0,
                    "dc_link.chopper_off": 330.0,
                }
            )
            u = bench.run(900, _rotating(bench, -40.0)).state["dc_voltage"]
            right.plot(0.1 * np.arange(900), u, color=colour, label=label)
        right.set(xlabel="time (ms)", ylabel="$u_{dc}$ (V)", title="braking")
        right.legend()
        _save(figure, folder, "dc_link")
    return [Result("DC link: ripple away from 300 Hz", abs(float(frequency) - 300.0), 34.0, "Hz")]


def _rotating(bench: Bench, u_more: float) -> Callable[[int], NDArray[np.float64]]:
    """Duties of the back-EMF and `u_more` volts above it, on the rotor's own angle."""

    def duty(_: int) -> NDArray[np.float64]:
        par, st = bench.plant.par[0], bench.plant.st[0]
        w_m = par["n_p"] * st["w_M"]
        u = w_m * par["psi_f"] + u_more
        angle = par["n_p"] * st["theta_M"] + 0.5 * w_m * par["T_s"] + 0.5 * np.pi
        return np.clip(0.5 + u / 311.0 * np.cos(angle - _SHIFT), 0.0, 1.0)

    return duty


def validate(
    folder: Path, *, duration: float = 0.2, tick: Callable[[float], None] = lambda _: None
) -> list[Result]:
    """
    All proofs, with their figures in the folder.

    Parameters
    ----------
    duration : float
        Of the closed loop held against the independent integration (s); a tenth of it for realistic
        drives.
    tick : callable
        Gets the share that is done.
    """
    done = 0.0

    def tell(share: float) -> None:
        nonlocal done
        done += share
        tick(done)

    results = integration(folder, duration=duration, tick=lambda share: tell(0.6 * share))
    part = _REALISTIC_PART * duration
    results += realistic(folder, duration=part, tick=lambda share: tell(0.3 * share))
    for proof in (blocked_gates, dead_time, power_balance, saturation, dc_link):
        results += proof(folder)
        tell(0.02)
    return results
