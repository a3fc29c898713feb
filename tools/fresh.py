"""What somebody meets who comes for the first time, and how long it takes.

    fresh.py [COMMAND...]      default: make demo, the same again, make test

Clones what is committed into an empty folder, and runs the commands there with an empty home, no
compiled kernel, and of the variables of this shell only those that say how packages are reached.
Prints the time of each command and of the steps of its set-up. The clone of a command that failed
remains, with the log of each command beside it.
"""

from __future__ import annotations

import os
import platform
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
COMMANDS = ("make demo", "make demo", "make test")
WAY_TO_PACKAGES = ("SSL_CERT_FILE", "REQUESTS_CA_BUNDLE", "HTTP_PROXY", "HTTPS_PROXY", "NO_PROXY")
# A step of the set-up with its time, and what pytest closes with.
TOLD = re.compile(r"^  [a-z].* \d+ s$|^.*\b\d+ passed.*$", re.MULTILINE)


def main(commands: list[str]) -> int:
    """Run the commands in a fresh clone; return the exit code of the first that failed, else 0."""
    place = Path(tempfile.mkdtemp(prefix="mfpcc-fresh-"))
    clone, home = place / "mfpcc", place / "home"
    subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
    commit = subprocess.run(
        ["git", "log", "-1", "--format=%h"], cwd=clone, capture_output=True, text=True, check=True
    )
    print(
        f"fresh: {commit.stdout.strip()}, Python {platform.python_version()}, "
        f"{os.cpu_count()} cores",
        flush=True,
    )
    variables = {
        name: value
        for name, value in os.environ.items()
        if name.startswith("PIP_") or name.upper() in WAY_TO_PACKAGES
    }
    variables |= {"HOME": str(home), "PATH": "/usr/local/bin:/usr/bin:/bin", "LANG": "C.UTF-8"}
    variables["PYTHON"] = sys.executable
    _copy_pip_settings(home)
    for number, command in enumerate(commands, 1):
        log = place / f"{number}.log"
        print(command, flush=True)
        code, told = _measured(command, clone, variables, log)
        print(told, flush=True)
        if code:
            print(log.read_text(errors="replace")[-4000:], file=sys.stderr)
            print(f"fresh: '{command}' failed in {clone}; its log is {log}", file=sys.stderr)
            return code
    shutil.rmtree(place)
    return 0


def _copy_pip_settings(home: Path) -> None:
    (home / ".config/pip").mkdir(parents=True)
    config = Path(os.environ.get("XDG_CONFIG_HOME") or Path("~/.config").expanduser())
    if (config / "pip/pip.conf").exists():
        shutil.copy(config / "pip/pip.conf", home / ".config/pip")


def _measured(command: str, folder: Path, variables: dict[str, str], log: Path) -> tuple[int, str]:
    """Run a command; return its exit code and what is to be told of it."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    with log.open("w") as output:
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=folder,
            env=variables,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
    elapsed, after = time.monotonic() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    steps = TOLD.findall(log.read_text(errors="replace"))
    in_all = f"  in all: {elapsed:.0f} s, with {processor:.0f} s of processor time"
    return done.returncode, "\n".join([*steps, in_all])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or list(COMMANDS)))
