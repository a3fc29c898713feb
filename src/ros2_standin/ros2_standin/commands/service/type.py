"""`ros2 service type`: prints the type of a service."""

from __future__ import annotations

import argparse

from ros2_standin.node import DISCOVERY_TIME, graph_node, visible
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("service_name", help="Name of the service")
    parser.set_defaults(spin_time=DISCOVERY_TIME)


def main(args: argparse.Namespace) -> Result:
    with graph_node(args) as node:
        services = dict(visible(node.get_service_names_and_types(), args.include_hidden_services))
    types = services.get(args.service_name)
    if types is None:
        return 1
    for name in types:
        print(name)
    return None
