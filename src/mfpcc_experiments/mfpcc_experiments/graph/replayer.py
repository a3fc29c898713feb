"""The node `/replayer`: the samples of a bag back onto the graph, for a live controller to answer.

Lock-step (`rate` 0, the default): sample k + 1 is published when the command for period k + 1 has
come, so a replay is the same each time, however slow the machine. Paced: samples follow the wall
clock at `rate` times the recorded speed, and an answer that is not there by then is counted as
missed.

The loop is open: the recorded samples do not follow the commands. A controller with the recorded
parameters (`--parameters FILE` writes them down for it) answers with the recorded commands, and the
node says whether it did. Any other one believes that its own commands acted, which they did not, so
its predictions are off; to compare schemes on the same samples use ``mfpcc replay``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rclpy.utilities
import yaml
from mfpcc_msgs.msg import DriveState, DutyCommand, PhaseFeedback

from mfpcc_experiments.bags import BagError, Recording, recording
from mfpcc_experiments.files import write_whole
from pwm_node import bits
from pwm_node.parameters import Parameter, Table
from pwm_node.ros import spin
from pwm_node.ros.diagnostics import Part
from pwm_node.ros.loop_topics import LoopPublisher
from pwm_node.ros.node import PwmNode
from pwm_node.ros.pace import Listeners, Pace
from pwm_node.wire import HEADER, Wire, WireError, fixed_size

_START_CONTROLLER = "ros2 run mfpcc_controller controller"

TABLE = Table(
    [
        Parameter(
            "rate",
            0.0,
            "Speed of the replay divided by that of the recording; 0: as fast as the answers come",
            minimum=0.0,
            maximum=1e3,
        ),
        Parameter(
            "patience",
            0.0,
            "How long to wait for an answer before giving up; 0: for ever",
            unit="s",
            minimum=0.0,
            maximum=1e6,
        ),
        Parameter(
            "recorders",
            0,
            "Number of recorders to wait for before the first sample, besides the controller",
            minimum=0,
            maximum=100,
            read_only=True,
        ),
    ]
)


class Replayer(PwmNode):
    """Publishes recorded samples in their order, and compares the answers with the recorded ones.

    Parameters
    ----------
    bag : Recording
        What is replayed; the states of the plant are published too, where it has them.
    **options
        As of `PwmNode`.

    Attributes
    ----------
    sent : int
        Samples published.
    answers : int
        Samples that were answered.
    compared, equal : int
        Answers that stand beside a recorded command, and those that are equal to it, bit for bit.
    first_difference : int or None
        First period whose command is not the recorded one.
    """

    hardware_id = "recording"

    def __init__(self, bag: Recording, **options: Any) -> None:
        super().__init__("replayer", TABLE, **options)
        self.sent = self.answers = self.compared = self.equal = 0
        self.first_difference: int | None = None
        self.gave_up = False
        self._bag = bag
        self._period = bag.feedback["period"].astype(np.int64).tolist()
        self._samples = _Messages(PhaseFeedback, bag.feedback)
        self._commands = _Messages(DutyCommand, bag.command)
        wanted, there = bag.feedback["period"] + 1, bag.command["period"]
        row = np.where(np.isin(wanted, there), np.searchsorted(there, wanted), -1)
        self._answer_row = row.tolist()  # of the recorded commands; -1: none
        self._pace = Pace(self, self._on_tick)
        self.paces.append(self._pace)

    # Life cycle -----------------------------------------------------------------------------

    def configure(self) -> None:
        """Make the topics."""
        n = self._bag.oversampling
        legs = 0 if self._bag.legs_oversampled is None else n
        self._state = Wire(DriveState, i_abc_oversampled=3 * n, legs_oversampled=legs)
        self._state_row = 0
        self._command = Wire(DutyCommand)
        self._next = self._answered = 0  # rows of the samples
        self.period = -1
        self._feedback_out = self.create_loop_publisher(PhaseFeedback, "phase_feedback")
        self._state_out = (
            self.create_loop_publisher(DriveState, "drive_state") if len(self._bag.state) else None
        )
        self.paced = self.values["rate"] > 0.0
        others = () if self._state_out is None else (self._state_out,)
        self._listeners = Listeners(self, self._feedback_out, *others)
        self._command_in = self.create_loop_subscription(
            DutyCommand, "duty_command", self._on_command, start=_START_CONTROLLER
        )

    def activate(self) -> None:
        """Begin, or go on, once everybody is there who must not miss the first sample."""
        self._listeners.wait(self._begin)

    def _begin(self) -> None:
        if not self._waiting:
            self._publish_next()  # the pace begins with the answer

    def deactivate(self) -> None:
        """Hold."""
        self._listeners.stop()
        self._pace.stop()

    def cleanup(self) -> None:
        """Nothing but the topics of the loop was made."""

    # The period -----------------------------------------------------------------------------

    def _publish_next(self) -> None:
        """Publish the next sample, and the state of the plant of its period."""
        row = self._next
        self._next = row + 1
        self.period = self._period[row]
        self.sent += 1
        self._feedback_out.publish(self._samples[row])
        if self._state_out is not None:
            self._publish_states(self._state_out)

    @property
    def _waiting(self) -> bool:
        """Whether the last sample is not answered yet."""
        return self._answered < self._next

    def _publish_states(self, out: LoopPublisher) -> None:
        """Publish the states up to this period; the topic may be decimated."""
        bag, wire, period = self._bag, self._state, self._bag.state["period"]
        while self._state_row < len(period) and period[self._state_row] <= self.period:
            row = self._state_row
            for name in bag.state.dtype.names or ():
                wire.fixed[name][0] = bag.state[name][row]
            if bag.i_abc_oversampled is not None:
                wire.tail["i_abc_oversampled"][:] = bag.i_abc_oversampled[row].ravel()
            if bag.legs_oversampled is not None:
                wire.tail["legs_oversampled"][:] = bag.legs_oversampled[row]
            out.publish(wire.to_bytes())
            self._state_row += 1

    def _on_command(self, data: bytes) -> None:
        """Take an answer; what was taken before changes nothing."""
        try:
            self._command.load(data)
        except WireError as error:
            self.get_logger().error(f"duty_command refused: {error}", throttle_duration_sec=1.0)
            return
        sample = int(self._command.fixed["period"][0]) - 1
        row = self._answered
        while row < self._next and self._period[row] < sample:
            row += 1  # the controller has missed samples
        if row == self._next or self._period[row] != sample:
            return
        self._answered = row + 1
        self.answers += 1
        self._compare(row)
        if self._waiting or self._listeners.awaited or not self.active:
            return
        if self._next == len(self._period):
            self.awaited = None
            self._set_pace(0.0)
            self.finish()
        elif not self._pace.running and self.values["rate"]:
            self._set_pace(self.values["rate"])
        elif not self._pace.running:
            self._publish_next()

    def _compare(self, row: int) -> None:
        """Hold an answer against the recorded one."""
        answer = self._answer_row[row]
        if answer < 0:
            return
        self.compared += 1
        if self._command.to_bytes() == self._commands[answer]:
            self.equal += 1
        elif self.first_difference is None:
            self.first_difference = self._period[row] + 1

    def on_stall(self, seconds: float) -> None:
        """Send the last sample again to a controller that came after it was sent, or give up."""
        if 0.0 < self.values["patience"] <= seconds:
            self.gave_up = True
            self.get_logger().error(
                f"no answer to the sample of period {max(self.period, 0)} for {seconds:.1f} s: "
                f"giving up; start a controller with '{_START_CONTROLLER}'"
            )
            self.finish()
        elif self._waiting:
            self._feedback_out.publish_aside(self._samples[self._next - 1])

    # Paced mode -----------------------------------------------------------------------------

    def parameters_changed(self, changes: Mapping[str, Any]) -> None:
        """Follow a change of the pace."""
        if "rate" not in changes:
            return
        self.paced = changes["rate"] > 0.0
        if not self._pace.running:
            return  # the next answer sees to it
        self._set_pace(changes["rate"])
        if not changes["rate"] and not self._waiting:
            self._publish_next()

    def _set_pace(self, rate: float) -> None:
        self._pace.stop()
        if rate > 0.0:
            self._pace.start(self._bag.T_s / rate)

    def _on_tick(self) -> None:
        """Publish a sample, whether or not the one before it was answered."""
        if self._waiting:
            self.missed_periods += 1
        if self._next < len(self._period):
            self._publish_next()
        else:
            self._set_pace(0.0)  # nothing is left but the last answer

    # What it tells --------------------------------------------------------------------------

    def diagnostics(self) -> Iterable[Part]:
        """How far it is."""
        yield Part(
            "replay",
            f"{self.sent} of {len(self._period)} samples",
            values={
                "answered": self.answers,
                "equal to the recorded command": self.equal,
                "periods left out (wall clock)": self._pace.left_out,
            },
        )

    @property
    def result(self) -> str:
        """What came of it, in a sentence."""
        text = f"{self.sent} of {len(self._period)} samples replayed, {self.answers} answered"
        if self.missed_periods:
            text += f", {self.missed_periods} not in time"
        if not self.answers:
            return text
        if not self.compared:
            return f"{text}; no recorded commands to compare with"
        if self.equal == self.compared:
            return f"{text}; all {self.equal} commands equal the recorded ones"
        return (
            f"{text}; {self.compared - self.equal} of {self.compared} commands are not the "
            f"recorded ones, first that of period {self.first_difference}"
        )


class _Messages:
    """Recorded messages of fixed layout, serialized again."""

    def __init__(self, msg_class: Any, rows: Any) -> None:
        self._stride = rows.dtype.itemsize
        self._size = fixed_size(msg_class)
        self._bytes = bits.with_clean_gaps(rows).view(np.uint8).data

    def __getitem__(self, row: int) -> bytes:
        begin = row * self._stride
        return HEADER + bytes(self._bytes[begin : begin + self._size])


# --- The executable -----------------------------------------------------------------------------


def _arguments(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="replay", description="Replay the samples of a recording to a live controller."
    )
    parser.add_argument("bag", type=Path, help="folder of a recording, or its .mcap file")
    parser.add_argument(
        "--rate",
        type=float,
        default=0.0,
        help="speed over that of the recording; 0 (default): as fast as the answers come",
    )
    parser.add_argument(
        "--patience",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="give up when no answer comes for so long; 0 (default): never",
    )
    parser.add_argument("--namespace", help="which axis, where the recording holds several")
    parser.add_argument(
        "--parameters",
        type=Path,
        metavar="FILE",
        help="only write the recorded parameters of the controller to FILE, for "
        "'ros2 run mfpcc_controller controller --ros-args --params-file FILE'",
    )
    return parser.parse_args(argv)


def write_parameters(bag: Recording, path: Path) -> None:
    """
    Write the recorded parameters of the controller as a ROS parameter file.

    Parameters
    ----------
    bag : Recording
        The recording.
    path : Path
        File; replaced if it is there.
    """
    values = bag.config.get("parameters", {}).get("mfpcc_controller")
    if not isinstance(values, dict):
        raise BagError(f"{bag.path}: no parameters are stored in it")
    # An empty list has no type in ROS, and is the default.
    given = {name: value for name, value in values.items() if value != []}
    write_whole(path, yaml.safe_dump({"/**": {"ros__parameters": given}}, sort_keys=False))


def main() -> int:
    """Replay a recording once."""
    arguments = _arguments(rclpy.utilities.remove_ros_args(sys.argv)[1:])
    try:
        bag = recording.read(arguments.bag, namespace=arguments.namespace)
        for note in bag.notes:
            print(f"{note.severity}: {note}", file=sys.stderr)
        if arguments.parameters is not None:
            write_parameters(bag, arguments.parameters)
            return 0
    except (BagError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    replayer: Replayer | None = None

    def make() -> Replayer:
        nonlocal replayer
        overrides = [
            rclpy.Parameter(name, value=value)
            for name, value in (("rate", arguments.rate), ("patience", arguments.patience))
            if value
        ]
        replayer = Replayer(bag, parameter_overrides=overrides)
        return replayer

    code = spin.main(make)
    if replayer is None:
        return code
    print(replayer.result, flush=True)
    return 1 if replayer.gave_up else code


if __name__ == "__main__":
    sys.exit(main())
