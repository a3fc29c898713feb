"""`ros2 interface packages`: lists the packages that have interface types."""

from __future__ import annotations

import argparse

from ros2_standin.index import interfaces
from ros2_standin.interface_kinds import add_kind_arguments, chosen_kinds
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_kind_arguments(parser)


def main(args: argparse.Namespace) -> Result:
    for package in interfaces(chosen_kinds(args)):
        print(package)
    return None
