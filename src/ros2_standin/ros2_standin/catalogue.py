"""The commands and verbs there are, with the line of help of each; and what only ROS 2 has."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Command:
    """
    A command, e.g. ``ros2 topic``.

    Parameters
    ----------
    help : str
        The line that tells what it is for.
    verbs : dict
        Its verbs, each with its line of help. Empty: the command does its work itself.
    option : str
        An option of the command itself that its verbs read (``--include-hidden-...``).
    missing : tuple of str
        Verbs that only ROS 2's own command has.
    """

    help: str
    verbs: dict[str, str] = field(default_factory=dict)
    option: str = ""
    missing: tuple[str, ...] = ()


#: Commands by name. The code of ``ros2 topic echo`` is in ``commands/topic/echo.py``.
COMMANDS = {
    "bag": Command(
        "Record and play back what is on the topics",
        {
            "info": "Print what is in a bag",
            "play": "Publish the messages of a bag again",
            "record": "Record messages to a bag",
        },
        missing=("burst", "convert", "list", "reindex"),
    ),
    "interface": Command(
        "Show the message and service types there are",
        {
            "list": "List all interface types",
            "package": "List the interface types of a package",
            "show": "Print the definition of an interface",
        },
        missing=("packages", "proto"),
    ),
    "launch": Command("Run a launch file"),
    "lifecycle": Command(
        "Look at and change the state of managed nodes",
        {
            "get": "Print the state of one or all managed nodes",
            "list": "List the transitions a node can make",
            "nodes": "List the managed nodes",
            "set": "Make a node do a transition",
        },
    ),
    "node": Command(
        "Look at the nodes that run",
        {
            "info": "Print the topics, services and actions of a node",
            "list": "List the nodes",
        },
    ),
    "param": Command(
        "Read and change parameters",
        {
            "describe": "Print what parameters mean and which values they take",
            "dump": "Print all parameters of a node as a parameter file",
            "get": "Print the value of a parameter",
            "list": "List the parameters of one or all nodes",
            "load": "Set the parameters of a node from a file",
            "set": "Set a parameter",
        },
        missing=("delete",),
    ),
    "pkg": Command(
        "Look at the installed packages",
        {
            "executables": "List the executables of one or all packages",
            "list": "List the packages",
            "prefix": "Print where a package is installed",
        },
        missing=("create", "xml"),
    ),
    "run": Command("Run an executable of a package"),
    "service": Command(
        "Look at and call services",
        {
            "call": "Call a service",
            "list": "List the services",
            "type": "Print the type of a service",
        },
        option="--include-hidden-services",
        missing=("echo", "find", "info"),
    ),
    "topic": Command(
        "Look at topics, listen and publish",
        {
            "echo": "Print the messages of a topic",
            "hz": "Measure the rate of a topic",
            "info": "Print who publishes and who listens",
            "list": "List the topics",
            "pub": "Publish to a topic",
            "type": "Print the type of a topic",
        },
        option="--include-hidden-topics",
        missing=("bw", "delay", "find"),
    ),
}

#: Commands that only ROS 2 has.
MISSING_COMMANDS = ("action", "component", "control", "daemon", "doctor", "multicast", "security")


def not_here(what: str) -> str:
    """
    Return the sentence for something that only ROS 2's own command has.

    Parameters
    ----------
    what : str
        E.g. ``ros2 doctor``.
    """
    return (
        f"{what}: not in this stand-in, but in ROS 2's own command line "
        "(https://docs.ros.org/en/jazzy/Installation.html)"
    )
