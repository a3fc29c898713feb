"""Two small nodes in lock-step, shaped like a drive: what a node makes of `pwm_node`.

Run as a program: ``toy.py both|ping|pong [--ros-args ...]``.
"""

import sys

from mfpcc_msgs.msg import DutyCommand, PhaseFeedback

from pwm_node.parameters import Parameter, Table
from pwm_node.ros.diagnostics import Part
from pwm_node.ros.node import PwmNode
from pwm_node.ros.spin import main
from pwm_node.wire import Wire

COMMON = [
    Parameter("pwm_frequency", 10_000.0, "PWM frequency", unit="Hz", minimum=1.0, read_only=True),
    Parameter("schedule", [], "Changes at given times", read_only=True),
]
PING = Table(
    [
        Parameter("load", 0.0, "Load torque", unit="N m", minimum=-20.0, maximum=20.0),
        Parameter("limit", 15.0, "Largest load", unit="N m", minimum=0.0),
        Parameter("count", 3, "How many", minimum=1, maximum=9),
        Parameter("periods", 0, "End after so many periods; 0: never", minimum=0, read_only=True),
        *COMMON,
    ],
    check=lambda v: "'load' must not exceed 'limit'" if v["load"] > v["limit"] else None,
)
PONG = Table(
    [
        Parameter("scheme", "one", "Who controls", choices=("one", "two")),
        Parameter("fail_at", -1, "Raise in this period; -1: never"),
        *COMMON,
    ]
)


class Log:
    """A core that remembers what it was told."""

    def __init__(self, values):
        self.values = dict(values)
        self.applied = []

    def apply(self, changes):
        self.applied.append(dict(changes))
        self.values.update(changes)


class Ping(PwmNode):
    """The plant's part: publishes sample k, waits for the command of period k + 1."""

    def __init__(self, **options):
        super().__init__("ping", PING, also_known=PONG, **options)
        self.sample = Wire(PhaseFeedback)
        self.command = Wire(DutyCommand)
        self.refused = 0
        self.loads = {}

    def configure(self):
        self.core = Log(self.values)
        self.out = self.create_loop_publisher(PhaseFeedback, "phase_feedback")
        self.create_loop_subscription(DutyCommand, "duty_command", self.on_command, start="pong")

    def activate(self):
        self._begin(self.period + 1)

    def _begin(self, period):
        self.period = period
        if period >= self.next_change:
            self.apply_due(period)
            self.loads[period] = self.core.values["load"]
        self.sample.fixed["period"] = period
        self.out.publish(self.sample.to_bytes())

    def diagnostics(self):
        return [Part("load", "", values={"load": self.core.values["load"]})] if self.active else []

    def on_command(self, data):
        self.command.load(data)
        if not self.active or self.awaited is None:
            return
        if self.command.fixed["period"][0] != self.period + 1:
            self.refused += 1
            return
        if self.period + 1 == self.values["periods"]:
            self.awaited = None
            print(f"done {self.period + 1}", flush=True)
            return
        self._begin(self.period + 1)

    def on_stall(self, seconds):
        if self.period >= 0:
            self.out.publish(self.sample.to_bytes())


class Pong(PwmNode):
    """The controller's part: answers sample k with the command for period k + 1."""

    def __init__(self, **options):
        super().__init__("pong", PONG, also_known=PING, **options)
        self.sample = Wire(PhaseFeedback)
        self.command = Wire(DutyCommand)

    def configure(self):
        self.core = Log(self.values)
        self.out = self.create_loop_publisher(DutyCommand, "duty_command")
        self.create_loop_subscription(PhaseFeedback, "phase_feedback", self.on_sample, start="ping")

    def on_sample(self, data):
        self.sample.load(data)
        self.period = int(self.sample.fixed["period"][0])
        if self.period == self.values["fail_at"]:
            raise RuntimeError("asked to fail")
        self.command.fixed["period"] = self.period + 1
        self.out.publish(self.command.to_bytes())

    def activate(self):
        print("pong ready", flush=True)

    def deactivate(self):
        print("pong at rest", flush=True)

    def on_stall(self, seconds):
        if self.period >= 0:
            self.out.publish(self.command.to_bytes())


if __name__ == "__main__":
    factories = {"ping": [Ping], "pong": [Pong], "both": [Ping, Pong]}[sys.argv[1]]
    sys.exit(main(*factories))
