"""Parameters are live while the drive runs at full speed, set from another process."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from harness import Process, until
from outside import Outside


@pytest.fixture
def drive(domain: int, start: Callable[..., Process]) -> Iterator[Outside]:
    """A drive at full speed, seen from outside."""
    arguments = ("speed_ref_rpm:=500.0", "load_torque:=1.0", "scheme:=mbpcc")
    start(
        "mfpcc_experiments",
        "drive",
        "--ros-args",
        *(part for argument in arguments for part in ("-p", argument)),
    )
    outside = Outside()
    outside.until_beyond(1000, "the drive runs at full speed")
    yield outside
    outside.close()


def test_a_change_takes_effect_while_it_runs(drive: Outside) -> None:
    (answer,) = drive.set("pmsm_sim", load_torque=3.25)
    assert answer.successful, answer.reason
    assert drive.get("pmsm_sim", "load_torque") == 3.25

    def acts() -> bool:
        drive.look()
        return drive.state is not None and drive.state.load_torque == 3.25

    until(acts, "the new load torque acts on the motor")


def test_a_change_of_the_scheme_shows_in_the_diagnostics(drive: Outside) -> None:
    for scheme in ("mls_mfpcc", "mfpcc"):
        (answer,) = drive.set("mfpcc_controller", scheme=scheme)
        assert answer.successful, answer.reason

        def in_control(scheme: str = scheme) -> bool:
            drive.look()
            return drive.scheme == scheme

        until(in_control, f"{scheme} is in control")
    drive.until_beyond(drive.period + 1000, "the loop goes on")


def test_a_wrong_value_is_refused_with_its_reason(drive: Outside) -> None:
    for node, name, value, reason in (
        ("pmsm_sim", "load_torque", 1e9, "load_torque"),
        ("pmsm_sim", "load_torque", "much", "load_torque"),
        ("pmsm_sim", "load_torqe", 1.0, "load_torque"),  # the nearest name is told
        ("pmsm_sim", "motor", "ipmsm", "motor"),  # read-only
        ("mfpcc_controller", "scheme", "mls_mfpc", "mls_mfpcc"),
    ):
        (answer,) = drive.set(node, **{name: value})
        assert not answer.successful, name
        assert reason in answer.reason
    assert drive.get("pmsm_sim", "load_torque") == 1.0
    assert drive.get("mfpcc_controller", "scheme") == "mbpcc"
    drive.until_beyond(drive.period + 1000, "the loop goes on")


def test_what_is_set_together_is_accepted_or_refused_one_by_one(drive: Outside) -> None:
    good, bad = drive.set("mfpcc_controller", speed_ref_rpm=600.0, scheme="none")
    assert good.successful and not bad.successful
    assert drive.get("mfpcc_controller", "speed_ref_rpm") == 600.0
