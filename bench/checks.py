"""What the checks of both kernels cost in a period: all of them on real samples, nothing else."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median

import drives
import numpy as np
from engine import engine_of
from figures import Figure, figure, interleaved

from mfpcc_controller import protection as controller_checks
from pmsm_sim.parts import protection as plant_checks
from pwm_node.compiled import kernel

_PERIODS = 10_000


@kernel
def _controller(cfg_, mem_, feedback):
    """Judge each sample, and the drive by it, as `controller.sample` does in each period."""
    cfg, mem = cfg_[0], mem_[0]
    allowed = 0
    for k in range(feedback.shape[0]):
        fb = feedback[k]
        mem.period = fb.period
        if not controller_checks.stale(mem, fb):
            allowed += 1
        if controller_checks.accept(cfg, mem, fb, np.uint64(1)):
            controller_checks.watch(cfg, mem, fb)
        controller_checks.misled(cfg, mem)
        controller_checks.overran(cfg, mem)
        if controller_checks.released(cfg, mem):
            allowed += 1
    return allowed


@kernel
def _inverter(par_, st_, periods):
    """Look at current, voltage and temperature, as the plant does in each period."""
    par, st = par_[0], st_[0]
    for k in range(periods):
        # another current each time, so that the compiler cannot judge once for all
        st.i_d = 1e-3 * k
        plant_checks.protect(par, st)
    return st.present


def measure(*, quick: bool) -> list[Figure]:
    """Both together, beside the period of the composed drive and the PWM period."""
    rounds = 3 if quick else 9
    checks = interleaved(rounds, controller=_timed_controller(), inverter=_timed_inverter())
    both = [a + b for a, b in zip(checks["controller"], checks["inverter"], strict=True)]
    period = median(drives.composed(20_000)[0].period_us() for _ in range(2 if quick else 5))
    name = "all checks of controller and inverter, one period"
    return [
        figure(name, both, "us", "PWM period", 100.0, bar="ratio <= 0.03"),
        figure(name, both, "us", "period of the composed drive", period, bar="ratio <= 0.03"),
    ]


def _timed_controller() -> Callable[[], float]:
    engine = engine_of("mls_mfpcc", 0)
    feedback = np.concatenate([trace.feedback for trace in engine.run(_PERIODS)])
    cfg, mem = engine.controller.cfg, engine.controller.mem
    return _timed(lambda: _controller(cfg, mem, feedback))


def _timed_inverter() -> Callable[[], float]:
    engine = engine_of("mls_mfpcc", 0)
    for _ in engine.run(100):
        pass
    par, st = engine.plant.par, engine.plant.st
    return _timed(lambda: _inverter(par, st, _PERIODS))


def _timed(run: Callable[[], object]) -> Callable[[], float]:
    run()  # compiled or loaded

    def us() -> float:
        begin = time.perf_counter_ns()
        run()
        return (time.perf_counter_ns() - begin) * 1e-3 / _PERIODS

    return us
