"""`ros2 pkg xml`: prints the manifest of a package."""

from __future__ import annotations

import argparse
from xml.etree import ElementTree

from ros2_standin.index import package_prefix
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("package_name", help="Name of the package")
    parser.add_argument("-t", "--tag", help="Print only the text of this tag (e.g. 'version')")


def main(args: argparse.Namespace) -> Result:
    prefix = package_prefix(args.package_name)
    if prefix is None:
        return "Package not found"
    path = prefix / "share" / args.package_name / "package.xml"
    if not path.is_file():
        return "Package XML manifest not found"
    tree = ElementTree.parse(path)
    if args.tag is None:
        ElementTree.dump(tree)
        return 0
    elements = tree.getroot().findall(args.tag)
    if not elements:
        return "XML tag not found"
    for element in elements:
        print(element.text)
    return None
