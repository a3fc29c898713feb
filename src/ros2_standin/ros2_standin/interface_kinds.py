"""The options that choose between messages, services and actions."""

from __future__ import annotations

import argparse

from ros2_standin.index import INTERFACE_KINDS


def add_kind_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options to a parser."""
    parser.add_argument("-m", "--only-msgs", action="store_true", help="Messages only")
    parser.add_argument("-s", "--only-srvs", action="store_true", help="Services only")
    parser.add_argument("-a", "--only-actions", action="store_true", help="Actions only")


def chosen_kinds(args: argparse.Namespace) -> list[str]:
    """Return the kinds that were chosen; all if none was."""
    chosen = {"msg": args.only_msgs, "srv": args.only_srvs, "action": args.only_actions}
    return [kind for kind, wanted in chosen.items() if wanted] or list(INTERFACE_KINDS)
