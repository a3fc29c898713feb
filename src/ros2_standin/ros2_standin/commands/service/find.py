"""`ros2 service find`: lists the services of a type."""

from __future__ import annotations

import argparse

from ros2_standin.node import DISCOVERY_TIME, graph_node, visible
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("service_type", help="Type to look for (e.g. 'std_srvs/srv/Trigger')")
    parser.add_argument("-c", "--count-services", action="store_true", help="Print only how many")
    parser.add_argument(
        "--include-hidden-services", action="store_true", help="Include those that begin with _"
    )
    parser.set_defaults(spin_time=DISCOVERY_TIME)


def main(args: argparse.Namespace) -> Result:
    with graph_node(args) as node:
        services = visible(node.get_service_names_and_types(), args.include_hidden_services)
    names = [name for name, types in services if args.service_type in types]
    if args.count_services:
        print(len(names))
    else:
        for name in names:
            print(name)
    return None
