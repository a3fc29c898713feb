"""Reads the command line, and calls the verb."""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import ModuleType
from typing import Any

from pwm_node.ros import ros_environment
from ros2_standin.catalogue import COMMANDS, MISSING_COMMANDS, Command, not_here
from ros2_standin.verb import Result, Terminated


class _LazyParser(argparse.ArgumentParser):
    """A parser that gets its arguments when it is first used: only what is called is imported."""

    fill: Callable[[_LazyParser], None] | None = None

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self.fill is not None:
            fill, self.fill = self.fill, None
            fill(self)
        return super().parse_known_args(args, namespace)


def _add_choices(
    parser: argparse.ArgumentParser,
    name: str,
    choices: Mapping[str, tuple[str, Callable[[_LazyParser], None]]],
    missing: Sequence[str],
) -> None:
    """Add the commands below `name` to its parser."""
    width = max(map(len, choices))
    sub = parser.add_subparsers(
        title="Commands",
        description="\n".join(f"{key.ljust(width)}  {choices[key][0]}" for key in sorted(choices)),
        metavar=f"Call `{name} <command> -h` for more detailed usage.",
        parser_class=_LazyParser,
    )
    sub.required = False
    for key in sorted([*choices, *missing]):
        child = sub.add_parser(key, formatter_class=argparse.RawDescriptionHelpFormatter)
        if key in choices:
            child.description, child.fill = choices[key]
        else:
            child.fill = partial(_refuse, f"{name} {key}")


def _refuse(what: str, parser: _LazyParser) -> None:
    raise SystemExit(not_here(what))


def _fill_command(name: str, command: Command, parser: _LazyParser) -> None:
    """Give the parser of a command its arguments."""
    if not command.verbs:
        _fill_verb(f"ros2_standin.commands.{name}", parser)
        return
    if command.option:
        parser.add_argument(
            command.option, action="store_true", help="Include those whose names begin with _"
        )
    parser.set_defaults(run=partial(_print_help, parser))
    verbs = {
        verb: (text, partial(_fill_verb, f"ros2_standin.commands.{name}.{verb}"))
        for verb, text in command.verbs.items()
    }
    _add_choices(parser, f"ros2 {name}", verbs, command.missing)


def _fill_verb(module_name: str, parser: _LazyParser) -> None:
    """Import a verb, and give its parser its arguments."""
    module: ModuleType = importlib.import_module(module_name)
    module.add_arguments(parser)
    parser.set_defaults(run=module.main)


def _print_help(parser: argparse.ArgumentParser, args: argparse.Namespace) -> Result:
    parser.print_help()
    return 0


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = argparse.ArgumentParser(
        prog="ros2",
        description="A small stand-in for the ros2 command, for machines that have ROS 2 as "
        "Python\npackages only. Where ROS 2 is installed, its own command is used.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--use-python-default-buffering",
        action="store_true",
        help="Leave the buffering of the output to Python, rather than writing line by line",
    )
    parser.set_defaults(run=partial(_print_help, parser))
    commands = {
        name: (command.help, partial(_fill_command, name, command))
        for name, command in COMMANDS.items()
    }
    _add_choices(parser, "ros2", commands, MISSING_COMMANDS)
    return parser


def parse(argv: Sequence[str] | None = None) -> argparse.Namespace:
    """Read a command line, that of the process unless given, and import the verb."""
    return build_parser().parse_args(argv)


def execute(args: argparse.Namespace) -> Result:
    """
    Run a verb.

    Returns
    -------
    int, str or None
        What ``sys.exit`` takes; for Ctrl-C the number of the signal, as of ROS 2's own command.
    """
    try:
        return _execute(args)
    except KeyboardInterrupt:
        return signal.SIGINT


def _execute(args: argparse.Namespace) -> Result:
    if not args.use_python_default_buffering and hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(line_buffering=True)
    try:
        return args.run(args)
    except Terminated:
        return signal.SIGTERM
    except BrokenPipeError:
        # The reader (`... | head`) has what it wanted. What is left in the buffer goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (RuntimeError, OSError, ros_environment.RosError) as error:
        return ros_environment.plain(str(error))
