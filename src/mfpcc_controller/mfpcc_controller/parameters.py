"""The controller's parameters: one table for the node, the engine and the scenario files."""

from __future__ import annotations

from pwm_node.parameters import Parameter, Table

#: Built-in schemes; the position is the number the kernels know them by.
SCHEMES = ("mls_mfpcc", "mfpcc", "mbpcc")
SECTOR_SEARCHES = ("dwell", "ranking")
OVERMODULATIONS = ("scale", "project")
CONTROL_MODES = ("speed", "current")

TABLE = Table(
    [
        Parameter(
            "motor", "seed_750", "Motor: a name of config/motors or the path of a file", read_only=True
        ),
        Parameter(
            "pwm_frequency",
            10_000.0,
            "PWM and control frequency",
            unit="Hz",
            minimum=1_000.0,
            maximum=100_000.0,
            read_only=True,
        ),
        Parameter("scheme", "mls_mfpcc", "Current-control scheme", choices=SCHEMES),
        Parameter(
            "mismatch.inductance",
            1.0,
            "Inductance of the controller's model over the motor file's",
            minimum=0.01,
            maximum=100.0,
        ),
        Parameter(
            "mismatch.resistance",
            1.0,
            "Resistance of the controller's model over the motor file's",
            minimum=0.0,
            maximum=100.0,
        ),
        Parameter(
            "mismatch.flux",
            1.0,
            "Magnet flux of the controller's model over the motor file's",
            minimum=0.0,
            maximum=100.0,
        ),
        Parameter("control_mode", "speed", "What is regulated", choices=CONTROL_MODES),
        Parameter(
            "speed_ref_rpm", 0.0, "Speed reference", unit="r/min", minimum=-1e5, maximum=1e5
        ),
        Parameter(
            "i_d_ref",
            0.0,
            "d-axis current reference (both control modes)",
            unit="A",
            minimum=-1e4,
            maximum=1e4,
        ),
        Parameter(
            "i_q_ref",
            0.0,
            "q-axis current reference (control_mode current)",
            unit="A",
            minimum=-1e4,
            maximum=1e4,
        ),
        Parameter(
            "speed.bandwidth",
            100.0,
            "Bandwidth of the speed loop",
            unit="rad/s",
            minimum=0.1,
            maximum=5_000.0,
        ),
        Parameter(
            "observer.bandwidth",
            600.0,
            "Bandwidth of the rotor observer (phase-locked loop on the encoder angle)",
            unit="rad/s",
            minimum=1.0,
            maximum=20_000.0,
        ),
        Parameter(
            "sector_search",
            "dwell",
            "How the two active vectors are found: the pair with non-negative dwell times, or the "
            "paper's ranking of three costs (equal inductances only)",
            choices=SECTOR_SEARCHES,
        ),
        Parameter(
            "overmodulation",
            "scale",
            "Dwell times that do not fit into the period: scaled (the paper), or the point of the "
            "voltage hexagon nearest to the wish",
            choices=OVERMODULATIONS,
        ),
        Parameter(
            "mls.window", 5, "Samples in the moving-least-squares window", minimum=1, maximum=32
        ),
        Parameter(
            "mls.beta", 0.8, "Forgetting factor of the window", minimum=0.0, maximum=1.0
        ),
        Parameter("mls.eta_min", 0.05, "Learning rate at small errors", minimum=0.0, maximum=1.0),
        Parameter("mls.eta_max", 0.5, "Learning rate at large errors", minimum=0.0, maximum=1.0),
        Parameter(
            "mls.e_0",
            0.3,
            "Error at which the learning rate goes from small to large",
            unit="A",
            minimum=1e-6,
            maximum=1e3,
        ),
        Parameter(
            "mls.g_max",
            0.3,
            "Largest change of a gradient in one period",
            unit="A",
            minimum=0.0,
            maximum=1e3,
        ),
        Parameter(
            "mfpcc.u_min",
            20.0,
            "A voltage change smaller than this updates no gradient of mfpcc",
            unit="V",
            minimum=0.0,
            maximum=1e3,
        ),
        Parameter(
            "diagnostics_decimation",
            1,
            "lut_diagnostics is published every so many periods; 0: never",
            minimum=0,
            maximum=1_000_000,
            read_only=True,
        ),
        Parameter(
            "recorders",
            0,
            "So many recorders are awaited before the first period, so that they miss nothing",
            minimum=0,
            maximum=100,
            read_only=True,
        ),
        Parameter(
            "schedule",
            [],
            "Parameter changes at given simulated times, each 'SECONDS NAME VALUE'",
            read_only=True,
        ),
    ]
)
