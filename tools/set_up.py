"""Set up what is missing, and nothing that is not.

    set_up.py environment    .venv: a Python environment with all packages, ROS 2 among them
    set_up.py workspace      that, and build/ and install/: the packages of src/ and config/
    set_up.py bench          that, and what the benches compare with

Each part ends by writing a stamp: hashes of what it was made from. A part whose stamp is right is
left alone. Any other part loses its stamp first and is made (a part without a stamp from nothing:
it may be half of something), so an interrupted or failed set-up is never mistaken for a whole one.

Where ROS 2 Jazzy is sourced, the environment gets no ROS 2 of its own and sees the machine's.
It is started by set_up.sh, with the Python that the environment is to be made of.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, NoReturn
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
BUILD = ROOT / "build"
INSTALL = ROOT / "install"
REQUIREMENTS = ROOT / "requirements"

# The same names are in .gitignore and, for the workspace, in setup.bash.
ENVIRONMENT_STAMP = VENV / ".complete"
BENCH_STAMP = VENV / ".bench-complete"
WORKSPACE_STAMP = INSTALL / ".complete"
LOCK = ROOT / ".set-up.lock"

THIS_PYTHON = [sys.executable, sys.version.split()[0]]

# Folders of a package that are linked or listed when it is installed: a new file in them needs a
# new build, a changed one does not. Python modules need none: the installed package is a link.
LISTED = ("bin", "path", "resource", "motors", "experiments", "parameters", "layouts")
# Files of a package that a build reads.
READ = ("package.xml", "setup.py", "setup.cfg", "CMakeLists.txt", "msg/*", "srv/*", "action/*")

Stamp = dict[str, Any]


class SetUpError(Exception):
    """What is wrong, and what to do about it: for a person."""


def main() -> int:
    """Make the part that is asked for, and those it needs."""
    parser = argparse.ArgumentParser(description="Set up what is missing.")
    parser.add_argument("part", choices=("environment", "workspace", "bench"))
    part = parser.parse_args().part
    signal.signal(signal.SIGTERM, _terminated)
    try:
        if not _is_complete(part):
            with _only_one_at_a_time() as lock:
                _make(part, lock)
    except SetUpError as error:
        print(f"set-up: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("set-up: interrupted; the next call starts that part again", file=sys.stderr)
        return 130
    return 0


# The parts -----------------------------------------------------------------------------------


def _is_complete(part: str) -> bool:
    if not _environment_is_complete():
        return False
    if part == "workspace":
        return _read(WORKSPACE_STAMP) == _workspace_stamp()
    if part == "bench":
        return _is_complete("workspace") and _read(BENCH_STAMP) == _bench_stamp()
    return True


def _make(part: str, lock: IO[str]) -> None:
    if not _environment_is_complete():
        _make_environment(lock)
    if part in ("workspace", "bench") and _read(WORKSPACE_STAMP) != _workspace_stamp():
        _make_workspace(lock)
    if part == "bench" and _read(BENCH_STAMP) != _bench_stamp():
        _make_bench(lock)


def _environment_is_complete() -> bool:
    stamp = _read(ENVIRONMENT_STAMP)
    made_of = stamp.pop("python", [])
    # Any Python will do that the environment was made of once, unless another one is asked for by
    # name just now, or it was replaced by another version (as a machine's upgrade does).
    replaced = made_of != THIS_PYTHON and made_of[:1] == THIS_PYTHON[:1]
    if replaced or (os.environ.get("PYTHON") and made_of != THIS_PYTHON):
        return False
    return stamp == _environment_stamp() and (VENV / "bin/python").exists()


def _make_environment(lock: IO[str]) -> None:
    distro = os.environ.get("ROS_DISTRO", "")
    if distro not in ("", "jazzy"):
        raise SetUpError(
            f"ROS 2 {distro} is sourced in this shell, and this project is made for jazzy. Source "
            "jazzy, or use a shell without ROS_DISTRO: then ROS 2 Jazzy comes from PyPI."
        )
    print(f"set-up: Python environment .venv, of {' '.join(THIS_PYTHON)}", flush=True)
    shutil.rmtree(VENV, ignore_errors=True)
    # What the machine's ROS 2 imports (lark, empy, ...) is among the machine's Python packages.
    see_machine = ["--system-site-packages"] if distro else []
    _run("venv", [sys.executable, "-m", "venv", *see_machine, VENV], lock)
    python = VENV / "bin/python"
    files = _requirement_files()
    # The first file alone: it is what builds the one package that has no wheel.
    _run("build tools", [*_pip(python), "-r", files[0]], lock)
    rest = [argument for file in files[1:] for argument in ("-r", file)]
    _run(
        "packages (this takes a minute or two)",
        [
            *_pip(python),
            *("--use-pep517", "--no-build-isolation", "--only-binary=:all:", "--no-binary=empy"),
            *rest,
        ],
        lock,
    )
    _run("imports", [python, "-c", "import colcon_core, numba, rclpy"], lock, _environment())
    _write(ENVIRONMENT_STAMP, {**_environment_stamp(), "python": THIS_PYTHON})


def _make_workspace(lock: IO[str]) -> None:
    _look_for_compiler()
    old, new = _read(WORKSPACE_STAMP), _workspace_stamp()
    WORKSPACE_STAMP.unlink(missing_ok=True)
    packages: dict[str, str] = new["packages"]
    if old.get("for_all") == new["for_all"]:
        before: dict[str, str] = old["packages"]
        changed = [name for name in packages if packages[name] != before.get(name)]
        for name in {*changed, *(before.keys() - packages.keys())}:
            shutil.rmtree(BUILD / name, ignore_errors=True)
            shutil.rmtree(INSTALL / name, ignore_errors=True)
    else:
        changed = list(packages)
        for folder in (BUILD, INSTALL, ROOT / "log"):
            shutil.rmtree(folder, ignore_errors=True)

    print(f"set-up: workspace ({', '.join(changed) or 'nothing to build'})", flush=True)
    if changed:
        colcon = (VENV / "bin/python", "-m", "colcon", "build")
        options = ("--event-handlers", "console_direct+", "--packages-select", *changed)
        _run("colcon build", [*colcon, *options], lock, _environment())
    use = "source install/setup.bash && python -c 'import mfpcc_msgs.msg'"
    _run("messages", ["bash", "-c", use], lock, _environment())
    _write(WORKSPACE_STAMP, new)


def _make_bench(lock: IO[str]) -> None:
    BENCH_STAMP.unlink(missing_ok=True)
    print("set-up: what the benches compare with", flush=True)
    command = [*_pip(VENV / "bin/python"), "--only-binary=:all:"]
    _run("packages", [*command, "-r", REQUIREMENTS / "bench.txt"], lock)
    _write(BENCH_STAMP, _bench_stamp())


# What a part is made from --------------------------------------------------------------------


def _requirement_files() -> list[Path]:
    sourced = bool(os.environ.get("ROS_DISTRO"))
    names = ("seed.txt", "run.txt") if sourced else ("seed.txt", "run.txt", "ros.txt")
    return [REQUIREMENTS / name for name in names]


def _environment_stamp() -> Stamp:
    sourced = _environment().get("AMENT_PREFIX_PATH", "") if os.environ.get("ROS_DISTRO") else ""
    return {
        "folder": str(VENV),  # scripts in an environment name it, so a moved one is of no use
        "ros": sourced or "PyPI",
        "requirements": _hash_of(_requirement_files()),
    }


def _workspace_stamp() -> Stamp:
    shared = ("colcon.meta", "colcon_defaults.yaml", "tools/ros_wheels.cmake")
    return {
        "for_all": [_read(ENVIRONMENT_STAMP), _hash_of(ROOT / name for name in shared)],
        "packages": {name: _hash_of_package(folder) for name, folder in _packages()},
    }


def _bench_stamp() -> Stamp:
    bench = _hash_of([REQUIREMENTS / "bench.txt"])
    return {"environment": _read(ENVIRONMENT_STAMP), "bench": bench}


def _packages() -> Iterator[tuple[str, Path]]:
    """Name and folder of each package of the workspace."""
    for file in sorted([ROOT / "config/package.xml", *ROOT.glob("src/*/package.xml")]):
        try:
            name = ElementTree.parse(file).getroot().findtext("name")
        except ElementTree.ParseError as error:
            raise SetUpError(f"{file.relative_to(ROOT)} is not XML: {error}") from None
        if not name:
            raise SetUpError(f"{file.relative_to(ROOT)} has no <name>")
        yield name, file.parent


def _hash_of_package(folder: Path) -> str:
    listed = sorted(str(path) for part in LISTED for path in folder.glob(f"{part}/*"))
    read = sorted(path for pattern in READ for path in folder.glob(pattern))
    return _hash_of(read, more="\n".join(listed))


def _hash_of(files: Iterable[Path], more: str = "") -> str:
    """Hash of the names and the content of some files."""
    total = hashlib.sha256(more.encode())
    for file in files:
        total.update(f"\0{file.relative_to(ROOT)}\0{file.stat().st_size}\0".encode())
        total.update(file.read_bytes())
    return total.hexdigest()


def _read(stamp: Path) -> Stamp:
    """Return what a stamp says: nothing, if it is not there or not whole."""
    try:
        content = json.loads(stamp.read_text())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _write(stamp: Path, content: Stamp) -> None:
    temporary = stamp.with_suffix(".new")
    temporary.write_text(json.dumps(content, indent=1) + "\n")
    temporary.replace(stamp)


# How a part is made --------------------------------------------------------------------------


def _pip(python: Path) -> list[str | Path]:
    quiet = ("--quiet", "--no-input", "--disable-pip-version-check")
    # Without --no-deps pip looks for the newest release of what packages with extras ask for, and
    # refuses it as not pinned: the lock is complete, so nothing is left to resolve.
    return [python, "-m", "pip", "install", *quiet, "--require-hashes", "--no-deps"]


def _environment() -> dict[str, str]:
    """The variables of a shell in which .venv is active, and nothing of install/ is sourced."""
    variables = dict(os.environ)
    for name in ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH", "PYTHONPATH"):
        entries = variables.pop(name, "").split(os.pathsep)
        others = [entry for entry in entries if entry and not Path(entry).is_relative_to(ROOT)]
        if others:
            variables[name] = os.pathsep.join(others)
    variables["VIRTUAL_ENV"] = str(VENV)
    variables["PATH"] = f"{VENV / 'bin'}{os.pathsep}{variables.get('PATH', os.defpath)}"
    # Says that the library path is set for the ROS 2 wheels: but of which environment?
    variables.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)
    variables.pop("PYTHONHOME", None)
    return variables


def _look_for_compiler() -> None:
    names = [os.environ["CXX"].split()[0]] if os.environ.get("CXX") else ["c++", "g++", "clang++"]
    if not any(shutil.which(name) for name in names):
        raise SetUpError(
            f"the message types need a C++ compiler, and there is none ({', '.join(names)}). "
            "Install one (on Debian and Ubuntu: apt install g++)."
        )


def _run(
    step: str,
    command: list[str | Path],
    lock: IO[str],
    environment: Mapping[str, str] | None = None,
) -> None:
    """Run one step; if it fails, show all that it said."""
    print(f"  {step} ...", end="", flush=True)
    begin = time.monotonic()
    with tempfile.TemporaryFile("w+", errors="replace") as output:
        # In a process group of its own, so that nothing of it is left when it is broken off. It
        # inherits the lock, so that, should this process be killed, the next waits for its end.
        process = subprocess.Popen(
            [str(argument) for argument in command],
            cwd=ROOT,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            pass_fds=(lock.fileno(),),
        )
        try:
            code = process.wait()
        except BaseException:
            print(" broken off", flush=True)
            _end(process)
            raise
        if code == 0:
            print(f" {time.monotonic() - begin:.0f} s", flush=True)
            return
        print(" failed", flush=True)
        _end(process)
        output.seek(0)
        sys.stdout.write(output.read())
        sys.stdout.flush()
    raise SetUpError(
        f"the step '{step}' failed with exit code {code}; above is its output. What it left is "
        "not used: when the cause is mended, call make again.\n"
        f"  {' '.join(str(argument) for argument in command)}"
    )


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a step and all that it started, some of which may outlive it."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


@contextmanager
def _only_one_at_a_time() -> Iterator[IO[str]]:
    with LOCK.open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("set-up: another one is at work in this folder; waiting for it", flush=True)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield lock


def _terminated(number: int, frame: object) -> NoReturn:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
