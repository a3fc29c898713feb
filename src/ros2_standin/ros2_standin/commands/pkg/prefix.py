"""`ros2 pkg prefix`: prints where a package is installed."""

from __future__ import annotations

import argparse

from ros2_standin.index import package_prefix
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("package_name", help="Name of the package")
    parser.add_argument("--share", action="store_true", help="Print its share folder instead")


def main(args: argparse.Namespace) -> Result:
    prefix = package_prefix(args.package_name)
    if prefix is None:
        return "Package not found"
    print(prefix / "share" / args.package_name if args.share else prefix)
    return None
