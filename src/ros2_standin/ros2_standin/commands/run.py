"""`ros2 run`: runs an executable of a package."""

from __future__ import annotations

import argparse
import shlex
import signal
import subprocess
from types import FrameType

from ros2_standin.index import executables
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--prefix",
        help="Command to run the executable with, in quotes if it has spaces "
        "(e.g. --prefix 'gdb -ex run --args')",
    )
    parser.add_argument("package_name", help="Name of the package")
    parser.add_argument("executable_name", help="Name of the executable")
    parser.add_argument("argv", nargs=argparse.REMAINDER, help="Arguments that the executable gets")


def main(args: argparse.Namespace) -> Result:
    paths = [p for p in executables(args.package_name) if p.name == args.executable_name]
    if not paths:
        return "No executable found"
    if len(paths) > 1:
        return "Multiple executables found:" + "".join(f"\n- {path}" for path in paths)
    prefix = shlex.split(args.prefix) if args.prefix is not None else []
    code = _run([*prefix, str(paths[0]), *args.argv])
    if code < 0:
        print("[ros2run]:", signal.strsignal(-code))
    elif code > 0:
        print("[ros2run]:", f"Process exited with failure {code}")
    return code


def _run(command: list[str]) -> int:
    """Run a command to its end, whatever signals come, and return its code."""
    process = subprocess.Popen(command)

    def pass_on(number: int, frame: FrameType | None) -> None:
        process.send_signal(number)

    # Whoever ends this process means the one it runs, and should not leave that one alone.
    signal.signal(signal.SIGTERM, pass_on)
    while True:
        try:
            return process.wait()
        except KeyboardInterrupt:
            pass  # the terminal sends Ctrl-C to the executable, too: it ends, and so do we
