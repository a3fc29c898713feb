"""Running the processes of a launch file."""

from __future__ import annotations

import contextlib
import os
import queue
import shlex
import signal
import subprocess
import tempfile
import threading
import time
import traceback
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import FrameType
from typing import Any, get_origin

import yaml

from ros2_standin.index import executables
from ros2_standin.launching.actions import Action, Shutdown, load
from ros2_standin.launching.context import LaunchContext, LaunchError, log
from ros2_standin.launching.substitutions import Substitution, Text, text

#: Time from each signal to the next harder one (s).
PATIENCE = 5.0
_ESCALATION = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


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
        self.on_exit = [on_exit] if isinstance(on_exit, Action) else list(on_exit or ())

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
                action=self,
            ),
            context,
        )

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


class Process:
    """
    A running process.

    Parameters
    ----------
    command : list of str
    label : str
        Name in the output, without its number.
    folder : str or None
        Where to run.
    environment : dict
        Added to the environment.
    action : ExecuteProcess
        Whose it is.
    """

    def __init__(
        self,
        command: list[str],
        label: str,
        *,
        folder: str | None,
        environment: dict[str, str],
        action: ExecuteProcess,
    ) -> None:
        self.command = command
        self.label = label
        self.action = action
        self._folder = folder
        self._environment = {**os.environ, **environment}
        self._popen: subprocess.Popen[str] | None = None

    def start(self, ended: queue.Queue[Process]) -> None:
        """Run; put itself into `ended` at the end."""
        try:
            self._popen = subprocess.Popen(
                self.command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                cwd=self._folder,
                env=self._environment,
                # Ctrl-C in the terminal is for the launch, which passes it on once.
                start_new_session=True,
            )
        except OSError as error:
            raise LaunchError(f"{self.command[0]}: {error.strerror}") from None
        log("INFO", self.label, f"process started with pid [{self._popen.pid}]")
        threading.Thread(target=self._watch, args=(ended,), daemon=True).start()

    def _watch(self, ended: queue.Queue[Process]) -> None:
        """Print the output until there is no more."""
        assert self._popen is not None and self._popen.stdout is not None
        for line in self._popen.stdout:
            print(f"[{self.label}] {line.rstrip()}", flush=True)
        self._popen.wait()
        ended.put(self)

    def send(self, kind: signal.Signals) -> None:
        """Send a signal."""
        assert self._popen is not None
        log("INFO", self.label, f"sending signal '{kind.name}' to process[{self.label}]")
        self._popen.send_signal(kind)

    def report(self) -> None:
        """Say how it ended."""
        assert self._popen is not None
        pid, code = self._popen.pid, self._popen.returncode
        if code == 0:
            log("INFO", self.label, f"process has finished cleanly [pid {pid}]")
        else:
            command = " ".join(self.command)
            log(
                "ERROR",
                self.label,
                f"process has died [pid {pid}, exit code {code}, cmd '{command}'].",
            )


class Supervisor:
    """
    Starts processes, and runs until all have ended.

    Parameters
    ----------
    folder : Path
        For parameter files.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.started: list[Process] = []
        self._files = 0
        self._running: list[Process] = []
        self._ended: queue.Queue[Process] = queue.Queue()
        self._stage = 0  # of the escalation
        self._next_stage_at = float("inf")
        self._asked: list[signal.Signals] = []

    def write_parameters(self, content: Any) -> str:
        """Write a parameter file of its own, and return its path."""
        self._files += 1
        path = self.folder / f"launch_params_{self._files}.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return str(path)

    def start(self, process: Process, context: LaunchContext) -> None:
        """Start a process, unless all are being ended."""
        if self._stage or self._asked:
            return
        self.started.append(process)
        process.label += f"-{len(self.started)}"
        process.start(self._ended)
        self._running.append(process)
        self._context = context

    def shut_down(self) -> None:
        """Ask all processes to end."""
        if self._stage == 0:
            self._escalate()

    def ask(self, number: int, frame: FrameType | None) -> None:
        """Note a signal that came; `run` acts on it."""
        self._asked.append(signal.Signals(number))

    def run(self) -> None:
        """Wait until all have ended."""
        while self._running:
            with contextlib.suppress(queue.Empty):
                self._handle(self._ended.get(timeout=0.1))
            while self._asked:
                self._interrupted(self._asked.pop(0))
            if time.monotonic() > self._next_stage_at:
                self._escalate()

    def _interrupted(self, kind: signal.Signals) -> None:
        how = "ctrl-c (SIGINT)" if kind == signal.SIGINT else kind.name
        if self._stage:
            log("WARNING", "launch", f"user interrupted with {how} again, ignoring...")
        else:
            log("WARNING", "launch", f"user interrupted with {how}")
            self.shut_down()

    def _handle(self, process: Process) -> None:
        """A process has ended."""
        self._running.remove(process)
        process.report()
        for action in process.action.on_exit:
            if isinstance(action, Shutdown):
                required = f"process[{process.label}] was required: shutting down launched system"
                log("INFO", "launch", required)
            action.visit(self._context)

    def _escalate(self) -> None:
        """Send the next signal to all that still run."""
        kind = _ESCALATION[min(self._stage, len(_ESCALATION) - 1)]
        for process in reversed(self._running):
            if self._stage:
                before = _ESCALATION[min(self._stage, len(_ESCALATION) - 1) - 1].name
                log(
                    "ERROR",
                    process.label,
                    f"process[{process.label}] failed to terminate '{PATIENCE:g}' seconds after "
                    f"receiving '{before}', escalating to '{kind.name}'",
                )
            process.send(kind)
        self._stage += 1
        self._next_stage_at = time.monotonic() + PATIENCE


def launch(path: Path, arguments: dict[str, str], *, prefix: str = "", debug: bool = False) -> int:
    """
    Run a launch file until all its processes have ended.

    Parameters
    ----------
    path : Path
        The launch file.
    arguments : dict
        Values of its arguments.
    prefix : str
        Command to run every process with.
    debug : bool
        Print the traceback of an error in the launch file.

    Returns
    -------
    int
        1 if the launch file has an error, else 0.
    """
    with tempfile.TemporaryDirectory(prefix="launch_") as folder:
        supervisor = Supervisor(Path(folder))
        context = LaunchContext(arguments, supervisor, shlex.split(prefix))
        kinds = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        before = [signal.signal(kind, supervisor.ask) for kind in kinds]
        code = 0
        try:
            load(path).visit(context)
        except Exception as error:  # noqa: BLE001 (launch files are anybody's code)
            if debug:
                traceback.print_exc()
            log("ERROR", "launch", f"Caught exception in launch (see debug for traceback): {error}")
            code = 1
            supervisor.shut_down()
        finally:
            supervisor.run()
            for kind, handler in zip(kinds, before, strict=True):
                signal.signal(kind, handler)
    return code
