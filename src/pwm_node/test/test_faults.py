"""The latch of faults: what is kept of them, in which order, and when it is forgotten."""

from __future__ import annotations

import numpy as np
import pytest

from pwm_node.faults import Fault, Faults

FAULTS = Faults(
    Fault(code="FIRST", text="{value:g} over {limit:g}", reaction="off"),
    Fault(code="SECOND", text="no number", text_of_value="{value:g} too long", reaction="off"),
    Fault(code="THIRD", text="third", reaction="off"),
)


@pytest.fixture
def latch() -> np.void:
    return np.zeros(1, FAULTS.latch)[0]


def trip(latch: np.void, code: str, period: int, value: float, react: bool = True) -> None:
    FAULTS.trip(latch, FAULTS.number(code), period, value, react=react)


def test_the_oldest_comes_first_whatever_its_name(latch: np.void) -> None:
    trip(latch, "FIRST", 9, 1.0)
    trip(latch, "THIRD", 3, 2.0)
    trip(latch, "SECOND", 5, 0.0)
    assert FAULTS.latched(latch) == [
        ("THIRD", 3, "third"),
        ("SECOND", 5, "no number"),
        ("FIRST", 9, "1 over 0"),
    ]


def test_a_fault_keeps_the_period_and_value_of_its_first_occurrence(latch: np.void) -> None:
    trip(latch, "FIRST", 4, 7.0)
    trip(latch, "FIRST", 5, 8.0)
    assert FAULTS.latched(latch, [6.0, 0.0, 0.0]) == [("FIRST", 4, "7 over 6")]


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "no number"), (0.5, "0.5 too long"), (-0.5, "no number")]
)
def test_a_code_with_two_causes_says_which(latch: np.void, value: float, text: str) -> None:
    trip(latch, "SECOND", 1, value)
    assert FAULTS.latched(latch) == [("SECOND", 1, text)]


def test_it_takes_the_gates_off_only_where_it_is_to_react(latch: np.void) -> None:
    trip(latch, "FIRST", 1, 1.0, react=False)
    assert not latch["tripped"] and FAULTS.latched(latch)
    trip(latch, "FIRST", 2, 1.0)
    assert latch["tripped"]


def test_it_is_cleared_as_a_whole_and_only_when_no_cause_lasts(latch: np.void) -> None:
    trip(latch, "FIRST", 1, 1.0)
    trip(latch, "THIRD", 1, 1.0)
    latch["present"] = 1 << FAULTS.number("THIRD")
    assert FAULTS.clear(latch) == ["THIRD"]
    assert latch["tripped"] and len(FAULTS.latched(latch)) == 2
    latch["present"] = 1 << FAULTS.number("SECOND")  # not latched: it does not react
    assert FAULTS.clear(latch) == []
    assert not latch["tripped"] and FAULTS.latched(latch) == []
