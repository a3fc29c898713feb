"""
The tables and figures of docs/method.md, made anew: ``python -m mfpcc_experiments.method_figures``.

Each table stands in the page between ``<!-- NAME -->`` and ``<!-- end -->`` and is written there;
the figures go into the folder ``images`` beside the page. Motor `seed_750`, noise of 20 mA on i_d
and i_q and an encoder of 2500 lines with quadrature, unless a table says otherwise.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mfpcc_controller.controller import Controller
from mfpcc_controller.parameters import SCHEMES
from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.measuring.happened import scheme_title
from mfpcc_experiments.reporting.style import COLOURS, REFERENCE, STYLE
from mfpcc_experiments.running.closed_loop import Array, Run, run
from mfpcc_experiments.running.engine import step_time

ENCODER = {"sensor.encoder_lines": 2500}
LOAD_STEP = ("0.2 load_torque 5.0",)
MISMATCH = {"a": (0.5, 0.1, 2.0), "b": (2.0, 10.0, 0.7), "c": (2.0, 1.0, 2.0)}
DRAWS = 1000
DIRTY_DRAWS = 120

Rows = list[list[str]]


def wrong_model(inductance: float, resistance: float, flux: float) -> dict[str, float]:
    """Controller parameters of a model that is wrong by these ratios."""
    return {
        "mismatch.inductance": inductance,
        "mismatch.resistance": resistance,
        "mismatch.flux": flux,
    }


def random_drive(seed: int) -> dict[str, Any]:
    """Options of `run` for a drive with a wrong model, at any speed, with a load step.

    Model over actual: L 0.2 to 5, R 0 to 10, psi_f 0 to 3; 0 to 1200 r/min in both directions; the
    load brakes with 0 to 5 N m.
    """
    random = np.random.default_rng(seed)
    ratios = (random.uniform(0.2, 5.0), random.uniform(0.0, 10.0), random.uniform(0.0, 3.0))
    rpm = random.uniform(-1200.0, 1200.0)
    before, after = np.copysign(random.uniform(0.0, 5.0, 2), rpm)
    return {
        "rpm": float(rpm),
        "load": float(before),
        "seed": seed,
        "plant": ENCODER,
        "controller": wrong_model(*map(float, ratios)),
        "schedule": [f"0.1 load_torque {float(after)}"],
    }


def dirty_drive(seed: int) -> dict[str, Any]:
    """Options of `run` for a random drive none of whose parts is ideal.

    Besides what `random_drive` draws: encoder of 500 to 5000 lines; sensors of 1 to 5 kHz, or that
    sample up to half a period early; dead time to 3 us; fifth harmonic of the EMF to 6 %; noise of
    1 to 63 mA.
    """
    options = random_drive(seed)
    random = np.random.default_rng([seed, 1])
    plant: dict[str, Any] = {
        "sensor.encoder_lines": int(random.integers(500, 5001)),
        "inverter.dead_time": float(random.uniform(0.0, 3e-6)),
        "machine.emf_5": float(random.uniform(0.0, 0.06)),
        "noise.current_rms": float(10.0 ** random.uniform(-3.0, -1.2)),
    }
    if random.random() < 0.5:
        plant["sensor.current_bandwidth"] = float(random.uniform(1e3, 5e3))
    else:
        plant["sensor.sampling_lead"] = float(random.uniform(0.0, 0.5))
    return {**options, "plant": plant}


def settled(r: Run, ripple: float) -> bool:
    """Whether a random drive kept its limit and settled, with no more than this ripple (A)."""
    return (
        r.controller.faults() == []
        and r.largest_current() < 1.2 * r.controller.motor.i_max
        and bool(np.abs(r.error(0.2).mean(axis=0)).max() < 0.1)
        and bool(r.ripple(0.2).max() < ripple)
    )


# --- Tables --------------------------------------------------------------------------------------


def _steady_runs(scheme: str, rpm: float, load: float, plant: dict[str, Any]) -> list[Run]:
    return [
        run(scheme, 0.4, rpm=rpm, load=load, seed=seed, oversampling=20, plant=plant)
        for seed in (1, 2, 3)
    ]


def steady() -> Rows:
    """THD at four operating points, with an encoder and with an ideal angle."""
    points = ((750.0, 2.0), (750.0, 5.0), (300.0, 2.0), (1000.0, 2.0))
    rows = [["scheme", *(f"{rpm:.0f} r/min, {load:.0f} N m" for rpm, load in points)]]
    for scheme in SCHEMES:
        cells = []
        for rpm, load in points:
            values = [
                100.0 * np.mean([r.thd(0.2) for r in _steady_runs(scheme, rpm, load, plant)])
                for plant in (ENCODER, {})
            ]
            cells.append(f"{values[0]:.2f} ({values[1]:.2f})")
        rows.append([f"`{scheme}`", *cells])
    return rows


def _ripple_and_error(scheme: str, seed: int, plant: dict[str, Any]) -> list[float]:
    steady = run(scheme, 0.4, seed=seed, plant=plant)
    error = np.abs(steady.lut["prediction_error"][steady.rows(0.2)]).max(axis=0)
    load = run(scheme, 0.4, seed=seed, plant=plant, schedule=LOAD_STEP)
    faster = ("0.2 speed_ref_rpm 1000.0",)
    speed = run(scheme, 0.6, rpm=500.0, seed=seed, plant=plant, schedule=faster)
    return [*steady.ripple(0.2), *error, load.lut_error(0.1), speed.lut_error(0.1)]


def ripple_and_error() -> Rows:
    """Ripple and table error in steady state and through both steps."""
    rows = [
        [
            "scheme",
            "ripple d / q (A)",
            "prediction error d / q, max (A)",
            "load step, max (A)",
            "speed step, max (A)",
        ]
    ]
    for scheme in SCHEMES:
        real, ideal = (
            [f"{x:.2f}" for x in np.mean([_ripple_and_error(scheme, s, p) for s in (1, 2, 3)], 0)]
            for p in (ENCODER, {})
        )
        pairs = [f"{real[n]} / {real[n + 1]} ({ideal[n]} / {ideal[n + 1]})" for n in range(0, 4, 2)]
        steps = [f"{real[n]} ({ideal[n]})" for n in (4, 5)]
        rows.append([f"`{scheme}`", *pairs, *steps])
    return rows


def mismatch() -> Rows:
    """Mean errors and ripple after a load step with three wrong models."""
    rows = [
        ["scheme", *(f"{case}: L {m[0]}, R {m[1]}, psi {m[2]}" for case, m in MISMATCH.items())]
    ]
    for scheme in SCHEMES:
        cells = []
        for ratios in MISMATCH.values():
            wrong = wrong_model(*ratios)
            figures = []
            for plant in (ENCODER, {}):
                r = run(scheme, 0.6, plant=plant, controller=wrong, schedule=LOAD_STEP)
                mean = r.error(0.4).mean(axis=0)
                figures.append(f"{mean[1]:.2f}, {mean[0]:.2f}, {r.ripple(0.4)[0]:.2f}")
            cells.append(f"{figures[0]} ({figures[1]})".replace("-0.00", "0.00"))
        rows.append([f"`{scheme}`", *cells])
    return rows


def survival() -> Rows:
    """Random wrong models: how many drives keep their limit and settle."""
    rows = [["scheme", "settled", "largest current, median (A)", "largest of all (A)"]]
    for scheme in SCHEMES:
        # what a scheme has in any case is not held against it
        own = run(scheme, 0.4, plant=ENCODER).ripple(0.2).max()
        good, largest = 0, []
        for seed in range(DRAWS):
            r = run(scheme, 0.25, **random_drive(seed))
            good += settled(r, max(0.6, 1.5 * own))
            largest.append(r.largest_current())
        rows.append(
            [
                f"`{scheme}`",
                f"{100.0 * good / DRAWS:.1f} %",
                f"{np.median(largest):.1f}",
                f"{np.max(largest):.1f}",
            ]
        )
    return rows


def motors() -> Rows:
    """MLS-MFPCC against MBPCC with true parameters on other motors."""
    rows = [["motor", "r/min", "N m", "`mbpcc` THD (%)", "`mls_mfpcc` THD (%)", "ratio"]]
    for motor, rpm, load in (
        ("textbook_spmsm", 100.0, 2.0),
        ("textbook_spmsm", 750.0, 5.0),
        ("textbook_spmsm", 1500.0, 5.0),
        ("ipmsm", 100.0, 5.0),
        ("ipmsm", 300.0, 5.0),
        ("ipmsm", 750.0, 2.0),
        ("ipmsm", 750.0, 8.0),
        ("ipmsm", 1500.0, 5.0),
    ):
        thd = [
            np.mean(
                [
                    run(
                        scheme,
                        0.5,
                        motor=motor,
                        rpm=rpm,
                        load=load,
                        seed=seed,
                        oversampling=20,
                        plant=ENCODER,
                    ).thd(0.3)
                    for seed in (1, 2, 3)
                ]
            )
            for scheme in ("mbpcc", "mls_mfpcc")
        ]
        rows.append(
            [
                f"`{motor}`",
                f"{rpm:.0f}",
                f"{load:.0f}",
                f"{100 * thd[0]:.2f}",
                f"{100 * thd[1]:.2f}",
                f"{thd[1] / thd[0]:.3f}",
            ]
        )
    return rows


def sector_search() -> Rows:
    """Both sector searches, on a machine without saliency and on a salient one."""
    rows = [["THD (%)", "`ranking`", "`dwell`"]]
    for motor in ("seed_750", "ipmsm"):
        ranking = run("mls_mfpcc_paper", 0.4, motor=motor, oversampling=20, plant=ENCODER).thd(0.2)
        rows.append([f"`mls_mfpcc_paper`, `{motor}`", f"{100.0 * ranking:.2f}", ""])
        for scheme in ("mbpcc", "mls_mfpcc"):
            thd = [
                run(
                    scheme,
                    0.4,
                    motor=motor,
                    oversampling=20,
                    plant=ENCODER,
                    controller={"sector_search": search},
                ).thd(0.2)
                for search in ("ranking", "dwell")
            ]
            rows.append([f"`{scheme}`, `{motor}`", *(f"{100.0 * x:.2f}" for x in thd)])
    return rows


#: What a drive has that simulations leave out: options of `run` on top of the encoder.
REALITY: dict[str, dict[str, Any]] = {
    "ideal": {},
    "sensors of 3 kHz": {"plant": {"sensor.current_bandwidth": 3e3}},
    "sensors of 2 kHz": {"plant": {"sensor.current_bandwidth": 2e3}},
    "sensors of 1 kHz": {"plant": {"sensor.current_bandwidth": 1e3}},
    "sampled half a period early": {"plant": {"sensor.sampling_lead": 0.5}},
    "the same, `ipmsm`": {"motor": "ipmsm", "plant": {"sensor.sampling_lead": 0.5}},
    "noise of 2 mA": {"plant": {"noise.current_rms": 0.00245}},
    "noise of 100 mA": {"plant": {"noise.current_rms": 0.1225}},
    "converters of 10 bits": {"plant": {"sensor.adc_bits": 10}},
    "encoder of 500 lines": {"plant": {"sensor.encoder_lines": 500}},
    "dead time 2 us": {"plant": {"inverter.dead_time": 2e-6}},
    "dead time 4 us": {"plant": {"inverter.dead_time": 4e-6}},
    "EMF: 8 % 5th, 5 % 7th": {"plant": {"machine.emf_5": 0.08, "machine.emf_7": -0.05}},
    "`textbook_spmsm`, 1500 r/min, 5 % 5th": {
        "motor": "textbook_spmsm",
        "rpm": 1500.0,
        "plant": {"machine.emf_5": 0.05},
    },
    "`ipmsm`, saturated, 8 N m": {
        "motor": "ipmsm",
        "load": 8.0,
        "plant": {"machine.flux_map": "ipmsm_saturated"},
    },
    "PWM 4 kHz": {
        "plant": {"pwm_frequency": 4e3},
        "controller": {"pwm_frequency": 4e3},
    },
    "PWM 40 kHz": {
        "plant": {"pwm_frequency": 40e3},
        "controller": {"pwm_frequency": 40e3},
    },
}
SEEDS = range(1, 11)
SLOWER_PI = {"pi.bandwidth": 908.0}


def real_run(scheme: str, case: str, seed: int, oversampling: int = 0) -> Run:
    """A steady run of 0.4 s with one piece of reality."""
    options = dict(REALITY[case])
    options["plant"] = {**ENCODER, **options.get("plant", {})}
    controller = {**options.pop("controller", {}), **(SLOWER_PI if scheme == "pi_foc" else {})}
    return run(scheme, 0.4, seed=seed, oversampling=oversampling, controller=controller, **options)


def reality() -> Rows:
    """Ripple and distortion with what simulations leave out; medians of ten seeds."""
    schemes = ("mbpcc", "pi_foc", "mls_mfpcc_paper", "mls_mfpcc")
    rows = [["ripple d / q (A); THD (%)", *(f"`{scheme}`" for scheme in schemes)]]
    for case in REALITY:
        cells = []
        for scheme in schemes:
            runs = [real_run(scheme, case, seed, 20) for seed in SEEDS]
            d, q = np.median([r.ripple(0.2) for r in runs], axis=0)
            thd = 100.0 * np.median([r.thd(0.2) for r in runs])
            cells.append(f"{d:.2f} / {q:.2f}; {thd:.2f}")
        rows.append([case, *cells])
    return rows


def dirty() -> Rows:
    """Random drives none of whose parts is ideal."""
    rows = [
        [
            "scheme, its model",
            "settled",
            "error over that of the better of both true models: median",
            "90 %",
            "largest",
        ]
    ]
    cases = [dirty_drive(seed) for seed in range(5000, 5000 + DIRTY_DRAWS)]

    def errors(scheme: str, wrong: bool) -> tuple[list[bool], Array]:
        good, rms = [], []
        for case in cases:
            controller = dict(case["controller"]) if wrong else {}
            if scheme == "pi_foc":
                controller |= SLOWER_PI
            r = run(scheme, 0.3, **{**case, "controller": controller})
            good.append(r.controller.faults() == [] and bool(r.ripple(0.2).max() < 0.9))
            rms.append(np.sqrt(np.mean(r.error(0.2) ** 2)))
        return good, np.array(rms)

    found = {(s, False): errors(s, False) for s in ("mbpcc", "pi_foc")}
    best = np.minimum(found["mbpcc", False][1], found["pi_foc", False][1])
    for scheme in ("mbpcc", "pi_foc", "mls_mfpcc_paper", "mls_mfpcc"):
        found[scheme, True] = errors(scheme, True)
    for (scheme, wrong), (good, rms) in found.items():
        over = rms / best
        rows.append(
            [
                f"`{scheme}`, {'wrong' if wrong else 'true'}",
                f"{100.0 * np.mean(good):.1f} %",
                f"{np.median(over):.2f}",
                f"{np.quantile(over, 0.9):.2f}",
                f"{np.max(over):.1f}",
            ]
        )
    return rows


def times() -> Rows:
    """Time of one step inside compiled code, everything included."""
    samples = {scheme: run(scheme, 0.2).feedback for scheme in SCHEMES}
    best: dict[str, float] = dict.fromkeys(SCHEMES, np.inf)
    # many short rounds, so that some fall between whatever else the machine does
    for _ in range(60):
        for scheme in SCHEMES:
            controller = Controller(CONTROLLER.complete({"scheme": scheme, "speed_ref_rpm": 750.0}))
            best[scheme] = min(best[scheme], step_time(controller, samples[scheme])["median"])
    rows = [["scheme", "one step (ns)", "over `mfpcc`"]]
    for scheme in SCHEMES:
        rows.append(
            [f"`{scheme}`", f"{1e3 * best[scheme]:.0f}", f"{best[scheme] / best['mfpcc']:.2f}"]
        )
    return rows


TABLES: dict[str, Callable[[], Rows]] = {
    "steady": steady,
    "ripple": ripple_and_error,
    "wrong_models": mismatch,
    "survival": survival,
    "motors": motors,
    "sectors": sector_search,
    "reality": reality,
    "dirty": dirty,
    "times": times,
}


# --- Figures -------------------------------------------------------------------------------------


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
    axes[0].plot(time, r.state["speed"][rows] * 30.0 / np.pi, color=COLOURS[0])
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
    axes[0].plot(time, r.state["speed"] * 30.0 / np.pi, color=COLOURS[0])
    axes[0].set_ylabel("r/min")
    for axis, name in enumerate("dq"):
        axes[1].plot(time, r.lut["i_dq"][:, axis], color=COLOURS[axis], label=f"$i_{name}$")
    axes[1].plot(time, np.hypot(*r.lut["i_dq"].T), color=COLOURS[2], label="amplitude")
    axes[1].axhline(r.controller.motor.i_max, color=REFERENCE, lw=0.6, ls="--")
    axes[1].set_ylabel("A")
    axes[1].legend(ncols=3, loc="lower right")
    duty = r.command["duty"]
    u = np.abs(2.0 / 3.0 * (duty @ np.exp(2j * np.pi / 3.0 * np.arange(3))))
    axes[2].plot(time, u, color=COLOURS[0], lw=0.4)
    axes[2].axhline(1.0 / np.sqrt(3.0), color=REFERENCE, lw=0.6, ls="--")
    axes[2].set_ylabel("$|u| / u_{dc}$")
    axes[-1].set_xlabel("time (ms)")
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
    "steps": figure_steps,
    "standstill": figure_standstill,
    "reversal": figure_reversal,
    "mismatch": figure_mismatch,
    "switching": figure_switching,
    "inverter": figure_inverter,
    "overmodulation": figure_overmodulation,
    "weakening": figure_weakening,
}


# --- The page ------------------------------------------------------------------------------------


def markdown(rows: Rows) -> str:
    """A table, its first row as heading."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines.insert(1, "|" + "---|" * len(rows[0]))
    return "\n".join(lines)


def update(page: Path, names: Iterable[str], say: Callable[[str], None]) -> None:
    """
    Make tables and figures anew.

    Parameters
    ----------
    page : Path
        docs/method.md.
    names : iterable of str
        Which; none: all.
    say : callable
        Told what is being made.
    """
    wanted = set(names) or {*TABLES, *FIGURES}
    text = page.read_text()
    for name in wanted & {*TABLES}:
        say(f"table {name}")
        place = re.search(rf"<!-- {name} -->\n(.*?)<!-- end -->", text, re.DOTALL)
        if place is None:
            raise SystemExit(f"{page} has no place <!-- {name} --> ... <!-- end -->")
        text = f"{text[: place.start(1)]}{markdown(TABLES[name]())}\n{text[place.end(1) :]}"
    images = page.parent / "images"
    images.mkdir(exist_ok=True)
    with mpl.rc_context(STYLE):
        for name in wanted & {*FIGURES}:
            say(f"figure {name}")
            FIGURES[name]().savefig(images / f"method_{name}.png")
    unfinished = page.with_suffix(".new")
    unfinished.write_text(text)
    unfinished.replace(page)


def main(arguments: Sequence[str]) -> None:
    """``python -m mfpcc_experiments.method_figures PAGE [NAME ...]``."""
    if not arguments or arguments[0] in ("-h", "--help"):
        raise SystemExit(
            "usage: python -m mfpcc_experiments.method_figures PAGE [NAME ...]\n"
            f"PAGE: docs/method.md; NAME: {', '.join([*TABLES, *FIGURES])}; none: all"
        )
    unknown = set(arguments[1:]) - {*TABLES, *FIGURES}
    if unknown:
        raise SystemExit(f"unknown: {', '.join(sorted(unknown))}")
    update(Path(arguments[0]), arguments[1:], lambda text: print(text, flush=True))


if __name__ == "__main__":
    main(sys.argv[1:])
