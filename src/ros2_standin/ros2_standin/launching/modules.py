"""The modules that launch files import from, with what there is of them."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any, NoReturn

from ros2_standin.catalogue import not_here
from ros2_standin.launching import actions, context, processes, substitutions
from ros2_standin.launching.output import LaunchError

#: What there is, by module.
CONTENT: dict[str, list[Any]] = {
    "launch": [actions.LaunchDescription, context.LaunchContext, substitutions.Substitution],
    "launch.actions": [
        actions.DeclareLaunchArgument,
        actions.GroupAction,
        actions.IncludeLaunchDescription,
        actions.LogInfo,
        actions.OpaqueFunction,
        actions.Shutdown,
        processes.ExecuteProcess,
    ],
    "launch.conditions": [actions.IfCondition, actions.UnlessCondition],
    "launch.launch_description_sources": [actions.PythonLaunchDescriptionSource],
    "launch.substitutions": [
        substitutions.EnvironmentVariable,
        substitutions.LaunchConfiguration,
        substitutions.PathJoinSubstitution,
        substitutions.TextSubstitution,
    ],
    "launch_ros": [],
    "launch_ros.actions": [processes.Node],
    "launch_ros.parameter_descriptions": [processes.ParameterValue],
    "launch_ros.substitutions": [substitutions.FindPackageShare],
}


class _Module(ModuleType):
    """A module that says so when something is asked of it that it has not."""

    def __getattr__(self, name: str) -> NoReturn:
        if name.startswith("__"):
            raise AttributeError(name)
        raise LaunchError(not_here(f"{self.__name__}.{name}"))


def provide() -> None:
    """Let launch files import the modules."""
    for name, content in CONTENT.items():
        module = _Module(name)
        module.__path__ = []
        for item in content:
            setattr(module, item.__name__, item)
        sys.modules[name] = module
    for name in CONTENT:
        parent, _, base = name.rpartition(".")
        if parent:
            setattr(sys.modules[parent], base, sys.modules[name])
