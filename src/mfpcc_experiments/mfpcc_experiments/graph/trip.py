"""A trip of the drive as a page of figures: which faults, and the drive in that period."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from typing import Any

import mfpcc_msgs.msg
import numpy as np
from mfpcc_msgs.msg import DriveFault
from rclpy.serialization import deserialize_message

from mfpcc_experiments.bags import LOOP_TOPICS
from mfpcc_experiments.graph.excerpt import Excerpt
from pwm_node.units import RPM


class Trip:
    """A fault that was told, and those that came with it until all is written.

    Parameters
    ----------
    node : str
        Who told it.
    faults : sequence of DriveFault
        What is new there.
    """

    def __init__(self, node: str, faults: Sequence[DriveFault]) -> None:
        self.wall = datetime.now(timezone.utc)
        first = min(faults, key=lambda fault: fault.period)
        self.node, self.period, self.code = node, int(first.period), str(first.code)
        self.seen, self.seen_at = -1, time.monotonic()
        self._faults: list[dict[str, Any]] = []
        self.add(node, faults)

    def add(self, node: str, faults: Sequence[DriveFault]) -> None:
        """Take note of faults."""
        self._faults += [
            {
                "code": fault.code,
                "node": node,
                "period": int(fault.period),
                "seen": fault.detail,
            }
            for fault in faults
        ]

    def page(self, pwm_frequency: float) -> dict[str, Any]:
        """What is known of it without a look at the messages."""
        first = next(fault for fault in self._faults if fault["code"] == self.code)
        more = [fault for fault in self._faults if fault is not first]
        return {
            "code": self.code,
            "node": self.node,
            "seen": first["seen"],
            "wall clock": self.wall.isoformat(timespec="milliseconds"),
            "period": self.period,
            "simulated time (s)": round(self.period / pwm_frequency, 9),
            **({"then": more} if more else {}),
        }


def figures(
    excerpts: Mapping[str, Excerpt],
    period: int,
    values: Mapping[str, Mapping[str, Any]],
    changes: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """The drive in the period of the fault, for people; only what is known."""
    feedback, command, lut, state = (
        _message(topic, excerpts[topic].at(period))
        for topic in ("phase_feedback", "duty_command", "lut_diagnostics", "drive_state")
    )
    figures: dict[str, Any] = {}
    if feedback is not None:
        figures |= {
            "i_a (A)": feedback.i_a,
            "i_b (A)": feedback.i_b,
            "i_c (A)": feedback.i_c,
            "encoder angle (rad)": feedback.encoder_angle,
            "DC-link voltage (V)": feedback.dc_voltage,
        }
    if lut is not None:
        figures |= {
            "scheme": lut.scheme,
            "i_d, i_q (A)": lut.i_dq,
            "i_d, i_q reference (A)": lut.i_dq_ref,
            "prediction error d, q (A)": lut.prediction_error,
            "electrical speed, estimated (rad/s)": lut.w_m,
            "speed reference (r/min)": lut.speed_ref / RPM,
        }
    if command is not None:
        figures |= {
            "duty a, b, c": command.duty,
            "active vectors": command.vectors,
            "dwell": command.dwell,
            "gates on by command": command.enable,
        }
    if state is not None:
        figures |= {
            "gates on": state.gates_on,
            "true i_d, i_q (A)": state.i_dq,
            "true speed (r/min)": state.speed / RPM,
            "torque (N m)": state.torque,
            "load torque (N m)": state.load_torque,
            "winding temperature (degC)": state.temperature,
        }
    parameters = dict(values.get("mfpcc_controller", {}))
    for change in changes:
        if change["node"] == "mfpcc_controller" and change["period"] <= period:
            parameters[change["name"]] = change["value"]
    for name in ("mismatch.inductance", "mismatch.resistance", "mismatch.flux"):
        if name in parameters:
            figures[name] = parameters[name]
    return {name: _readable(value) for name, value in figures.items()}


def limits(code: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters that a fault depends on: those that are named as it begins."""
    begin = f"fault.{code.split('_')[0].lower()}"
    return {name: value for name, value in parameters.items() if name.startswith(begin)}


def _message(topic: str, data: bytes | None) -> Any:
    if data is None:
        return None
    return deserialize_message(data, getattr(mfpcc_msgs.msg, LOOP_TOPICS[topic].split("/")[-1]))


def _readable(value: Any) -> Any:
    """Plain values of YAML, with six digits."""
    if isinstance(value, (bool, str, int)):
        return value
    if isinstance(value, float):
        return float(f"{value:.6g}")
    return [_readable(each) for each in np.asarray(value).tolist()]
