"""`ros2 interface package`: lists the interface types of a package."""

from __future__ import annotations

import argparse

from ros2_standin.index import interfaces
from ros2_standin.interface_kinds import add_kind_arguments, chosen_kinds
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_kind_arguments(parser)
    parser.add_argument("package_name", help="Name of the package")


def main(args: argparse.Namespace) -> Result:
    for package, names in interfaces(chosen_kinds(args), args.package_name).items():
        for name in names:
            print(f"{package}/{name}")
    return None
