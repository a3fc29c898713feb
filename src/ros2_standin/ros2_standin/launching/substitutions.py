"""Texts of a launch file that are known only when it runs."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ros2_standin.index import package_prefix
from ros2_standin.launching.context import LaunchContext
from ros2_standin.launching.output import LaunchError


class Substitution(ABC):
    """A text that is known only when the launch file runs."""

    @abstractmethod
    def perform(self, context: LaunchContext) -> str:
        """Return the text."""


#: What launch files may give for a text: parts that are put together.
Text = str | Path | Substitution | Iterable[Any]


def text(value: Text, context: LaunchContext) -> str:
    """Return the text that a value stands for."""
    if isinstance(value, Substitution):
        return value.perform(context)
    if isinstance(value, (str, Path)):
        return str(value)
    return "".join(text(part, context) for part in value)


class TextSubstitution(Substitution):
    """A text as it is."""

    def __init__(self, *, text: str) -> None:
        self._text = text

    def perform(self, context: LaunchContext) -> str:
        return self._text


class LaunchConfiguration(Substitution):
    """The value of a launch argument."""

    def __init__(self, variable_name: Text, *, default: Any = None) -> None:
        self._name = variable_name
        self._default = default

    def perform(self, context: LaunchContext) -> str:
        name = text(self._name, context)
        if name in context.launch_configurations:
            return context.launch_configurations[name]
        if self._default is None:
            raise LaunchError(f"launch configuration '{name}' does not exist")
        return text(self._default, context)


class EnvironmentVariable(Substitution):
    """The value of an environment variable."""

    def __init__(self, name: Text, *, default_value: Any = None) -> None:
        self._name = name
        self._default = default_value

    def perform(self, context: LaunchContext) -> str:
        name = text(self._name, context)
        if name in os.environ:
            return os.environ[name]
        if self._default is None:
            raise LaunchError(f"environment variable '{name}' does not exist")
        return text(self._default, context)


class PathJoinSubstitution(Substitution):
    """A path from its parts."""

    def __init__(self, substitutions: Iterable[Text]) -> None:
        self._parts = list(substitutions)

    def perform(self, context: LaunchContext) -> str:
        return os.path.join(*(text(part, context) for part in self._parts))


class FindPackageShare(Substitution):
    """The share folder of a package."""

    def __init__(self, package: Text) -> None:
        self._package = package

    def perform(self, context: LaunchContext) -> str:
        package = text(self._package, context)
        prefix = package_prefix(package)
        if prefix is None:
            raise LaunchError(f"package '{package}' not found")
        return str(prefix / "share" / package)
