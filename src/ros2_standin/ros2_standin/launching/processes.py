"""Actions of a launch file that run processes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, get_origin

import yaml

from ros2_standin.index import executables
from ros2_standin.launching.actions import Action, Shutdown
from ros2_standin.launching.context import LaunchContext
from ros2_standin.launching.output import LaunchError, log
from ros2_standin.launching.substitutions import Substitution, Text, text
from ros2_standin.launching.supervisor import Process


class ExecuteProcess(Action):
    """
    A process.

    Parameters
    ----------
    cmd : iterable of text
        The executable and its arguments.
    name : text, optional
        Name in the output; that of the executable if not given.
    cwd : text, optional
        Folder to run in.
    additional_env : dict, optional
        Added to the environment.
    output : str
        Accepted: all output goes to the screen.
    on_exit : Action or list of Action, optional
        Done when the process has ended.
    """

    def __init__(
        self,
        *,
        cmd: Iterable[Text],
        name: Text | None = None,
        cwd: Text | None = None,
        additional_env: Mapping[Text, Text] | None = None,
        output: Any = "log",
        on_exit: Action | list[Action] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self._cmd = list(cmd)
        self._label = name
        self._cwd = cwd
        self._environment = dict(additional_env or {})
        self._on_exit = [on_exit] if isinstance(on_exit, Action) else list(on_exit or ())

    def execute(self, context: LaunchContext) -> None:
        environment = {
            text(name, context): text(value, context) for name, value in self._environment.items()
        }
        command = self.command(context)
        label = text(self._label, context) if self._label is not None else Path(command[0]).name
        context.supervisor.start(
            Process(
                [*context.prefix, *command],
                label,
                folder=None if self._cwd is None else text(self._cwd, context),
                environment=environment,
                on_exit=partial(self._ended, context),
            )
        )

    def _ended(self, context: LaunchContext, label: str) -> None:
        """Do what is to be done at the end of the process."""
        for action in self._on_exit:
            if isinstance(action, Shutdown):
                required = f"process[{label}] was required: shutting down launched system"
                log("INFO", "launch", required)
            action.visit(context)

    def command(self, context: LaunchContext) -> list[str]:
        """Return the command line."""
        return [text(part, context) for part in self._cmd]


class Node(ExecuteProcess):
    """
    A ROS node, or several in one process.

    Parameters
    ----------
    package, executable : text
        As of ``ros2 run``.
    name, namespace : text, optional
        Of the node.
    parameters : iterable, optional
        Parameter files, and dicts of values.
    remappings : iterable of pairs, optional
        Names, and what they are to be instead.
    arguments, ros_arguments : iterable of text, optional
        Arguments, and those after ``--ros-args``.
    exec_name : text, optional
        Name in the output.
    """

    def __init__(
        self,
        *,
        package: Text,
        executable: Text,
        name: Text | None = None,
        namespace: Text | None = None,
        exec_name: Text | None = None,
        parameters: Iterable[Any] | None = None,
        remappings: Iterable[tuple[Text, Text]] | None = None,
        arguments: Iterable[Text] | None = None,
        ros_arguments: Iterable[Text] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(cmd=[], name=exec_name, **options)
        self._package = package
        self._executable = executable
        self._node_name = name
        self._namespace = namespace
        self._parameters = list(parameters or ())
        self._remappings = list(remappings or ())
        self._arguments = list(arguments or ())
        self._ros_arguments = list(ros_arguments or ())

    def command(self, context: LaunchContext) -> list[str]:
        ros_args = [text(argument, context) for argument in self._ros_arguments]
        if self._node_name is not None:
            ros_args += ["-r", f"__node:={text(self._node_name, context)}"]
        if self._namespace is not None:
            namespace = text(self._namespace, context)
            ros_args += ["-r", f"__ns:=/{namespace.strip('/')}"]
        for item in self._parameters:
            ros_args += ["--params-file", self._parameter_file(item, context)]
        for old, new in self._remappings:
            ros_args += ["-r", f"{text(old, context)}:={text(new, context)}"]
        arguments = [text(argument, context) for argument in self._arguments]
        return [self._path(context), *arguments, "--ros-args", *ros_args]

    def _path(self, context: LaunchContext) -> str:
        package, name = text(self._package, context), text(self._executable, context)
        try:
            found = [path for path in executables(package) if path.name == name]
        except RuntimeError:
            raise LaunchError(f"package '{package}' not found") from None
        if not found:
            raise LaunchError(f"executable '{name}' not found in package '{package}'")
        return str(found[0])

    def _parameter_file(self, item: Any, context: LaunchContext) -> str:
        """Return the path of a parameter file; one with the values of a dict is written."""
        if not isinstance(item, Mapping):
            return text(item, context)
        values = {text(name, context): _value(value, context) for name, value in item.items()}
        return context.supervisor.write_parameters({"/**": {"ros__parameters": values}})


class ParameterValue:
    """
    The value of a parameter, with its type.

    Parameters
    ----------
    value : object
        The value, or a text that is known only when the launch file runs.
    value_type : type, optional
        `bool`, `int`, `float`, `str` or a list of these; YAML decides where it is not given.
    """

    def __init__(self, value: Any, *, value_type: Any = None) -> None:
        self._value = value
        self._type = value_type

    def evaluate(self, context: LaunchContext) -> Any:
        """Return the value."""
        value = self._value
        if isinstance(value, Substitution) or self._type is str:
            value = text(value, context)
            if self._type is str:
                return value
            value = _from_yaml(value)
        if self._type is float and type(value) is int:
            value = float(value)
        wanted = get_origin(self._type) or self._type
        if wanted is not None and type(value) is not wanted:
            raise LaunchError(f"the parameter value {value!r} is no {wanted.__name__}")
        return value


def _value(value: Any, context: LaunchContext) -> Any:
    """Return the value of a parameter.

    As in the real launch, a plain text stays what it is, and one that is known only when the launch
    file runs says in YAML what type it is.
    """
    if isinstance(value, ParameterValue):
        return value.evaluate(context)
    if isinstance(value, Substitution):
        return _from_yaml(text(value, context))
    if isinstance(value, Mapping):
        return {text(name, context): _value(inner, context) for name, inner in value.items()}
    if isinstance(value, (list, tuple)):
        if any(isinstance(part, Substitution) for part in value) and all(
            isinstance(part, (str, Substitution)) for part in value
        ):
            return _from_yaml(text(value, context))  # one text of several parts
        values = [_value(part, context) for part in value]
        if {type(part) for part in values} == {int, float}:
            return [float(part) for part in values]
        return values
    return value


def _from_yaml(given: str) -> Any:
    try:
        value = yaml.safe_load(given) if given else ""
    except yaml.YAMLError:
        value = None
    if not isinstance(value, (bool, int, float, str, list)):
        raise LaunchError(
            f"the parameter value '{given}' is in YAML nothing that a parameter can be; if it is "
            "meant to be a text, wrap it in launch_ros.parameter_descriptions.ParameterValue"
            "(value, value_type=str)"
        )
    return value
