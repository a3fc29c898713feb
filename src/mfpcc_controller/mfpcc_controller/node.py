"""The node `/mfpcc_controller`: the drive controller on the graph.

It answers the sample of period k with the command for period k + 1.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterable, Mapping
from typing import Any

from mfpcc_msgs.msg import (
    DriveFault,
    DriveReference,
    DriveStatus,
    DutyCommand,
    LutDiagnostics,
    PhaseFeedback,
)
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import DurabilityPolicy, QoSProfile

from mfpcc_controller.controller import Controller
from mfpcc_controller.parameters import TABLE
from pwm_node import compiled
from pwm_node.ros import spin
from pwm_node.ros.diagnostics import Level, Part
from pwm_node.ros.loop_topics import goes_by_itself
from pwm_node.ros.node import PwmNode
from pwm_node.ros.pace import Listeners, SteadyTimer
from pwm_node.ros.status import StatusPublisher
from pwm_node.ros.stops import Stops
from pwm_node.wire import Wire, WireError

_WATCH_EVERY = 0.1  # s
_PACE_EVERY = 1.0  # s
_OVERRUNS = 10  # in a row are too many
# A sample that is older by less than this has been overtaken; else the plant has begun anew.
_OVERTAKEN = 100
_START_PLANT = "ros2 run pmsm_sim pmsm_sim"


class MfpccController(PwmNode):
    """The controller as a node.

    While the node is inactive it answers every sample with a command that blocks the gates.

    Parameters
    ----------
    **options
        As of `PwmNode`.
    """

    core: Controller
    hardware_id = "drive controller"

    def __init__(self, **options: Any) -> None:
        super().__init__("mfpcc_controller", TABLE, **options)
        self._told_fallen = False
        # Looks in a row without a new sample, and the latest one there was. They are counted in
        # looks and not by the clock, so that a controller that was itself held up blames nobody.
        self._looks = 0
        self._looked_at = -1
        self._inverter_at_rest = False
        self._overtaken = -1  # period of the latest sample that came too late

    # Life cycle -----------------------------------------------------------------------------

    def configure(self) -> None:
        """Make the controller and the topics."""
        self._feedback = Wire(PhaseFeedback)
        self._command = Wire(DutyCommand)
        self._lut = Wire(LutDiagnostics)
        self._set_budget()
        self._compile()
        self.core = Controller(self.values)
        self._follow_core()
        self._lut.set_string("scheme", self.core.scheme)
        self._decimation: int = self.values["diagnostics_decimation"]
        self.period = -1
        self._command_out = self.create_loop_publisher(DutyCommand, "duty_command")
        self._lut_out = self.create_loop_publisher(LutDiagnostics, "lut_diagnostics")
        self._listeners = Listeners(self, self._command_out, self._lut_out)
        self._feedback_in = self.create_loop_subscription(
            PhaseFeedback, "phase_feedback", self._on_feedback, start=_START_PLANT
        )
        self._reference_in = self.create_subscription(
            DriveReference, "reference", self._on_reference, 10
        )
        self._status = StatusPublisher(self, DriveStatus, DriveFault)
        self._status_in = self.create_subscription(
            DriveStatus,
            "drive_status",
            self._on_status,
            QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL),
        )
        self._stops = Stops(self, "the reference has been at zero")
        self._watchdog = SteadyTimer(self, self._look_for_samples)
        self._watchdog.start(_WATCH_EVERY)
        self._pace_watch = SteadyTimer(self, self._follow_pace)
        self._pace_watch.start(_PACE_EVERY)

    def _compile(self) -> None:
        """Compile the kernel, or load it, before a sample waits for it."""
        compiled.announce(self.get_logger().info)
        trial = Controller(self.values)
        trial.step(self._feedback.fixed, self._command.fixed, self._lut.fixed, True)

    def _begin_anew(self) -> None:
        """Make a controller that has seen nothing yet, but what keeps the gates off still does."""
        before = self.core
        self.core = Controller(self.values)
        if before.slowing or not before.released:
            self.core.inherit_faults(before)
        self._follow_core()

    def _follow_core(self) -> None:
        self.core.bind(self._feedback.fixed, self._command.fixed, self._lut.fixed)
        self.core.enabled = self.active
        self._fallen = self.core.mem["fallen"]
        self._faults = self.core.mem["guard"]["latch"]["faults"]
        self._seen_faults = int(self._faults[0])

    def activate(self) -> None:
        """Enable the inverter from the next command on."""
        self.core.enabled = True
        self.tell_status()

    def deactivate(self) -> None:
        """Block the gates, also if no further sample is answered."""
        self.active = self.core.enabled = False
        if self.period >= 0:
            # what the plant waits for, should this process end now
            self._command.fixed["period"] += 1
            self._command.fixed["enable"] = False
            self._command_out.publish_aside(self._command.to_bytes())
        self.tell_status()

    def cleanup(self) -> None:
        """Remove what is not on the loop."""
        self._listeners.stop()
        self._watchdog.stop()
        self._pace_watch.stop()
        self._stops.destroy()
        self.destroy_subscription(self._status_in)
        self.destroy_subscription(self._reference_in)
        self._status.destroy()

    # The period -----------------------------------------------------------------------------

    def _on_feedback(self, data: bytes) -> None:
        """Answer a sample with the command for the next period."""
        feedback = self._feedback
        try:
            feedback.load(data)
        except WireError as error:
            self.get_logger().error(f"phase_feedback refused: {error}", throttle_duration_sec=1.0)
            return
        k = int(feedback.fixed["period"][0])
        # the very first one is not the next one either: somebody may have to hear its answer
        if (k != self.period + 1 or k == 0) and not self._out_of_turn(k):
            return
        if k >= self.next_change:
            self.apply_due(k)
        core = self.core
        tell = self._decimation > 0 and k % self._decimation == 0
        begin = time.perf_counter_ns()
        core.step(feedback.fixed, self._command.fixed, self._lut.fixed, tell)
        took = time.perf_counter_ns() - begin
        self.step_times.add(took)
        if took > self._budget:
            self._count_overrun(took)
        else:
            self._overruns = 0
        self.period = k
        if self._fallen[0] != self._told_fallen:
            self._tell_fallback()
        self._command_out.publish(self._command.to_bytes())
        if self._faults[0] != self._seen_faults:
            self.tell_status()
        if tell:
            self._lut_out.publish(self._lut.to_bytes())

    def _count_overrun(self, took: int) -> None:
        """Count a step (ns) beyond the budget; too many in a row are a fault of the scheme."""
        self._overruns += 1
        if self._overruns == _OVERRUNS:
            self._overruns = 0
            self.core.overran(took * 1e-3)

    def _set_budget(self) -> None:
        self._budget = self.values["fault.step_budget"] * 1e3 or math.inf  # ns
        self._overruns = 0

    def _out_of_turn(self, k: int) -> bool:
        """Handle a sample that is not the next one, or the first; return whether to answer it."""
        if k == self.period:
            # the plant has not got the answer
            self._command_out.publish_aside(self._command.to_bytes())
            return False
        if self.period < 0 and not self._heard():
            return False
        if 0 < k < self.period < k + _OVERTAKEN and k != self._overtaken:
            # Counted by the controller; it answers only what is newer than what it has seen. But if
            # the plant sends it again, it waits for the answer, and what came before was forged.
            self._overtaken = k
            self.core.step(self._feedback.fixed, self._command.fixed, self._lut.fixed, False)
            return False
        if k < self.period:
            self._begin_anew()
            self.get_logger().info(
                f"the plant began anew (period {self.period}, then {k})"
                + ("; gates off until the faults are cleared" if self.core.tripped else "")
            )
        elif self.period >= 0:
            self.lost_periods += k - self.period - 1
        return True

    def on_stall(self, seconds: float) -> None:
        """Send the last command again: whoever came after it was sent has not got it."""
        if self.period >= 0:
            self._command_out.publish_aside(self._command.to_bytes())

    def _look_for_samples(self) -> None:
        """Disable the inverter if no new sample comes while it is enabled."""
        limit = self.values["fault.feedback_timeout"]
        enabled = self.period >= 0 and self.active and self._command.fixed["enable"][0]
        due = enabled and limit > 0.0 and not self._inverter_at_rest
        if not due or self.period != self._looked_at:
            self._looked_at = self.period
            self._looks = 0
            return
        self._looks += 1
        seconds = self._looks * _WATCH_EVERY
        if seconds < limit:
            return
        self.core.feedback_lost(seconds)
        if self.core.tripped:
            self._command.fixed["enable"] = False
            self._command_out.publish_aside(self._command.to_bytes())
        self.tell_status()

    def _on_status(self, message: DriveStatus) -> None:
        """Hear whether the inverter says of itself that it drives nothing: no sample is due then.

        One that was killed says nothing more, and so is missed.
        """
        if message.node != self.get_name():
            self._inverter_at_rest = message.state != "running"

    def _follow_pace(self) -> None:
        """Wait for nobody who listens if the plant does not wait for this controller either."""
        self.paced = goes_by_itself(self, self._feedback_in.topic)

    def _heard(self) -> bool:
        """Whether everybody is there who must not miss the first answer; else hold the sample."""
        self._follow_pace()
        if self._listeners.there:
            self._listeners.stop()
            return True
        self._listeners.wait(lambda: self._on_feedback(self._feedback.to_bytes()))
        return False

    # References and parameters --------------------------------------------------------------

    def _on_reference(self, message: DriveReference) -> None:
        """Take a reference from outside: it replaces the parameters of the same meaning."""
        if message.control_mode == DriveReference.SPEED:
            changes = {"control_mode": "speed", "speed_ref_rpm": message.speed_rpm}
        else:
            changes = {
                "control_mode": "current",
                "i_d_ref": message.i_d,
                "i_q_ref": message.i_q,
            }
        result = self.set_parameters_atomically(
            [RosParameter(name, value=value) for name, value in changes.items()]
        )
        if not result.successful:
            self.get_logger().warning(
                f"reference refused: {result.reason}", throttle_duration_sec=1.0
            )

    def parameters_changed(self, changes: Mapping[str, Any]) -> None:
        """Follow a change of the scheme, and of the time it may take."""
        if "scheme" in changes or "fault.step_budget" in changes:
            self._set_budget()
        if "scheme" in changes:
            self._lut.set_string("scheme", self.core.scheme)
            self.tell_status()

    # What it tells --------------------------------------------------------------------------

    def diagnostics(self) -> Iterable[Part]:
        """State of the current control."""
        if self.period < 0:
            return
        mem = self.core.mem[0]
        self.tell_status()
        codes = ", ".join(code for code, _, _ in self.core.faults())
        tripped = self.core.tripped
        yield Part(
            "current control",
            f"tripped: {codes or 'STO'}" if tripped else codes or self.core.scheme,
            Level.ERROR if tripped else Level.WARN if codes else Level.OK,
            {
                "i_d (A)": float(mem["i_dq"].real),
                "i_q (A)": float(mem["i_dq"].imag),
                "i_d reference (A)": float(mem["i_dq_ref"].real),
                "i_q reference (A)": float(mem["i_dq_ref"].imag),
                "electrical speed (rad/s)": float(mem["w_m"]),
            },
        )

    def _tell_fallback(self) -> None:
        """Say that the fallback scheme took over, or that its turn is over."""
        self._told_fallen = self.core.fallen
        self._lut.set_string("scheme", self.core.scheme)
        if self.core.fallen:
            details = {code: detail for code, _, detail in self.core.faults()}
            why = self.core.complaint or (
                f"scheme '{self.values['scheme']}' failed in period {self.period}: "
                f"{details.get('SCHEME') or details.get('PREDICTION')}"
            )
            self.get_logger().error(f"{why}; '{self.core.scheme}' took over")
        self.tell_status()

    def tell_status(self) -> None:
        """Publish `drive_status` if it has changed, and say what faults are new."""
        core = self.core
        self._seen_faults = int(self._faults[0])
        state = "ready"
        if core.tripped:
            state = "tripped"
        elif self.active:
            state = "stopping" if core.slowing else "running"
        told = self._status.tell(
            state=state,
            enabled=self.active and bool(core.released),
            faults=core.faults(),
            period=self.period,
            pwm_frequency=float(core.cfg["pwm_frequency"][0]),
            scheme=core.scheme,
        )
        if told:
            self._stops.log()


def main() -> int:
    """Run the node until it is stopped."""
    return spin.main(MfpccController)


if __name__ == "__main__":
    sys.exit(main())
