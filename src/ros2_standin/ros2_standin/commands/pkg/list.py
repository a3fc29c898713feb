"""`ros2 pkg list`: lists the installed packages."""

from __future__ import annotations

import argparse

from ros2_standin.index import package_names
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    pass


def main(args: argparse.Namespace) -> Result:
    for name in package_names():
        print(name)
    return None
