"""The simulator's parameters: one table for the node, the engine and the scenario files."""

from __future__ import annotations

from pwm_node.parameters import Parameter, Table

TABLE = Table(
    [
        Parameter(
            "motor",
            "seed_750",
            "Motor: a name of config/motors or the path of a file",
            read_only=True,
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
        Parameter(
            "real_time_factor",
            0.0,
            "0: lock-step, each period waits for its command; above 0: periods follow the wall "
            "clock at this speed",
            minimum=0.0,
            maximum=100.0,
        ),
        Parameter("load_torque", 0.0, "Load torque", unit="N m", minimum=-1e4, maximum=1e4),
        Parameter("dc_voltage", 311.0, "DC-link voltage", unit="V", minimum=1.0, maximum=2_000.0),
        Parameter(
            "inverter.missing_command",
            "zero",
            "What the inverter applies in the first period without a command: the zero vector, or "
            "the command before (hold)",
            choices=("zero", "hold"),
        ),
        Parameter(
            "inverter.command_loss_limit",
            10,
            "So many periods in a row without a command block the gates until the trip is cleared",
            minimum=1,
            maximum=1_000_000,
        ),
        Parameter(
            "noise.current_rms",
            0.0,
            "White noise of each phase-current sensor, rms",
            unit="A",
            minimum=0.0,
            maximum=100.0,
        ),
        Parameter("seed", 0, "Seed of all noise", minimum=0, maximum=2**53, read_only=True),
        Parameter(
            "initial_speed_rpm",
            0.0,
            "Rotor speed at period 0",
            unit="r/min",
            minimum=-1e5,
            maximum=1e5,
            read_only=True,
        ),
        Parameter(
            "initial_angle",
            0.0,
            "Mechanical rotor angle at period 0",
            unit="rad",
            minimum=-1e3,
            maximum=1e3,
            read_only=True,
        ),
        Parameter(
            "oversampling",
            0,
            "Points per period of the waveform in drive_state; 0: none. Does not change the run",
            minimum=0,
            maximum=1_000,
            read_only=True,
        ),
        Parameter(
            "state_decimation",
            1,
            "drive_state is published every so many periods; 0: never",
            minimum=0,
            maximum=1_000_000,
            read_only=True,
        ),
        Parameter(
            "periods",
            0,
            "End after so many periods; 0: run until stopped",
            minimum=0,
            maximum=2**53,
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
