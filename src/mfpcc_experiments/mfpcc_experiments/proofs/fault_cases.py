"""The cases of the fault matrix: what fails, where, and what has to be found.

Every unit with every type at every operating point, and faults that only one check finds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from pmsm_sim.parts.injection import UNITS

#: When the fault is there (s).
START, DURATION = 0.05, 0.1

_WARM = 95.0  # K: 115 degC, at which less current is allowed, but some


@dataclass(frozen=True)
class Point:
    """An operating point: scheme, speed (r/min) and load (N m)."""

    scheme: str
    speed_rpm: float
    load: float

    def __str__(self) -> str:
        return f"{self.scheme} {self.speed_rpm:g} r/min {self.load:g} N m"


POINTS = (
    Point("mls_mfpcc", 750.0, 2.0),
    Point("mbpcc", 1200.0, 5.0),
    Point("pi_foc", -300.0, 3.0),
    Point("mfpcc", 1500.0, 8.0),
)


@dataclass(frozen=True)
class Case:
    """
    One fault at one operating point.

    Attributes
    ----------
    unit, kind : str
        What fails, and how.
    point : Point
    magnitude : float, optional
        Without it, that of the unit.
    finds : tuple of str
        What has to be found while the fault is there: a code, with the node before it where it
        matters which one finds it (`inverter OVERCURRENT`).
    also : str
        A second fault at the same time: unit, type and magnitude.
    plant, controller : tuple of (str, value)
        Parameters that differ.
    less_current : bool
        Nothing has to trip: less current is enough.
    """

    unit: str
    kind: str
    point: Point
    magnitude: float | None = None
    finds: tuple[str, ...] = ()
    also: str = ""
    plant: tuple[tuple[str, Any], ...] = ()
    controller: tuple[tuple[str, Any], ...] = ()
    less_current: bool = False

    @property
    def injection(self) -> str:
        """As the plant's parameter wants it."""
        magnitude = "" if self.magnitude is None else f" {self.magnitude:g}"
        return f"{START} {DURATION} {self.unit} {self.kind}{magnitude}"

    @property
    def injections(self) -> list[str]:
        """All of them."""
        return [self.injection, *([f"{START} {DURATION} {self.also}"] if self.also else [])]

    @property
    def kind_of_fault(self) -> str:
        """Type and magnitude, for people."""
        return self.kind if self.magnitude is None else f"{self.kind} {self.magnitude:g}"


#: What has to be found while the fault is there, whatever the operating point; "" is anything.
REQUIRED: dict[tuple[str, str], str] = {
    ("dc_sensor", "off"): "FEEDBACK_INVALID",
    ("dc_link", "off"): "DC_UNDERVOLTAGE",
    ("dc_link", "wrong"): "DC_OVERVOLTAGE",
    ("dc_link", "slow"): "DC_OVERVOLTAGE",
    ("duty_link", "off"): "COMMAND_LOST",
    ("duty_link", "dropped"): "COMMAND_LOST",
    ("duty_link", "garbage"): "COMMAND_LOST",
    ("duty_link", "delayed"): "COMMAND_LOST",
    ("feedback_link", "off"): "COMMAND_LOST",
    ("feedback_link", "dropped"): "COMMAND_LOST",
    ("feedback_link", "garbage"): "FEEDBACK_INVALID",
    ("feedback_link", "delayed"): "FEEDBACK_INVALID",
    ("feedback_link", "stuck"): "ENCODER",
    ("temperature", "wrong"): "OVERTEMPERATURE",
    ("encoder", "stuck"): "ENCODER",
    ("encoder", "wrong"): "ENCODER",
    ("encoder", "off"): "ENCODER",
    ("encoder", "intermittent"): "ENCODER",
    ("temperature", "slow"): "OVERTEMPERATURE",
    **{(f"current_{x}", "garbage"): "" for x in "abc"},  # found, under one name or another
    **{(f"current_{x}", "wrong"): "CURRENT_SUM" for x in "abc"},
    **{(f"current_{x}", "off"): "CURRENT_SUM" for x in "abc"},
}


def cases(points: Sequence[Point] = POINTS) -> list[Case]:
    """The whole matrix: every unit with every type it has, at every operating point.

    And a temperature that does not trip yet, at each of them; and what only one check can find.
    """
    return [
        case
        for point in points
        for case in (
            *(Case(unit, kind, point) for unit, kinds in UNITS.items() for kind in kinds),
            Case("temperature", "slow", point, _WARM, less_current=True),
            *(case for case in _PARTICULAR if case.point == point),
        )
    ]


def _particular() -> Iterator[Case]:
    """Faults that only one check finds: without it, the matrix does not pass.

    Limits that are out of order show that either side of the drive stands by itself.
    """
    quiet, _, slow, fast = POINTS
    blind = ("fault.overcurrent", 100.0)
    for phase in "abc":
        beyond = ("FEEDBACK_INVALID",)
        yield Case(f"current_{phase}", "wrong", quiet, 100.0, finds=beyond)
        yield Case(f"current_{phase}", "wrong", quiet, -2.0, finds=("CURRENT_SUM",))
    # their sum is right
    yield Case(
        "current_a", "wrong", slow, 20.0, ("controller OVERCURRENT",), also="current_b wrong -20"
    )
    yield Case("duty_link", "stuck", quiet, None, ("controller OVERCURRENT",), plant=(blind,))
    yield Case("duty_link", "stuck", quiet, None, ("inverter OVERCURRENT",), controller=(blind,))
    for angle in (7.0, -7.0):
        yield Case("encoder", "wrong", quiet, angle, ("FEEDBACK_INVALID",))
    yield Case("dc_sensor", "wrong", quiet, 1500.0, ("FEEDBACK_INVALID",))
    # a scheme that learns would take it for another motor, and predict well again at once
    strict = (("scheme", "mbpcc"), ("fault.prediction_error", 0.02))
    yield Case("dc_sensor", "wrong", quiet, 700.0, ("PREDICTION",), controller=strict)
    for share in (5.0, -5.0):
        yield Case("feedback_link", "wrong", quiet, share, ("FEEDBACK_INVALID",))
    yield Case("load", "wrong", slow, 15.0, ("OVERSPEED",))
    yield Case("load", "wrong", fast, -15.0, ("OVERSPEED",))
    yield Case("leg_a", "off", slow, None, ("SPINOUT",))
    yield Case("load", "stuck", quiet, None, ("STALL",), controller=(("fault.stall_time", 0.03),))
    yield Case("feedback_link", "off", quiet, None, ("COMMAND_LOST", "controller FEEDBACK_LOST"))
    yield Case("dc_link", "wrong", fast, None, ("DC_OVERVOLTAGE", "controller INVERTER"))


_PARTICULAR = tuple(_particular())
