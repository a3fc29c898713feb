"""Actions of a launch file, but for those that run processes."""

from __future__ import annotations

import importlib.util
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from ros2_standin.launching.context import LaunchContext
from ros2_standin.launching.output import LaunchError, log
from ros2_standin.launching.substitutions import Text, text


class Condition:
    """
    Decides whether an action is done.

    Parameters
    ----------
    predicate_expression : text
        ``true``, ``1``, ``false`` or ``0``.
    """

    wanted = True

    def __init__(self, predicate_expression: Text) -> None:
        self._expression = predicate_expression

    def holds(self, context: LaunchContext) -> bool:
        """Evaluate the expression."""
        value = text(self._expression, context).strip().lower()
        if value not in ("true", "1", "false", "0"):
            raise LaunchError(f"'{value}' is neither true nor false")
        return (value in ("true", "1")) == self.wanted


class IfCondition(Condition):
    """Holds if the expression is true."""


class UnlessCondition(Condition):
    """Holds if the expression is false."""

    wanted = False


class Action(ABC):
    """
    A step of a launch file.

    Parameters
    ----------
    condition : Condition, optional
        The step is done only if it holds.
    """

    def __init__(self, *, condition: Condition | None = None) -> None:
        self._condition = condition

    def visit(self, context: LaunchContext) -> None:
        """Do the step, if its condition holds."""
        if self._condition is None or self._condition.holds(context):
            self.execute(context)

    @abstractmethod
    def execute(self, context: LaunchContext) -> None:
        """Do the step."""

    def inner(self) -> Iterable[Action]:
        """Return the steps in this one, as far as they are known before it is done."""
        return ()


class LaunchDescription(Action):
    """
    Steps, one after the other.

    Parameters
    ----------
    initial_entities : iterable of Action
    """

    def __init__(self, initial_entities: Iterable[Action] | None = None) -> None:
        super().__init__()
        self.entities = list(initial_entities or ())

    def add_action(self, action: Action) -> None:
        """Append a step."""
        self.entities.append(action)

    def execute(self, context: LaunchContext) -> None:
        for entity in self.entities:
            entity.visit(context)

    def inner(self) -> Iterable[Action]:
        return self.entities


class DeclareLaunchArgument(Action):
    """
    An argument of the launch file.

    Parameters
    ----------
    name : str
    default_value : text, optional
        Without it, the argument must be given.
    description : str, optional
    choices : list of str, optional
        The values it may have.
    """

    def __init__(
        self,
        name: str,
        *,
        default_value: Text | None = None,
        description: str | None = None,
        choices: list[str] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.name = name
        self.default = default_value
        self.description = "no description given" if description is None else description
        self._choices = choices
        if choices is not None:
            self.description = f"{self.description.rstrip('. ')}. Valid choices are: {choices}"

    def execute(self, context: LaunchContext) -> None:
        given = context.launch_configurations
        if self.name not in given:
            if self.default is None:
                raise LaunchError(
                    f"Required launch argument '{self.name}' (description: '{self.description}') "
                    "was not provided"
                )
            given[self.name] = text(self.default, context)
        if self._choices is not None and given[self.name] not in self._choices:
            raise LaunchError(
                f'Argument "{self.name}" provided value "{given[self.name]}" is not valid. '
                f"Valid options are: {self._choices}"
            )


class OpaqueFunction(Action):
    """
    A function that returns further steps.

    Parameters
    ----------
    function : callable
        Gets the context, then `args` and `kwargs`.
    """

    def __init__(
        self,
        *,
        function: Callable[..., Iterable[Action] | None],
        args: Iterable[Any] = (),
        kwargs: dict[str, Any] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self._call = lambda context: function(context, *args, **(kwargs or {}))

    def execute(self, context: LaunchContext) -> None:
        for action in self._call(context) or ():
            action.visit(context)


class GroupAction(Action):
    """
    Steps whose changes to the arguments stay among them.

    Parameters
    ----------
    actions : iterable of Action
    scoped : bool
        False: what they change holds for the steps after them, too.
    """

    def __init__(self, actions: Iterable[Action], *, scoped: bool = True, **options: Any) -> None:
        super().__init__(**options)
        self._actions = list(actions)
        self._scoped = scoped

    def execute(self, context: LaunchContext) -> None:
        before = dict(context.launch_configurations)
        for action in self._actions:
            action.visit(context)
        if self._scoped:
            context.launch_configurations.clear()
            context.launch_configurations.update(before)

    def inner(self) -> Iterable[Action]:
        return self._actions


class PythonLaunchDescriptionSource:
    """
    A launch file.

    Parameters
    ----------
    launch_file_path : text
    """

    def __init__(self, launch_file_path: Text) -> None:
        self._path = launch_file_path

    def load(self, context: LaunchContext) -> LaunchDescription:
        """Return what the file describes."""
        return load(Path(text(self._path, context)))

    def load_if_known(self) -> LaunchDescription | None:
        """Return what the file describes, if its path is known before the launch."""
        return load(Path(self._path)) if isinstance(self._path, (str, Path)) else None


def load(path: Path) -> LaunchDescription:
    """
    Read a launch file.

    Raises
    ------
    LaunchError
        If it is not there, or is none.
    """
    if path.suffix != ".py":
        raise LaunchError(f"{path}: only launch files in Python are in this stand-in")
    spec = importlib.util.spec_from_file_location(f"launch_file_{path.stem}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise LaunchError(f"{path}: no such launch file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    try:
        generate = module.generate_launch_description
    except AttributeError:
        raise LaunchError(f"{path}: has no function generate_launch_description()") from None
    description: LaunchDescription = generate()
    return description


class IncludeLaunchDescription(Action):
    """
    Another launch file.

    Parameters
    ----------
    launch_description_source : PythonLaunchDescriptionSource
    launch_arguments : iterable of pairs, optional
        Names and values of its arguments.
    """

    def __init__(
        self,
        launch_description_source: PythonLaunchDescriptionSource,
        *,
        launch_arguments: Iterable[tuple[Text, Text]] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self._source = launch_description_source
        self._arguments = list(launch_arguments or ())

    def execute(self, context: LaunchContext) -> None:
        description = self._source.load(context)
        for name, value in self._arguments:
            context.launch_configurations[text(name, context)] = text(value, context)
        description.visit(context)

    def inner(self) -> Iterable[Action]:
        description = self._source.load_if_known()
        return () if description is None else [description]


class LogInfo(Action):
    """
    A line of log.

    Parameters
    ----------
    msg : text
    """

    def __init__(self, *, msg: Text, **options: Any) -> None:
        super().__init__(**options)
        self._message = msg

    def execute(self, context: LaunchContext) -> None:
        log("INFO", "launch.user", text(self._message, context))


class Shutdown(Action):
    """
    The end of all processes.

    Parameters
    ----------
    reason : text
    """

    def __init__(self, *, reason: Text = "reason not given", **options: Any) -> None:
        super().__init__(**options)
        self.reason = reason

    def execute(self, context: LaunchContext) -> None:
        context.supervisor.shut_down()


def declared_arguments(action: Action) -> Iterator[DeclareLaunchArgument]:
    """Yield the arguments of a launch file and of those it includes."""
    if isinstance(action, DeclareLaunchArgument):
        yield action
    for part in action.inner():
        yield from declared_arguments(part)
