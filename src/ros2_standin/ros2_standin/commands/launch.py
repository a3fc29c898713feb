"""`ros2 launch`: runs a launch file."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from ament_index_python import PackageNotFoundError, get_package_share_directory

from ros2_standin.arguments import add_missing
from ros2_standin.launching import modules
from ros2_standin.launching.actions import (
    DeclareLaunchArgument,
    LaunchDescription,
    declared_arguments,
    load,
)
from ros2_standin.launching.launch import launch
from ros2_standin.launching.output import LaunchError, log
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-n", "--noninteractive", action="store_true", help="Accepted; it never asks anything"
    )
    parser.add_argument("-d", "--debug", action="store_true", help="Print tracebacks of errors")
    add_missing(parser, "-p", "--print", "--print-description", "--launch-prefix-filter")
    parser.add_argument(
        "-s",
        "--show-args",
        "--show-arguments",
        action="store_true",
        help="Print the arguments of the launch file, and end",
    )
    parser.add_argument(
        "-a",
        "--show-all-subprocesses-output",
        action="store_true",
        help="Accepted; all output is printed anyway",
    )
    parser.add_argument("--launch-prefix", default="", help="Command to run every process with")
    parser.add_argument("package_name", help="Name of the package, or path of a launch file")
    parser.add_argument("launch_file_name", nargs="?", help="Name of the launch file")
    parser.add_argument(
        "launch_arguments", nargs="*", help="Arguments of the launch file ('<name>:=<value>')"
    )


def main(args: argparse.Namespace) -> Result:
    given = args.launch_arguments
    if os.path.isfile(args.package_name):
        path = Path(args.package_name)
        given = [args.launch_file_name, *given] if args.launch_file_name else given
    else:
        path = _in_package(args.package_name, args.launch_file_name)
    modules.provide()
    if args.show_args:
        try:
            _print_arguments(load(path))
        except LaunchError as error:
            return str(error)
        return None
    arguments = _arguments(given)
    log("INFO", "launch", "Default logging verbosity is set to INFO")
    return launch(path, arguments, prefix=args.launch_prefix, debug=args.debug)


def _in_package(package: str, file: str | None) -> Path:
    """Find a launch file in the share folder of a package."""
    try:
        share = Path(get_package_share_directory(package))
    except PackageNotFoundError as error:
        raise RuntimeError(f"Package '{package}' not found: {error}") from None
    found = sorted(share.rglob(file)) if file else []
    if not found:
        raise RuntimeError(
            f"file '{file}' was not found in the share directory of package '{package}' "
            f"which is at '{share}'"
        )
    if len(found) > 1:
        places = ", ".join(f"'{path}'" for path in found)
        raise RuntimeError(
            f"file '{file}' was found more than once in the share directory of package "
            f"'{package}': [{places}]"
        )
    return found[0]


def _arguments(given: list[str]) -> dict[str, str]:
    """Split the arguments; of duplicates the last one holds."""
    arguments = {}
    for argument in given:
        name, assigned, value = argument.partition(":=")
        if not (name and assigned and value):
            raise RuntimeError(
                f"malformed launch argument '{argument}', expected format '<name>:=<value>'"
            )
        arguments[name] = value
    return arguments


def _print_arguments(description: LaunchDescription) -> None:
    print("Arguments (pass arguments as '<name>:=<value>'):")
    arguments: dict[str, DeclareLaunchArgument] = {}
    for argument in declared_arguments(description):
        arguments.setdefault(argument.name, argument)
    for argument in arguments.values():
        print(f"\n    '{argument.name}':\n        {argument.description}")
        if argument.default is not None:
            print(f"        (default: {argument.default!r})")
    if not arguments:
        print("\n  No arguments.")
