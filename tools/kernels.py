"""Compile the kernels of the plant or of the controller, as their nodes do when they start.

    kernels.py plant|controller

The set-up does both at the same time, so that the first run has nothing to compile. What is
compiled already is left alone. Needs the workspace to be sourced.
"""

from __future__ import annotations

import sys

from mfpcc_msgs.msg import DriveState, DutyCommand, LutDiagnostics, PhaseFeedback

from pwm_node import stamps
from pwm_node.compiled import cache_folder, direct
from pwm_node.wire import Wire


def plant() -> None:
    """Compile what the plant calls in a period."""
    from pmsm_sim.parameters import TABLE
    from pmsm_sim.plant import Plant, advance, latch

    core = Plant(TABLE.defaults())
    n = core.oversampling
    state = Wire(DriveState, i_abc_oversampled=3 * n, legs_oversampled=n)
    waveforms = (state.tail["i_abc_oversampled"], state.tail["legs_oversampled"])
    direct(latch, core.st, Wire(DutyCommand).fixed)
    direct(advance, core.par, core.st, Wire(PhaseFeedback).fixed, state.fixed, *waveforms)
    stamps.begin(0, 10_000.0)  # as `drive_status` is stamped


def controller() -> None:
    """Compile what the controller calls in a period, whichever the scheme."""
    from mfpcc_controller.controller import Controller
    from mfpcc_controller.parameters import TABLE

    core = Controller(TABLE.defaults())
    core.bind(Wire(PhaseFeedback).fixed, Wire(DutyCommand).fixed, Wire(LutDiagnostics).fixed)


def main(part: str) -> None:
    """Compile a part, if what is compiled can be kept."""
    try:
        cache_folder().mkdir(parents=True, exist_ok=True)
    except OSError:
        return  # each start compiles anew, and says so
    {"plant": plant, "controller": controller}[part]()


if __name__ == "__main__":
    main(sys.argv[1])
