"""The node `/pmsm_sim`: the simulated inverter and motor on the graph.

Lock-step (`real_time_factor` 0): a period begins when its command has come, so a run is the same
bit for bit however slow the machine. Paced: periods follow the wall clock, and a command that is
not there in time is a missed period, which the inverter's policy handles.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Mapping
from typing import Any

from builtin_interfaces.msg import Time
from mfpcc_msgs.msg import DriveFault, DriveState, DriveStatus, DutyCommand, PhaseFeedback
from mfpcc_msgs.srv import InjectFault
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState

from pmsm_sim.parameters import TABLE
from pmsm_sim.parts.injection import InjectionError
from pmsm_sim.plant import OUT_OF_RANGE, WRONG_PERIOD, Plant, advance, latch
from pwm_node import compiled
from pwm_node.lags import Lags
from pwm_node.ros import spin
from pwm_node.ros.diagnostics import Level, Part, lag_values
from pwm_node.ros.node import PwmNode
from pwm_node.ros.pace import Listeners, Pace, SteadyTimer
from pwm_node.ros.status import StatusPublisher
from pwm_node.ros.stops import Stops
from pwm_node.units import RPM
from pwm_node.wire import Wire, WireError

# A fast wall clock begins after so many periods in lock-step. Both sides then look for their
# messages, which they do not before some have come.
_AT_EASE = 100
_AT_ONCE = 1000  # periods without an answer
# A sample is taken within this time (s), or a few more have come: a queue of ten takes them.
_TAKEN_WITHIN = 5e-4
_ROTOR_RATE = 100.0  # Hz of simulated time
# A pace that is kept within this share is kept.
_PACE_KEPT = 0.98
_START_CONTROLLER = "ros2 run mfpcc_controller controller"


class PmsmSim(PwmNode):
    """The plant as a node.

    While the node is active the inverter follows the commands. While it is inactive time goes on
    with blocked gates, and the motor coasts; power returns after a command that has the gates off.

    Parameters
    ----------
    **options
        As of `PwmNode`.
    """

    core: Plant
    hardware_id = "simulated inverter and motor"

    def __init__(self, **options: Any) -> None:
        super().__init__("pmsm_sim", TABLE, **options)
        self._pace = Pace(self, self._on_tick)
        self.paces.append(self._pace)
        self._rest = SteadyTimer(self, self._advance)
        self._told_tick: tuple[float, int] | None = None
        self._round_trips = Lags()
        self._began_at = 0  # ns: the latest period that the wall clock began

    # Life cycle -----------------------------------------------------------------------------

    def configure(self) -> None:
        """Make the plant, at rest before period 0, and the topics."""
        self.core = Plant(self.values)
        n = self.core.oversampling
        self._command = Wire(DutyCommand)
        self._feedback = Wire(PhaseFeedback)
        self._state = Wire(DriveState, i_abc_oversampled=3 * n, legs_oversampled=n)
        self._compile()
        self._decimation: int = self.values["state_decimation"]
        self._periods: int = self.values["periods"]
        self.period = -1
        self._feedback_out = self.create_loop_publisher(PhaseFeedback, "phase_feedback")
        self._state_out = self.create_loop_publisher(DriveState, "drive_state")
        self.paced = self.values["real_time_factor"] > 0.0
        self._command_in = self.create_loop_subscription(
            DutyCommand, "duty_command", self._on_command, start=_START_CONTROLLER
        )
        self._listeners = Listeners(self, self._feedback_out, self._state_out)
        self._rotor_every = max(round(self.values["pwm_frequency"] / _ROTOR_RATE), 1)
        self._clock_out = self.create_publisher(ClockMessage, "/clock", 10)
        self._rotor_out = self.create_publisher(JointState, "joint_states", 10)
        self._status = StatusPublisher(self, DriveStatus, DriveFault)
        self._stops = Stops(self, "a command that has the gates off, and then one that has them on")
        self._faults = self.core.st["latch"]["faults"]
        self._injector = self.core.st["injector"][0]
        self._injects = bool(self.values["fault_injection"])
        self._inject_in = self.create_service(InjectFault, "~/inject_fault", self._on_inject)
        self._seen_faults = 0

    def _compile(self) -> None:
        """Compile the kernels, or load them, before a period waits for them."""
        compiled.announce(self.get_logger().info)
        core, tail = self.core, self._state.tail
        # what the kernel reads and writes in each period
        self._records = (
            core.par,
            core.st,
            self._feedback.fixed,
            self._state.fixed,
            tail["i_abc_oversampled"],
            tail["legs_oversampled"],
        )
        self._latch = compiled.direct(latch, core.st, self._command.fixed)
        self._integrate = compiled.direct(advance, *self._records)

    def activate(self) -> None:
        """Let the commands reach the gates; the first time, begin with period 0."""
        if self.period < 0:
            self._listeners.wait(self._begin)
        self.core.block(False)
        self.tell_status()

    def _begin(self) -> None:
        """Begin with period 0: everybody is there who must not miss its sample."""
        self._advance()

    def deactivate(self) -> None:
        """Block the gates from the next period on."""
        self.active = False
        self.core.block(True)
        self.tell_status()

    def cleanup(self) -> None:
        """Stop the clock of the paced mode."""
        self._pace.stop()
        self._listeners.stop()
        self._rest.stop()
        self._stops.destroy()
        self.destroy_service(self._inject_in)
        self._status.destroy()
        for publisher in (self._clock_out, self._rotor_out):
            self.destroy_publisher(publisher)

    # The period -----------------------------------------------------------------------------

    def _on_command(self, data: bytes) -> None:
        """Take a command; in lock-step it is what the next period waits for."""
        try:
            self._command.load(data)
        except WireError as error:
            self.get_logger().error(f"duty_command refused: {error}", throttle_duration_sec=1.0)
            return
        answer = self._latch(self.core.st, self._command.fixed)
        if answer == WRONG_PERIOD:
            return  # counted; a repeated or a late one changes nothing
        if answer == OUT_OF_RANGE:
            duty = ", ".join(f"{d:g}" for d in self._command.fixed["duty"][0])
            self.get_logger().error(
                f"duty_command of period {self.period + 1} refused: duties [{duty}] are not "
                "within 0..1; the period counts as missing",
                throttle_duration_sec=1.0,
            )
        if self.values["real_time_factor"] > 0.0:
            if self._pace.running:
                if answer != OUT_OF_RANGE:
                    self._round_trips.add(time.perf_counter_ns() - self._began_at)
            elif self.period < _AT_EASE and self._pace.looks(self._seconds_per_period()):
                self._advance()
            else:
                self._set_pace(self.values["real_time_factor"])
        else:
            self._advance()

    def _advance(self) -> None:
        """Run the next period; in lock-step, on to one whose sample can be answered."""
        self._run_period()
        if self._injects:
            self._go_on()

    def _go_on(self) -> None:
        """Run on while no sample can be answered.

        One that reaches the controller all the same, too late, is left to it before the next; and
        now and then others are served.
        """
        for _ in range(_AT_ONCE):
            if not self._unanswered() or self.finished.done():
                self._rest.stop()
                return
            if self._injector["copies"] > 0:
                break
            self._run_period()
        if not self._rest.running:
            self._rest.start(_TAKEN_WITHIN)

    def _run_period(self) -> None:
        """Run the next period and publish its sample."""
        k = self.period + 1
        if k == self._periods and self._periods > 0:
            # the answer to the last sample has come: all is said
            self.awaited = None
            self.period = k
            self.finish()
            return
        if k > self._periods and self._periods > 0:
            return
        if k >= self.next_change:
            self.apply_due(k)
        self._integrate(*self._records)
        self.period = k
        for _ in range(int(self._injector["copies"]) if self._injects else 1):
            self._feedback_out.publish(self._feedback.to_bytes())
        if self._decimation and k % self._decimation == 0:
            self._state_out.publish(self._state.to_bytes())
        if k % self._rotor_every == 0:
            self._tell_others()
        if self._faults[0] != self._seen_faults:
            self.tell_status()

    def _unanswered(self) -> bool:
        """Whether no valid command can follow this sample, by an injected fault of its link."""
        injector = self._injector
        lock_step = self.values["real_time_factor"] == 0.0
        return bool(lock_step and (injector["copies"] == 0 or injector["late"] > 0))

    def _tell_others(self) -> None:
        """Publish the simulated time and the rotor, for nodes that are not on the loop."""
        stamp, state = self._feedback.fixed["stamp"][0], self._state.fixed
        now = Time(sec=int(stamp["sec"]), nanosec=int(stamp["nanosec"]))
        self._clock_out.publish(ClockMessage(clock=now))
        rotor = JointState(
            name=["rotor"],
            position=[float(state["angle"][0])],
            velocity=[float(state["speed"][0])],
            effort=[float(state["torque"][0])],
        )
        rotor.header.stamp = now
        self._rotor_out.publish(rotor)

    def on_stall(self, seconds: float) -> None:
        """Send the last sample again: whoever came after it was sent has not got it."""
        if self.period >= 0:
            self._feedback_out.publish_aside(self._feedback.to_bytes())

    # Paced mode -----------------------------------------------------------------------------

    def parameters_changed(self, changes: Mapping[str, Any]) -> None:
        """Follow a change of the pace."""
        if "real_time_factor" not in changes:
            return
        factor = changes["real_time_factor"]
        self.paced = factor > 0.0
        if self.period < 0:
            return
        self._set_pace(factor or None)
        if not factor and bool(self.core.st["latched"][0]):
            self._advance()  # back in lock-step, and the command for the next period is there

    def _set_pace(self, factor: float | None) -> None:
        self._pace.stop()
        self._told_tick = None
        if factor is not None:
            self._pace.start(self._seconds_per_period())
            self._round_trips = Lags()
            self._began_at = time.perf_counter_ns()
            self._paced_from = self._ticked_at = self._pace.ticked_at, self.period

    def _seconds_per_period(self) -> float:
        """Time of a period by the wall clock (s)."""
        return 1.0 / float(self.values["pwm_frequency"] * self.values["real_time_factor"])

    def _on_tick(self) -> None:
        """Begin a period, whether or not its command is there."""
        self._began_at = time.perf_counter_ns()
        self._advance()
        self._ticked_at = self._pace.ticked_at, self.period
        self.missed_periods = int(self.core.st["missed"][0])

    @property
    def pace(self) -> dict[str, float] | None:
        """The `real_time_factor` asked for, and the one achieved since; None in lock-step."""
        if not self._pace.running:
            return None
        return {
            "asked": self.values["real_time_factor"],
            "achieved": self._factor(self._paced_from, self._ticked_at),
        }

    @property
    def periods_left_out(self) -> int:
        """Periods of the wall clock that went by while this process had no core."""
        return self._pace.left_out

    @property
    def lags(self) -> dict[str, Lags] | None:
        """How late each period began, and when in it its command was there; None in lock-step."""
        if not self._pace.running:
            return None
        return {"start": self._pace.lags, "round_trip": self._round_trips}

    def _factor(self, begin: tuple[float, int], end: tuple[float, int]) -> float:
        """Simulated time over the clock's, between two ticks: when, and which period."""
        simulated = (end[1] - begin[1]) / self.values["pwm_frequency"]
        passed = end[0] - begin[0]
        return float(simulated / passed if passed > 0.0 else self.values["real_time_factor"])

    def _pace_part(self) -> Part:
        """Tell whether the pace was kept since this was told last."""
        begin, self._told_tick = self._told_tick or self._paced_from, self._ticked_at
        asked, achieved = self.values["real_time_factor"], self._factor(begin, self._ticked_at)
        kept = achieved >= _PACE_KEPT * asked
        return Part(
            "pace",
            "kept" if kept else f"falls behind: {achieved:.3g} achieved of {asked:.3g}",
            Level.OK if kept else Level.WARN,
            {
                "real-time factor asked for": asked,
                "real-time factor achieved": achieved,
                "missed periods": self.missed_periods,
                **lag_values("start late by", self._pace.lags),
                **lag_values("round trip", self._round_trips),
            },
        )

    # Injected faults ------------------------------------------------------------------------

    def _on_inject(
        self, request: InjectFault.Request, response: InjectFault.Response
    ) -> InjectFault.Response:
        """Inject a fault; a request without one asks what is injected."""
        response.success = True
        if request == InjectFault.Request():
            response.message = "nothing is injected by this request"
        else:
            try:
                line = self.core.inject(
                    request.unit,
                    request.type,
                    request.start,
                    request.duration,
                    request.magnitude or None,
                    seed=request.seed,
                )
                response.message = f"injected: {line}"
                self.get_logger().warning(f"fault injected: {line}")
            except InjectionError as error:
                response.success = False
                response.message = f"refused: {error}"
                self.get_logger().error(f"no fault injected: {error}")
        response.injections = self.core.injections()
        return response

    # What it tells --------------------------------------------------------------------------

    def diagnostics(self) -> Iterable[Part]:
        """State of the inverter."""
        if self.period < 0:
            return
        self.tell_status()
        st, tripped = self.core.st[0], self.core.tripped
        codes = ", ".join(code for code, _, _ in self.core.faults()) or "STO"
        yield Part(
            "inverter",
            f"tripped: {codes}" if tripped else "gates on" if st["gates_on"] else "gates off",
            Level.ERROR if tripped else Level.OK,
            {
                "missed commands": int(st["missed"]),
                "refused commands": int(st["refused"]),
                "periods left out (wall clock)": self.periods_left_out,
                "speed (r/min)": float(st["w_M"]) / RPM,
                "load torque (N m)": self.values["load_torque"],
            },
        )
        if self._pace.running:
            yield self._pace_part()
        if self._injects:
            lines = self.core.injections()
            yield Part(
                "injected faults",
                "; ".join(lines) or "none",
                Level.WARN if lines else Level.OK,
            )

    def tell_status(self) -> None:
        """Publish `drive_status` if it has changed, and say what faults are new."""
        core = self.core
        self._seen_faults = int(self._faults[0])
        told = self._status.tell(
            state="tripped" if core.tripped else "running" if self.active else "ready",
            enabled=bool(core.st["gates_on"][0]),
            faults=core.faults(),
            period=self.period,
            pwm_frequency=float(core.par["pwm_frequency"][0]),
        )
        if told:
            self._stops.log()


def main() -> int:
    """Run the node until it is stopped."""
    return spin.main(PmsmSim)


if __name__ == "__main__":
    sys.exit(main())
