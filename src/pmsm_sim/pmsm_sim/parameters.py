"""The simulator's parameters: one table for the node, the engine and the scenario files."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import cast

from pmsm_sim import motor, protection
from pmsm_sim.injection import InjectionError, parse
from pmsm_sim.records import PROFILE_SIZE
from pwm_node.parameters import (
    PWM_FREQUENCY,
    RECORDERS,
    SCHEDULE,
    Parameter,
    Table,
    Value,
    file_parameter,
)
from pwm_node.yaml_files import FileError


def _check(values: Mapping[str, Value]) -> str | None:
    """What single limits cannot say."""
    number = cast("Mapping[str, float]", values)
    T_s = 1.0 / number["pwm_frequency"]
    for name in ("inverter.dead_time", "inverter.min_pulse"):
        if number[name] >= 0.5 * T_s:
            return (
                f"'{name}' = {number[name]:g} is out of range: it must be shorter than half a "
                f"PWM period, 0 to {0.5 * T_s:g} s"
            )
    if number["sensor.encoder_latency"] > T_s:
        return (
            f"'sensor.encoder_latency' = {number['sensor.encoder_latency']:g} is out of range: at "
            f"most one PWM period, 0 to {T_s:g} s"
        )
    for name in ("sensor.current_gain", "sensor.current_offset"):
        listed = cast("list[float]", values[name])
        if len(listed) != 3:
            return f"'{name}' = {listed} must have three values, for phases a, b and c"
    clock = number["inverter.timer_clock"]
    if 0.0 < clock < 8.0 / T_s:
        return (
            f"'inverter.timer_clock' = {clock:g} is out of range: 0 (no rounding), or at least "
            f"{8.0 / T_s:g} Hz, for 4 counts up and 4 down in a PWM period"
        )
    if number["dc_link.chopper_off"] >= number["dc_link.chopper_on"]:
        return (
            f"'dc_link.chopper_off' = {number['dc_link.chopper_off']:g} is out of range: it must "
            f"be below 'dc_link.chopper_on' ({number['dc_link.chopper_on']:g} V)"
        )
    if number["load.shaft_stiffness"] > 0.0 and number["load.inertia"] == 0.0:
        return "'load.inertia' = 0 is out of range: behind an elastic shaft it must be above 0"
    if reason := protection.check(values):
        return reason
    return _check_profile(cast("list[float]", values["load.profile"])) or _check_injections(values)


def _of_the_motor(values: Mapping[str, Value]) -> Mapping[str, Value]:
    """The DC link a motor is meant for: 311 V would be the end of one for 12 V."""
    try:
        return {"dc_voltage": motor.load(str(values["motor"])).u_dc}
    except FileError:
        return {}  # whoever needs the motor says what is wrong with it


def _check_injections(values: Mapping[str, Value]) -> str | None:
    injections = cast("list[str]", values["injections"])
    if not injections:
        return None
    if not values["fault_injection"]:
        return "'injections' is refused: faults are injected only with 'fault_injection' = true"
    if values["dc_link.kind"] == "rectifier" and any("dc_link" in text for text in injections):
        return "'injections': dc_link fails only where 'dc_link.kind' is stiff"
    try:
        parse(injections, 1.0 / cast("float", values["pwm_frequency"]))
    except InjectionError as error:
        return f"'injections': {error}"
    return None


def _check_profile(points: list[float]) -> str | None:
    if len(points) % 2 or not 2 <= len(points) <= 2 * PROFILE_SIZE:
        return (
            f"'load.profile' must have pairs of time (s) and torque (N m), 1 to {PROFILE_SIZE} of "
            f"them; it has {len(points)} values"
        )
    times = points[::2]
    if any(a >= b for a, b in pairwise(times)):
        return f"'load.profile': the times must increase from point to point, not {times}"
    return None


TABLE = Table(
    [
        file_parameter("motor", "seed_750", "motors", "Motor"),
        PWM_FREQUENCY,
        Parameter(
            "real_time_factor",
            0.0,
            "0: lock-step, each period waits for its command; above 0: periods follow the wall "
            "clock at this speed",
            minimum=0.0,
            maximum=100.0,
        ),
        Parameter(
            "load_torque",
            0.0,
            "Load torque",
            unit="N m",
            minimum=-1e4,
            maximum=1e4,
            also=("tau_L", "T_L"),
        ),
        Parameter(
            "dc_voltage",
            311.0,
            "DC-link voltage; where it is not given, that of the motor file",
            unit="V",
            minimum=1.0,
            maximum=2_000.0,
            also=(
                "u_dc",
                "v_dc",
            ),
        ),
        Parameter(
            "inverter.missing_command",
            "zero",
            "What the inverter applies in the first period without a command: the zero vector, or "
            "the command before (hold)",
            choices=("zero", "hold"),
        ),
        Parameter(
            "inverter.dead_time",
            0.0,
            "Time between switching one transistor of a leg off and the other on",
            unit="s",
            minimum=0.0,
            maximum=1e-4,
        ),
        Parameter(
            "inverter.switch_voltage",
            0.0,
            "On-state voltage of a transistor, its constant part",
            unit="V",
            minimum=0.0,
            maximum=10.0,
        ),
        Parameter(
            "inverter.switch_resistance",
            0.0,
            "On-state resistance of a transistor",
            unit="ohm",
            minimum=0.0,
            maximum=10.0,
        ),
        Parameter(
            "inverter.diode_voltage",
            0.0,
            "Forward voltage of a diode, its constant part",
            unit="V",
            minimum=0.0,
            maximum=10.0,
        ),
        Parameter(
            "inverter.diode_resistance",
            0.0,
            "Forward resistance of a diode",
            unit="ohm",
            minimum=0.0,
            maximum=10.0,
        ),
        Parameter(
            "inverter.min_pulse",
            0.0,
            "Pulses shorter than this are left out",
            unit="s",
            minimum=0.0,
            maximum=1e-4,
        ),
        Parameter(
            "inverter.timer_clock",
            0.0,
            "Clock of the PWM timer, which rounds duties to its counts; 0: no rounding",
            unit="Hz",
            minimum=0.0,
            maximum=1e10,
        ),
        *protection.PARAMETERS,
        Parameter(
            "fault_injection",
            False,
            "Whether faults may be injected at all",
            read_only=True,
        ),
        Parameter(
            "injections",
            [],
            "Faults to inject, each 'START DURATION UNIT TYPE [MAGNITUDE [SEED]]', times in "
            "simulated seconds; more of them by the service ~/inject_fault",
            read_only=True,
        ),
        Parameter(
            "machine.flux_map",
            "",
            "Saturation: a name of config/flux_maps or the path of a file; empty: linear machine",
            read_only=True,
        ),
        Parameter(
            "machine.iron_loss_resistance",
            0.0,
            "Resistance across the induced voltage that stands for the iron loss; 0: no iron loss",
            unit="ohm",
            minimum=0.0,
            maximum=1e7,
        ),
        *(
            Parameter(
                f"machine.emf_{n}",
                0.0,
                f"{n}th harmonic of the back-EMF over its fundamental",
                minimum=-0.5,
                maximum=0.5,
            )
            for n in (5, 7, 11, 13)
        ),
        Parameter(
            "machine.cogging_torque",
            0.0,
            "Amplitude of the cogging torque",
            unit="N m",
            minimum=0.0,
            maximum=1e3,
        ),
        Parameter(
            "machine.cogging_periods",
            24,
            "Periods of the cogging torque per turn",
            minimum=1,
            maximum=1_000,
        ),
        Parameter(
            "dc_link.kind",
            "stiff",
            "What feeds the inverter: dc_voltage without any resistance, or a three-phase "
            "rectifier with a capacitor, which begins at dc_voltage",
            choices=("stiff", "rectifier"),
            read_only=True,
        ),
        Parameter(
            "dc_link.capacitance",
            1e-3,
            "Capacitor behind the rectifier",
            unit="F",
            minimum=1e-6,
            maximum=10.0,
        ),
        Parameter(
            "dc_link.grid_voltage",
            220.0,
            "Line-to-line voltage of the grid, rms",
            unit="V",
            minimum=0.0,
            maximum=2_000.0,
        ),
        Parameter(
            "dc_link.grid_frequency",
            50.0,
            "Frequency of the grid; the rectified voltage has six pulses per period",
            unit="Hz",
            minimum=1.0,
            maximum=1_000.0,
            read_only=True,
        ),
        Parameter(
            "dc_link.grid_resistance",
            0.5,
            "Resistance of what lies in series with the rectifier",
            unit="ohm",
            minimum=1e-3,
            maximum=1e3,
        ),
        Parameter(
            "dc_link.chopper_resistance",
            0.0,
            "Resistor of the brake chopper; 0: no chopper",
            unit="ohm",
            minimum=0.0,
            maximum=1e4,
        ),
        Parameter(
            "dc_link.chopper_on",
            380.0,
            "DC-link voltage at which the chopper goes on, looked at once in a period",
            unit="V",
            minimum=1.0,
            maximum=5_000.0,
        ),
        Parameter(
            "dc_link.chopper_off",
            370.0,
            "DC-link voltage at which the chopper goes off",
            unit="V",
            minimum=1.0,
            maximum=5_000.0,
        ),
        Parameter(
            "load.kind",
            "torque",
            "torque: load_torque acts whatever the speed; brake: load_torque of a magnetic powder "
            "brake, against the motion; speed: load.speed_rpm is imposed on the rotor",
            choices=("torque", "brake", "speed"),
        ),
        Parameter(
            "load.speed_rpm",
            0.0,
            "Speed imposed on the rotor where load.kind is speed",
            unit="r/min",
            minimum=-1e5,
            maximum=1e5,
        ),
        Parameter(
            "load.brake_lag",
            0.0,
            "Time constant with which the powder brake follows load_torque; 0: at once",
            unit="s",
            minimum=0.0,
            maximum=100.0,
        ),
        Parameter(
            "load.quadratic",
            0.0,
            "Load torque over the square of the speed (fan, pump)",
            unit="N m s^2",
            minimum=0.0,
            maximum=10.0,
        ),
        Parameter(
            "load.profile",
            [0.0, 0.0],
            "Load torque over time, added to the others: time (s) and torque (N m) in turns, "
            "straight lines between the points",
            read_only=True,
        ),
        Parameter(
            "load.coulomb_friction",
            0.0,
            "Coulomb friction of the rotor",
            unit="N m",
            minimum=0.0,
            maximum=1e3,
        ),
        Parameter(
            "load.viscous_friction",
            0.0,
            "Viscous friction, added to that of the motor file",
            unit="N m s",
            minimum=0.0,
            maximum=10.0,
        ),
        Parameter(
            "load.inertia",
            0.0,
            "Inertia of the load, added to that of the motor file",
            unit="kg m^2",
            minimum=0.0,
            maximum=1e3,
            read_only=True,
            also=("load.J",),
        ),
        Parameter(
            "load.shaft_stiffness",
            0.0,
            "Stiffness of the shaft between motor and load.inertia; 0: rigid",
            unit="N m/rad",
            minimum=0.0,
            maximum=1e7,
            read_only=True,
        ),
        Parameter(
            "load.shaft_damping",
            0.0,
            "Damping of the shaft",
            unit="N m s",
            minimum=0.0,
            maximum=1e3,
        ),
        Parameter(
            "sensor.current_gain",
            [1.0, 1.0, 1.0],
            "Gain of the current sensors of phases a, b, c",
            minimum=0.1,
            maximum=10.0,
        ),
        Parameter(
            "sensor.current_offset",
            [0.0, 0.0, 0.0],
            "Offset of the current sensors of phases a, b, c",
            unit="A",
            minimum=-100.0,
            maximum=100.0,
        ),
        Parameter(
            "sensor.current_bandwidth",
            0.0,
            "Bandwidth of the current sensors (first-order low-pass); 0: unlimited",
            unit="Hz",
            minimum=0.0,
            maximum=1e6,
        ),
        Parameter(
            "sensor.adc_bits",
            0,
            "Resolution of the current converters; 0: no quantisation",
            minimum=0,
            maximum=24,
        ),
        Parameter(
            "sensor.adc_range",
            20.0,
            "Largest current they can show, of each sign; beyond, they saturate",
            unit="A",
            minimum=0.001,
            maximum=1e4,
        ),
        Parameter(
            "sensor.sampling_lead",
            0.0,
            "The currents are sampled so long before the period begins, in periods",
            minimum=0.0,
            maximum=1.0,
        ),
        Parameter(
            "sensor.encoder_lines",
            0,
            "Lines of the incremental encoder, each counted four times; 0: no quantisation",
            minimum=0,
            maximum=1_000_000,
        ),
        Parameter(
            "sensor.encoder_offset",
            0.0,
            "Angle that the encoder shows at zero",
            unit="rad",
            minimum=-6.3,
            maximum=6.3,
        ),
        Parameter(
            "sensor.encoder_latency",
            0.0,
            "Age of the angle at the start of the period; at most one period",
            unit="s",
            minimum=0.0,
            maximum=1e-3,
        ),
        Parameter(
            "sensor.angle_noise",
            0.0,
            "White noise of the angle (resolver), rms",
            unit="rad",
            minimum=0.0,
            maximum=0.1,
        ),
        Parameter(
            "drift.resistance",
            1.0,
            "Stator resistance over that of the motor file",
            minimum=0.01,
            maximum=100.0,
            also=(
                "drift.R",
                "drift.R_s",
            ),
        ),
        Parameter(
            "drift.flux",
            1.0,
            "Magnet flux over that of the motor file or flux map",
            minimum=0.0,
            maximum=10.0,
            also=(
                "drift.psi",
                "drift.psi_f",
            ),
        ),
        Parameter(
            "drift.temperature",
            20.0,
            "Temperature of winding and magnets without copper loss; the motor file holds at 20",
            unit="degC",
            minimum=-60.0,
            maximum=250.0,
        ),
        Parameter(
            "drift.time_constant",
            0.0,
            "Time constant of the temperature; 0: it follows at once",
            unit="s",
            minimum=0.0,
            maximum=1e5,
        ),
        Parameter(
            "drift.thermal_resistance",
            0.0,
            "Rise of the temperature over the copper loss",
            unit="K/W",
            minimum=0.0,
            maximum=100.0,
        ),
        Parameter(
            "drift.copper_coefficient",
            0.00393,
            "Relative change of the resistance with temperature (copper)",
            unit="1/K",
            minimum=0.0,
            maximum=0.01,
        ),
        Parameter(
            "drift.magnet_coefficient",
            -0.0012,
            "Relative change of the magnet flux with temperature (NdFeB)",
            unit="1/K",
            minimum=-0.01,
            maximum=0.01,
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
        RECORDERS,
        SCHEDULE,
    ],
    check=_check,
    follow=_of_the_motor,
)
