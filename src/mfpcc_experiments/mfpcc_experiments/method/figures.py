"""The figures of docs/method.md."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mfpcc_controller.parameters import SCHEMES
from mfpcc_experiments.measuring import scheme_title
from mfpcc_experiments.method.drives import ENCODER, LOAD_STEP, MISMATCH, wrong_model
from mfpcc_experiments.method.fronts import points
from mfpcc_experiments.reporting import COLOURS, REFERENCE
from mfpcc_experiments.running.closed_loop import Run, run
from pwm_node.units import RPM


def _time(r: Run) -> Any:
    return np.arange(len(r.lut)) * r.T_s


def _panels(n: int, title: str, height: float = 1.25) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(6.6, 0.55 + height * n), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(n, 1, sharex=True)))
    axes[0].set_title(title, loc="left")
    return figure, axes


def _currents(axes: Axes, r: Run, rows: slice | None = None) -> None:
    rows = rows or slice(None)
    time = 1e3 * _time(r)[rows]
    for axis, name in enumerate("dq"):
        axes.plot(time, r.lut["i_dq"][rows, axis], color=COLOURS[axis], label=f"$i_{name}$")
    axes.plot(time, r.lut["i_dq_ref"][rows, 1], color=REFERENCE, lw=0.6, ls="--", label="reference")
    axes.set_ylabel("A")


def _entries(axes: Axes, r: Run, rows: slice) -> None:
    for j in range(1, 7):
        size = np.hypot(r.lut["gradient_re"][rows, j], r.lut["gradient_im"][rows, j])
        axes.plot(1e3 * _time(r)[rows], size, color=COLOURS[j - 1], lw=0.6)
    axes.set_ylabel("$|g_1| .. |g_6|$ (A)")
    axes.set_ylim(bottom=0.0)


def figure_learning() -> Figure:
    """The forced entries of a salient machine from wrong first tables."""
    figure, axes = _panels(2, "ipmsm, 750 r/min, 2 N m: the map, from tables that are wrong by far")
    for gain, colour in zip((0.1, 0.5, 3.0, 30.0, None), COLOURS, strict=False):
        settings = {"mls.start": "empty"} if gain is None else wrong_model(1.0 / gain, 1.0, 1.0)
        r = run("mls_mfpcc", 0.5, motor="ipmsm", plant=ENCODER, controller=settings)
        est = r.controller.motor
        theta = est.n_p * r.feedback["encoder_angle"] + 0.5 * r.T_s * r.lut["w_m"]
        g = r.lut["gradient_re"] + 1j * r.lut["gradient_im"]
        # M(u) = A u + B conj(u) in the stationary frame; B turns with the rotor
        third = np.exp(1j * np.pi / 3.0)
        length = 2.0 / 3.0 * r.feedback["dc_voltage"]
        B = (g[:, 1] * third - g[:, 2]) / (1j * np.sqrt(3.0)) / length
        A = g[:, 1] / length - B
        B = B * np.exp(-2j * theta)
        label = "empty: measured" if gain is None else f"{gain:g} times the mean"
        axes[0].semilogy(1e3 * _time(r), (A + B).real * est.L_d / r.T_s, color=colour, label=label)
        axes[1].semilogy(1e3 * _time(r), (A - B).real * est.L_q / r.T_s, color=colour)
    for axis, name in zip(axes, "dq", strict=False):
        axis.axhline(1.0, color=REFERENCE, lw=0.6, ls="--")
        axis.set_ylabel(f"{name} axis, over the truth")
        axis.set_ylim(0.03, 50.0)
    axes[0].legend(ncols=3, loc="upper right")
    axes[-1].set_xlabel("time (ms)")
    return figure


def figure_reversal() -> Figure:
    """Reversal at the current limit, with the table's entries."""
    figure, axes = _panels(4, "seed_750, 2 N m: reversal from -750 to 750 r/min")
    r = run("mls_mfpcc", 0.45, rpm=-750.0, plant=ENCODER, schedule=["0.2 speed_ref_rpm 750.0"])
    rows = slice(1800, None)
    time = 1e3 * _time(r)[rows]
    axes[0].plot(time, r.state["speed"][rows] / RPM, color=COLOURS[0])
    axes[0].set_ylabel("r/min")
    _currents(axes[1], r, rows)
    axes[1].legend(ncols=3, loc="lower right")
    for axis, name in enumerate("dq"):
        axes[2].plot(
            time, r.lut["prediction_error"][rows, axis], color=COLOURS[axis], label=f"$e_{name}$"
        )
    axes[2].set_ylabel("error (A)")
    _entries(axes[3], r, rows)
    axes[-1].set_xlabel("time (ms)")
    return figure


def figure_standstill() -> Figure:
    """A blocked rotor from no torque to all of it, and back."""
    figure, axes = _panels(3, "seed_750, rotor blocked: all the torque, and none again")
    r = run(
        "mls_mfpcc",
        0.3,
        rpm=0.0,
        plant={**ENCODER, "load.kind": "speed", "load.speed_rpm": 0.0},
        controller={"control_mode": "current", "i_q_ref": 0.0},
        schedule=["0.1 i_q_ref 11.9", "0.2 i_q_ref 0.0"],
    )
    rows = slice(800, 2400)
    time = 1e3 * _time(r)[rows]
    _currents(axes[0], r, rows)
    axes[0].legend(ncols=3, loc="center")
    for axis in range(2):
        axes[1].plot(time, r.lut["prediction_error"][rows, axis], color=COLOURS[axis])
    axes[1].set_ylabel("error (A)")
    _entries(axes[2], r, rows)
    axes[-1].set_xlabel("time (ms)")
    return figure


def figure_mismatch() -> Figure:
    """Load step with three wrong models."""
    schemes = ("mbpcc", "neso_mfpcc", "pi_foc", "mls_mfpcc")
    figure = Figure(figsize=(6.6, 4.6), layout="constrained")
    grid = figure.subplots(len(schemes), len(MISMATCH), sharex=True, sharey=True)
    for row, scheme in zip(grid, schemes, strict=False):
        for axes, (case, ratios) in zip(row, MISMATCH.items(), strict=False):
            r = run(scheme, 0.3, plant=ENCODER, controller=wrong_model(*ratios), schedule=LOAD_STEP)
            _currents(axes, r, slice(1800, None))
            axes.set_ylabel("")
            if scheme == schemes[0]:
                axes.set_title(f"{case}: L x {ratios[0]}, R x {ratios[1]}, psi x {ratios[2]}")
        row[0].set_ylabel(f"{scheme_title(scheme)}\nA")
    grid[0][0].set_ylim(-3.0, 8.0)
    grid[0][0].legend(ncols=3, loc="upper left", fontsize=6.0)
    for axes in grid[-1]:
        axes.set_xlabel("time (ms)")
    return figure


def figure_switching() -> Figure:
    """All schemes one after another in one run."""
    figure, axes = _panels(
        2, "seed_750, 750 r/min, 2 N m: every scheme in turn, switched live", 1.5
    )
    dwell = 0.03
    schedule = [f"{0.1 + dwell * n} scheme {name}" for n, name in enumerate(SCHEMES[1:], 1)]
    r = run("mls_mfpcc", 0.1 + dwell * len(SCHEMES), plant=ENCODER, schedule=schedule)
    rows = slice(1000, None)
    _currents(axes[0], r, rows)
    axes[0].legend(ncols=3, loc="lower right")
    for name, colour in zip(("i_a", "i_b", "i_c"), COLOURS, strict=False):
        axes[1].plot(1e3 * _time(r)[rows], r.feedback[name][rows], color=colour)
    axes[1].set_ylabel("phases (A)")
    for n, name in enumerate(SCHEMES):
        begin = 1e3 * (0.1 + dwell * n)
        for axis in axes:
            axis.axvline(begin, color="#999999", lw=0.5)
        axes[0].text(
            begin + 0.5e3 * dwell,
            1.02,
            name.replace("_", "\n", 1),
            transform=axes[0].get_xaxis_transform(),
            ha="center",
            va="bottom",
            fontsize=6.0,
        )
    axes[0].set_title(axes[0].get_title(loc="left"), loc="left", pad=24.0)
    axes[-1].set_xlabel("time (ms)")
    return figure


def figure_inverter() -> Figure:
    """Dead time, with a true model that does not know of it, and learned."""
    figure, axes = _panels(3, "seed_750, 100 r/min, 2 N m, dead time 2 us")
    options: dict[str, Any] = {
        "rpm": 100.0,
        "plant": {**ENCODER, "inverter.dead_time": 2e-6},
        "oversampling": 4,
    }
    for axis, scheme, colour in zip(axes, ("mbpcc", "mls_mfpcc"), COLOURS, strict=False):
        name = scheme_title(scheme)
        r = run(scheme, 0.8, **options)
        rows = slice(6000, None)
        for phase in range(3):
            axis.plot(1e3 * _time(r)[rows], r.i_abc[rows, 0, phase], color=COLOURS[phase], lw=0.7)
        axis.set_ylabel(f"{name}\nphases (A)")
        axes[2].plot(
            1e3 * _time(r)[rows],
            _smoothed(r.lut["i_dq"][:, 0])[rows],
            color=colour,
            label=name,
        )
    axes[2].set_ylabel("$i_d$, mean\nof 2 ms (A)")
    axes[2].legend(ncols=2, loc="upper right")
    axes[-1].set_xlabel("time (ms)")
    return figure


def _smoothed(x: Any, n: int = 20) -> Any:
    return np.convolve(x, np.ones(n) / n, mode="same")


def figure_overmodulation() -> Figure:
    """Voltage that is asked for beyond the linear range, as it goes round the hexagon."""
    figure = Figure(figsize=(6.6, 3.1), layout="constrained")
    corners = 2.0 / 3.0 * np.exp(1j * np.pi / 3.0 * np.arange(7))
    for axes, rule in zip(figure.subplots(1, 2, sharey=True), ("scale", "project"), strict=False):
        r = run(
            "mls_mfpcc",
            0.3,
            motor="textbook_spmsm",
            rpm=2700.0,
            plant={**ENCODER, "load.kind": "speed", "load.speed_rpm": 2700.0},
            controller={
                "control_mode": "current",
                "i_q_ref": 8.0,
                "overmodulation": rule,
                "fault.overspeed": 10.0,
            },
        )
        duty = r.command["duty"][2000:]
        u = 2.0 / 3.0 * (duty @ np.exp(2j * np.pi / 3.0 * np.arange(3)))
        theta = r.controller.motor.n_p * r.state["angle"][2000:]
        fundamental = abs(np.mean(u[:-1] * np.exp(-1j * theta[1:])))
        axes.plot(corners.real, corners.imag, color=REFERENCE, lw=0.6)
        axes.plot(u.real, u.imag, ".", color=COLOURS[0], ms=2.0, alpha=0.3)
        axes.set_aspect("equal")
        axes.set_title(f"{rule}: fundamental {fundamental:.3f} $u_{{dc}}$ (six-step: 0.637)")
        axes.set_xlabel("$u_\\alpha / u_{dc}$")
    figure.axes[0].set_ylabel("$u_\\beta / u_{dc}$")
    return figure


def figure_weakening() -> Figure:
    """Run-up of the salient machine beyond its base speed."""
    figure, axes = _panels(3, "ipmsm, 1 N m: run-up to 4500 r/min, torque per ampere and weakening")
    r = run(
        "mls_mfpcc",
        0.9,
        motor="ipmsm",
        rpm=200.0,
        load=1.0,
        plant=ENCODER,
        controller={"field_weakening": True, "mtpa": True, "fault.overspeed": 10.0},
        schedule=["0.1 speed_ref_rpm 4500.0"],
    )
    time = 1e3 * _time(r)
    axes[0].plot(time, r.state["speed"] / RPM, color=COLOURS[0])
    axes[0].set_ylabel("r/min")
    for axis, name in enumerate("dq"):
        axes[1].plot(time, r.lut["i_dq"][:, axis], color=COLOURS[axis], label=f"$i_{name}$")
    axes[1].plot(time, np.hypot(*r.lut["i_dq"].T), color=COLOURS[2], label="amplitude")
    axes[1].axhline(r.controller.motor.i_max, color=REFERENCE, lw=0.6, ls="--")
    axes[1].set_ylabel("A")
    axes[1].set_ylim(bottom=-30.0)
    axes[1].legend(ncols=3, loc="lower right")
    duty = r.command["duty"]
    u = np.abs(2.0 / 3.0 * (duty @ np.exp(2j * np.pi / 3.0 * np.arange(3))))
    axes[2].plot(time, u, color=COLOURS[0], lw=0.4)
    axes[2].axhline(1.0 / np.sqrt(3.0), color=REFERENCE, lw=0.6, ls="--")
    axes[2].set_ylabel("$|u| / u_{dc}$")
    axes[-1].set_xlabel("time (ms)")
    return figure


def figure_fronts() -> Figure:
    """Speed of response against distortion, and against survival."""
    figure = Figure(figsize=(6.6, 3.4), layout="constrained")
    thd, survived = figure.subplots(1, 2, sharex=True)
    for scheme, colour, marker in zip(SCHEMES, COLOURS * 2, "os^vD<>PX*", strict=False):
        line = [p for p in points() if p.scheme == scheme and np.isfinite(p.periods)]
        if not line:
            continue
        look: dict[str, Any] = {"color": colour, "marker": marker, "lw": 0.8}
        periods = [p.periods for p in line]
        thd.plot(periods, [100.0 * p.thd for p in line], ms=3.0, label=scheme, **look)
        survived.plot(periods, [100.0 * p.survived[0] for p in line], ms=3.0, **look)
        own = [p for p in line if p.own]
        thd.plot([p.periods for p in own], [100.0 * p.thd for p in own], ms=7.0, **look)
        shares = [100.0 * p.survived[0] for p in own]
        survived.plot([p.periods for p in own], shares, ms=7.0, **look)
    for axes in (thd, survived):
        axes.set_xscale("log")
        axes.set_xticks([6, 10, 20, 40], ["6", "10", "20", "40"])
        axes.minorticks_off()
        axes.set_xlabel("step within 0.2 A (periods)")
    thd.set_ylabel("THD (%), 750 r/min, 2 N m")
    survived.set_ylabel("wrong models that settle (%)")
    thd.legend(fontsize=6.5)
    return figure


def figure_steps() -> Figure:
    """Steps of the current reference at constant speed."""
    figure = Figure(figsize=(6.6, 2.4), layout="constrained")
    cases = (("seed_750", "q", 1.0, 1.8), ("ipmsm", "q", 2.0, 5.0), ("ipmsm", "d", 0.0, -5.0))
    for axes, (motor, axis, before, after) in zip(figure.subplots(1, 3), cases, strict=False):
        for scheme, colour in zip(("mls_mfpcc", "mbpcc", "pi_foc"), COLOURS, strict=False):
            r = run(
                scheme,
                0.33,
                motor=motor,
                plant={**ENCODER, "load.kind": "speed", "load.speed_rpm": 750.0},
                controller={"control_mode": "current", f"i_{axis}_ref": before},
                schedule=[f"0.3 i_{axis}_ref {after}"],
            )
            i = r.state["i_dq"][2998:3016, "dq".index(axis)]
            axes.plot(np.arange(-2, 16), i, ".-", ms=3.0, color=colour, label=scheme_title(scheme))
        axes.step([-2, 0, 15], [before, after, after], where="post", color=REFERENCE, lw=0.6)
        axes.set_title(f"{motor}, 750 r/min")
        axes.set_xlabel("periods")
        axes.set_ylabel(f"$i_{axis}$ (A)")
    figure.axes[0].legend(loc="lower right", fontsize=6.5)
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "learning": figure_learning,
    "fronts": figure_fronts,
    "steps": figure_steps,
    "standstill": figure_standstill,
    "reversal": figure_reversal,
    "mismatch": figure_mismatch,
    "switching": figure_switching,
    "inverter": figure_inverter,
    "overmodulation": figure_overmodulation,
    "weakening": figure_weakening,
}
