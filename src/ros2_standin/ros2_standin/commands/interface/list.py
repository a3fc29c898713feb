"""`ros2 interface list`: lists all interface types."""

from __future__ import annotations

import argparse

from ros2_standin.index import interfaces
from ros2_standin.interface_kinds import add_kind_arguments, chosen_kinds
from ros2_standin.verb import Result

TITLES = {"msg": "Messages", "srv": "Services", "action": "Actions"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_kind_arguments(parser)


def main(args: argparse.Namespace) -> Result:
    for kind in chosen_kinds(args):
        print(f"{TITLES[kind]}:")
        for package, names in interfaces([kind]).items():
            for name in names:
                print(f"    {package}/{name}")
    return None
