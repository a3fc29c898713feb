"""`ros2 service call`: calls a service."""

from __future__ import annotations

import argparse
import sys
import time

import rclpy

from ros2_standin.messages import fill, read_values
from ros2_standin.node import cli_node
from ros2_standin.types import interface_class
from ros2_standin.verb import Result, Terminated

#: Time between two looks whether the server is still there (s).
LOOK_PERIOD = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("service_name", help="Name of the service")
    parser.add_argument("service_type", help="Type of the service (e.g. 'std_srvs/srv/Trigger')")
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "values", nargs="?", default="{}", help="Fields of the request, as YAML ('{a: 1, b: 2}')"
    )
    what.add_argument("--stdin", action="store_true", help="Read the fields from standard input")
    parser.add_argument("-r", "--rate", metavar="N", type=float, help="Call again and again (Hz)")


def main(args: argparse.Namespace) -> Result:
    if args.rate is not None and not args.rate > 0.0:
        return "rate must be greater than zero"
    try:
        kind = interface_class(args.service_type, "srv")
    except LookupError:
        return "The passed service type is invalid"
    if not (hasattr(kind, "Request") and hasattr(kind, "Response")):
        return "The passed type is not a service"
    values = read_values(sys.stdin.buffer.read() if args.stdin else args.values)
    request = kind.Request()
    try:
        fill(request, values)
    except Exception as error:  # noqa: BLE001 (whatever the generated class says)
        return f"Failed to populate field: {error}"
    package, _, base = args.service_type.partition("/")
    with cli_node(args, f"_ros2cli_requester_{package}_{base.split('/')[-1]}") as node:
        client = node.create_client(kind, args.service_name)
        if not client.service_is_ready():
            print("waiting for service to become available...")
            client.wait_for_service()
        while True:
            print(f"requester: making request: {request!r}\n")
            called = time.monotonic()
            future = client.call_async(request)
            while not future.done():
                rclpy.spin_until_future_complete(node, future, timeout_sec=LOOK_PERIOD)
                if not rclpy.ok():
                    raise Terminated
                # one that was killed is seen for another 20 s
                if not future.done() and not client.service_is_ready():
                    return f"No answer: who offered the service {args.service_name} has gone"
            if future.result() is None:
                return f"Exception while calling service: {future.exception()!r}"
            print(f"response:\n{future.result()!r}\n")
            if args.rate is None:
                return None
            time.sleep(max(0.0, called + 1.0 / args.rate - time.monotonic()))
