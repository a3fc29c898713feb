"""Quality of service on the command line."""

from __future__ import annotations

import argparse

from rclpy.duration import Duration
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSLivelinessPolicy,
    QoSPresetProfiles,
    QoSProfile,
    QoSReliabilityPolicy,
)


def add_qos_arguments(parser: argparse.ArgumentParser, default: str) -> None:
    """
    Add the options that choose a profile.

    Parameters
    ----------
    parser : ArgumentParser
    default : str
        Short name of the profile that is taken if none is given.
    """
    parser.add_argument(
        "--qos-profile",
        choices=QoSPresetProfiles.short_keys(),
        default=default,
        help="Profile to start from (default: %(default)s)",
    )
    parser.add_argument("--qos-depth", metavar="N", type=int, help="Length of the queue")
    for policy, kind in (
        ("history", QoSHistoryPolicy),
        ("reliability", QoSReliabilityPolicy),
        ("durability", QoSDurabilityPolicy),
        ("liveliness", QoSLivelinessPolicy),
    ):
        parser.add_argument(
            f"--qos-{policy}", choices=kind.short_keys(), help=f"Change the profile's {policy}"
        )
    parser.add_argument(
        "--qos-liveliness-lease-duration-seconds",
        type=float,
        help="Change the profile's liveliness lease duration (s)",
    )


def is_chosen(args: argparse.Namespace) -> bool:
    """Return whether any policy was given (the profile alone does not count)."""
    return any(
        value is not None
        for name, value in vars(args).items()
        if name.startswith("qos_") and name != "qos_profile"
    )


def chosen_profile(args: argparse.Namespace) -> QoSProfile:
    """Return the profile that the options describe."""
    profile = QoSPresetProfiles.get_from_short_key(args.qos_profile)
    if args.qos_history:
        profile.history = QoSHistoryPolicy.get_from_short_key(args.qos_history)
    if args.qos_durability:
        profile.durability = QoSDurabilityPolicy.get_from_short_key(args.qos_durability)
    if args.qos_reliability:
        profile.reliability = QoSReliabilityPolicy.get_from_short_key(args.qos_reliability)
    if args.qos_liveliness:
        profile.liveliness = QoSLivelinessPolicy.get_from_short_key(args.qos_liveliness)
    lease = args.qos_liveliness_lease_duration_seconds
    if lease and lease > 0:
        profile.liveliness_lease_duration = Duration(seconds=lease)
    if args.qos_depth and args.qos_depth > 0:
        profile.depth = args.qos_depth
    elif profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL and profile.depth == 0:
        profile.depth = 1
    return profile
