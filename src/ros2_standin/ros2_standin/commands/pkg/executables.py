"""`ros2 pkg executables`: lists the executables of one or all packages."""

from __future__ import annotations

import argparse

from ros2_standin import index
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("package_name", nargs="?", help="Name of the package; all if not given")
    parser.add_argument("--full-path", action="store_true", help="Print the full paths")


def main(args: argparse.Namespace) -> Result:
    packages = index.package_names() if args.package_name is None else [args.package_name]
    for package in packages:
        for path in sorted(index.executables(package)):
            print(path if args.full_path else f"{package} {path.name}")
    return None
