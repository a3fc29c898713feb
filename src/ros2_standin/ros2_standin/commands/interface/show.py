"""`ros2 interface show`: prints the definition of an interface."""

from __future__ import annotations

import argparse
import sys
from typing import NamedTuple

from ros2_standin.index import interface_file
from ros2_standin.verb import Result

_PRIMITIVES = frozenset(
    [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
    + ["bool", "byte", "char", "float32", "float64", "string", "wstring"]
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    comments = parser.add_mutually_exclusive_group()
    comments.add_argument(
        "--all-comments", action="store_true", help="Print the comments of nested types, too"
    )
    comments.add_argument(
        "--no-comments", action="store_true", help="Print neither comments nor empty lines"
    )
    parser.add_argument(
        "type", help="Interface type (e.g. 'std_msgs/msg/String'); '-' reads it from a pipe"
    )


def main(args: argparse.Namespace) -> Result:
    name = args.type
    if name == "-":
        if sys.stdin.isatty():
            return "expected stdin pipe"
        name = sys.stdin.readline().strip()
    if not name:
        return "the passed value is empty"
    _show(name, comments=not args.no_comments, nested_comments=args.all_comments)
    return None


def _show(name: str, *, comments: bool, nested_comments: bool, level: int = 0) -> None:
    """Print a definition, and under each field of a message type the definition of that."""
    for raw in interface_file(name).read_text(encoding="utf-8").splitlines():
        line = Line.read(raw.rstrip(), package=name.split("/")[0])
        text = line.raw if comments else line.code
        if text:
            print("\t" * level + text)
        elif comments:
            print()
        if line.nested:
            _show(
                line.nested,
                comments=nested_comments,
                nested_comments=nested_comments,
                level=level + 1,
            )


class Line(NamedTuple):
    """
    One line of a definition.

    Parameters
    ----------
    raw : str
        As it is in the file.
    code : str
        Without its comment.
    nested : str
        The message type of the field, if it has one.
    """

    raw: str
    code: str
    nested: str

    @classmethod
    def read(cls, raw: str, package: str) -> Line:
        """Read a line of a file of `package`."""
        start = _comment_start(raw)
        code = raw[:start].strip()
        kind = code.split()[0].split("[")[0].split("<=")[0] if code.strip("-") else ""
        comment = raw[start:].strip("#").strip()
        if start < len(raw) and code:
            # ROS 2 takes away a comment but for its # and what separates it from the words.
            code = raw[: raw.find(comment) - 1].strip() if comment else raw
        elif start < len(raw) and not comment:
            code = raw  # and a comment that says nothing it does not see as one
        if not kind or kind in _PRIMITIVES:
            return cls(raw, code, "")
        owner, _, base = kind.rpartition("/")
        return cls(raw, code, f"{owner or package}/msg/{base}")


def _comment_start(raw: str) -> int:
    """Return where the comment of a line begins; its end if there is none."""
    quote = ""
    for position, character in enumerate(raw):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character == "#":
            return position
    return len(raw)
