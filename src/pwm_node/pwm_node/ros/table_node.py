"""A life-cycle node whose parameters are a table: how they are given, changed and scheduled."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter as RosParameter

from pwm_node import names, schedule
from pwm_node.parameters import ParameterError, Table, Value
from pwm_node.ros import ros_parameters

_NEVER = 1 << 63
CHANGES_KEPT = 10_000


class Core(Protocol):
    """The part of a node that knows nothing of ROS."""

    def apply(self, changes: Mapping[str, Value]) -> None:
        """Take over changed parameters, between two periods."""


class TableNode(LifecycleNode):
    """A life-cycle node that checks each change of its parameters by a table.

    Attributes
    ----------
    table : Table
        Its parameters.
    values : dict
        All parameter values.
    core : Core, optional
        Told of changed parameters, once it is set.
    period : int
        Number of the latest period; the subclass counts.
    changes : deque of dict
        The latest changes of parameters since the start (period, name, value, and what it `was`
        before), the scheduled ones too.
    next_change : int
        Period in which `apply_due` has something to do.
    """

    core: Core | None = None
    table: Table
    values: dict[str, Any]

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.period = -1
        self.changes: deque[dict[str, Any]] = deque(maxlen=CHANGES_KEPT)
        self.next_change = _NEVER

    def declare(self, table: Table, also_known: Iterable[str] = ()) -> None:
        """Declare the parameters of a table, with the values given at start.

        Parameters
        ----------
        table : Table
            The parameters. If it has a `schedule`, it has a `pwm_frequency` too.
        also_known : iterable of str
            Names of parameters that may be given at start although they are another node's.

        Raises
        ------
        ParameterError, ScheduleError
            If what was given cannot be accepted.
        """
        self.table = table
        known = set(also_known)
        # rclpy has no public way to see what was given for parameters before they are declared.
        given = self._parameter_overrides
        shared = ros_parameters.shared_names(sys.argv)
        changes: dict[str, Any] = {}
        ignored = []
        for name, parameter in given.items():
            if name in self.table:
                changes[name] = ros_parameters.from_ros(self.table[name], parameter.value)
            elif self.has_parameter(name) or name in known or name.startswith("qos_overrides."):
                pass  # somebody else's
            elif name in shared:
                ignored.append(name)
            else:
                raise self.table.unknown(name)
        if ignored:
            self._tell_ignored(ignored, shared)
        values = self.table.complete(changes)
        for name, parameter in self.table.items():
            self.declare_parameter(
                name,
                ros_parameters.to_ros(parameter, values[name]).value,
                ros_parameters.descriptor(parameter),
                ignore_override=True,
            )
        self.add_on_set_parameters_callback(self._on_set)
        self.add_post_set_parameters_callback(self._post_set)
        self.values = values
        self._schedule = self._read_schedule()
        self.next_change = self._schedule[0][0] if self._schedule else _NEVER

    def _tell_ignored(self, ignored: Sequence[str], files: Mapping[str, str]) -> None:
        """Say which parameters given to whoever has them this node has not: one may be misspelt."""
        told = []
        for name in ignored:
            near = names.nearest(name, self.table)
            told.append(f"{name} (did you mean {near}?)" if near else name)
        places = ", ".join(sorted({files[name] for name in ignored}))
        self.get_logger().warning(f"{places}: parameters of others, ignored: {', '.join(told)}")

    def set_parameters(self, parameter_list: list[RosParameter]) -> list[SetParametersResult]:
        """Set parameters one by one."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[RosParameter]) -> SetParametersResult:
        """Set parameters together; all requests from outside come through here.

        The table goes first, since it tells more than rclpy's own checks, and takes 5 for 5.0.
        """
        try:
            accepted = self._validate(parameter_list)
            for parameter in parameter_list:
                if parameter.name not in self.table and not self.has_parameter(parameter.name):
                    raise self.table.unknown(parameter.name)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=error.reason)
        return super().set_parameters_atomically(
            [
                ros_parameters.to_ros(self.table[parameter.name], accepted[parameter.name])
                if parameter.name in accepted
                else parameter
                for parameter in parameter_list
            ]
        )

    def _validate(self, parameters: Sequence[RosParameter]) -> dict[str, Value]:
        """Check changes; parameters that are rclpy's own (use_sim_time) are not in the table."""
        changes = {
            parameter.name: ros_parameters.from_ros(self.table[parameter.name], parameter.value)
            for parameter in parameters
            if parameter.name in self.table
        }
        return self.table.validate(changes, self.values)

    def _on_set(self, parameters: list[RosParameter]) -> SetParametersResult:
        try:
            self._validate(parameters)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=error.reason)
        return SetParametersResult(successful=True)

    def _post_set(self, parameters: list[RosParameter]) -> None:
        # Callbacks run one after the other, so this is between two periods.
        changes = self._validate(parameters)
        for name, value in changes.items():
            change = {"name": name, "value": value, "was": self.values[name]}
            self.changes.append({"period": self.period + 1, **change})
        self.values.update(changes)
        if changes and self.core is not None:
            self.core.apply(changes)
            self.parameters_changed(changes)

    def parameters_changed(self, changes: Mapping[str, Value]) -> None:
        """Follow changes that concern the node itself; called after the core was told."""

    def _read_schedule(self) -> list[tuple[int, schedule.Changes]]:
        if "schedule" not in self.table:
            return []
        entries: Any = self.values["schedule"]
        frequency: Any = self.values["pwm_frequency"]
        return schedule.parse(entries, self.table, 1.0 / frequency, self.values)

    def apply_due(self, period: int) -> None:
        """Apply the scheduled changes up to a period: call it if ``period >= next_change``."""
        while self._schedule and self._schedule[0][0] <= period:
            due, changes = self._schedule.pop(0)
            result = self.set_parameters_atomically(
                [ros_parameters.to_ros(self.table[name], value) for name, value in changes.items()]
            )
            if not result.successful:
                # A change from outside can stand against a rule across parameters.
                self.get_logger().error(f"scheduled change of period {due}: {result.reason}")
        self.next_change = self._schedule[0][0] if self._schedule else _NEVER
