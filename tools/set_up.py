"""Set up what is missing, and nothing that is not.

    set_up.py environment    .venv: a Python environment with what runs and builds, ROS 2 included
    set_up.py workspace      that, and build/ and install/: the packages of src/ and config/
    set_up.py sweeps         .venv, and in it what sweeps and tuning need
    set_up.py development    .venv, and in it what tests, checks and measures; sweeps too

Several may be named. What the machine must have is looked at first.

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
import re
import shutil
import signal
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NoReturn
from xml.etree import ElementTree

import machine
from installer import Installer
from steps import SetUpError, StepError, Steps, show

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
BUILD = ROOT / "build"
INSTALL = ROOT / "install"
REQUIREMENTS = ROOT / "requirements"

# The same names are in .gitignore and, for the workspace, in setup.bash.
ENVIRONMENT_STAMP = VENV / ".complete"
WORKSPACE_STAMP = INSTALL / ".complete"
LOCK = ROOT / ".set-up.lock"
# The first thing that is put into .venv: what is not marked was made by somebody else.
MARK = VENV / ".made-by-set-up"

THIS_PYTHON = [sys.executable, sys.version.split()[0]]

# Folders of a package that are linked or listed when it is installed: a new file in them needs a
# new build, a changed one does not. Python modules need none: the installed package is a link.
LISTED = (
    "bin",
    "path",
    "resource",
    "motors",
    "experiments",
    "maps",
    "sweeps",
    "tuning",
    "parameters",
    "layouts",
)
# Files of a package that a build reads.
READ = ("package.xml", "setup.py", "setup.cfg", "CMakeLists.txt", "msg/*", "srv/*", "action/*")

Stamp = dict[str, Any]


# Parts that are packages more in .venv: the lock, the stamp, and what is said.
MORE = {
    "sweeps": (
        REQUIREMENTS / "sweep.txt",
        VENV / ".sweeps-complete",
        "what sweeps and tuning need",
    ),
    "development": (
        REQUIREMENTS / "dev.txt",
        VENV / ".development-complete",
        "what tests, checks and measures",
    ),
}
PARTS = ("environment", "workspace", *MORE)


def main() -> int:
    """Make the parts that are asked for, and those they need."""
    parser = argparse.ArgumentParser(description="Set up what is missing.")
    parser.add_argument("parts", nargs="+", choices=PARTS, metavar="|".join(PARTS))
    parts = parser.parse_args().parts
    for number in (signal.SIGTERM, signal.SIGHUP):  # ended, or its terminal is closed
        signal.signal(number, _terminated)
    try:
        wrong = machine.path_problem(ROOT)
        if wrong:
            raise SetUpError(wrong)
        if not all(_is_complete(part) for part in parts):
            _look_at_the_machine()
            with _only_one_at_a_time() as lock:
                _make(parts, Steps(ROOT, lock))
    except SetUpError as error:
        if isinstance(error, StepError):
            show(error)
        print(f"set-up: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        print(f"set-up: {where}{error.strerror}", file=sys.stderr)
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
    if part in MORE:
        lock, stamp, _ = MORE[part]
        return _read(stamp) == _stamp_of(lock)
    return True


def _make(parts: list[str], steps: Steps) -> None:
    if not _environment_is_complete():
        _make_environment(steps)
    if "workspace" in parts and not _is_complete("workspace"):
        _make_workspace(steps)
    for part in MORE:
        if part in parts and not _is_complete(part):
            _make_more(part, steps)


def _environment_is_complete() -> bool:
    stamp = _read(ENVIRONMENT_STAMP)
    made_of = stamp.pop("python", [])
    # Any Python will do that the environment was made of once, unless another one is asked for by
    # name just now, or it was replaced by another version (as a machine's upgrade does).
    replaced = made_of != THIS_PYTHON and made_of[:1] == THIS_PYTHON[:1]
    if replaced or (os.environ.get("PYTHON") and made_of != THIS_PYTHON):
        return False
    return stamp == _environment_stamp() and (VENV / "bin/python").exists()


def _look_at_the_machine() -> None:
    distro = os.environ.get("ROS_DISTRO", "")
    if distro not in ("", "jazzy"):
        raise SetUpError(
            f"ROS 2 {distro} is sourced in this shell, and this project is made for jazzy. Source "
            "jazzy, or use a shell without ROS_DISTRO: then ROS 2 Jazzy comes from PyPI."
        )
    lacks = list(machine.problems(ROOT, _environment()))
    if lacks:
        raise SetUpError("\n  - ".join(("this machine lacks what the set-up needs:", *lacks)))


def _make_environment(steps: Steps) -> None:
    ours = MARK.exists() or ENVIRONMENT_STAMP.exists()
    if VENV.exists() and not ours and any(VENV.iterdir()):
        raise SetUpError(
            f"{VENV} was not made by this set-up, which would replace it: move it away, or remove "
            "it, and call make again"
        )
    print(f"set-up: Python environment .venv, of {' '.join(THIS_PYTHON)}", flush=True)
    _empty_environment()
    # What the machine's ROS 2 imports (lark, empy, ...) is among the machine's Python packages.
    see_machine = ["--system-site-packages"] if os.environ.get("ROS_DISTRO") else []
    venv = [sys.executable, "-m", "venv", *see_machine, str(VENV)]
    steps.run("venv", venv, environment=_environment())
    locks = _locks()
    with _installer(steps) as installer:
        # The first one alone: it is what builds the one package that has no wheel.
        installer.install("build tools", locks[0])
        installer.install("packages", *locks[1:])
    _check_environment(steps, *locks)
    _write(ENVIRONMENT_STAMP, {**_environment_stamp(), "python": THIS_PYTHON})


def _empty_environment() -> None:
    """Leave nothing of .venv but its mark, in an order that may be broken off anywhere.

    While something is there, it is marked as ours; and before the first file goes, the stamps are
    gone.
    """
    if VENV.is_symlink():
        VENV.unlink()
    VENV.mkdir(exist_ok=True)
    MARK.touch()
    for stamp in (ENVIRONMENT_STAMP, *(stamp for _, stamp, _ in MORE.values())):
        stamp.unlink(missing_ok=True)
    for path in VENV.iterdir():
        if path != MARK:
            _remove(path)


def _make_more(part: str, steps: Steps) -> None:
    lock, stamp, what = MORE[part]
    stamp.unlink(missing_ok=True)
    print(f"set-up: {what}", flush=True)
    _forget(_names((lock,)) - _names(_locks()))
    with _installer(steps) as installer:
        installer.install("packages", lock)
    # what another part has put there stays
    there = [lock for lock, stamp, _ in MORE.values() if stamp.exists()]
    _check_environment(steps, *_locks(), *there, lock)
    _write(stamp, _stamp_of(lock))


def _forget(names: set[str]) -> None:
    """Have some packages installed again: an interrupted set-up may have left half of them.

    Either installer takes a package for installed that has a description, and has otherwise no
    trouble with writing over what is there.
    """
    for description in VENV.glob("lib/python*/site-packages/*.dist-info"):
        if _normal(description.name.split("-")[0]) in names:
            _remove(description)


def _names(locks: Iterable[Path]) -> set[str]:
    pinned = re.compile(r"^([\w.-]+)==", re.MULTILINE)
    return {_normal(name) for lock in locks for name in pinned.findall(lock.read_text())}


def _normal(name: str) -> str:
    """Return a package's name as it is compared."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _installer(steps: Steps) -> Installer:
    return Installer(VENV, REQUIREMENTS / "installer.txt", steps, _environment())


def _check_environment(steps: Steps, *locks: Path) -> None:
    command = [VENV / "bin/python", ROOT / "tools/check_environment.py", *locks]
    steps.run("check", command, environment=_environment())


def _make_workspace(steps: Steps) -> None:
    old, new = _read(WORKSPACE_STAMP), _workspace_stamp()
    WORKSPACE_STAMP.unlink(missing_ok=True)
    packages: dict[str, str] = new["packages"]
    if old.get("for_all") == new["for_all"]:
        before: dict[str, str] = old["packages"]
        changed = [name for name in packages if packages[name] != before.get(name)]
        for name in {*changed, *(before.keys() - packages.keys())}:
            _remove(BUILD / name)
            _remove(INSTALL / name)
    else:
        changed = list(packages)
        for folder in (BUILD, INSTALL, ROOT / "log"):
            _remove(folder)

    print(f"set-up: workspace ({', '.join(changed) or 'nothing to build'})", flush=True)
    if changed:
        colcon = (VENV / "bin/python", "-m", "colcon", "build")
        options = ("--event-handlers", "console_direct+", "--packages-select", *changed)
        steps.run("colcon build", [*colcon, *options], environment=_environment())
    completion = INSTALL / "mfpcc.completion.bash"
    write = f"_MFPCC_COMPLETE=bash_source mfpcc > {completion}"
    sourced = f"source install/setup.bash && {write}"
    steps.run("tab completion", ["bash", "-c", sourced], environment=_environment())
    # Plant and controller at the same time: each takes a core.
    compiled = [
        ["bash", "-c", f"source install/setup.bash && exec python tools/kernels.py {part}"]
        for part in ("plant", "controller")
    ]
    steps.run("kernels", *compiled, environment=_environment())
    _write(WORKSPACE_STAMP, new)


# What a part is made from --------------------------------------------------------------------


def _locks() -> list[Path]:
    sourced = bool(os.environ.get("ROS_DISTRO"))
    names = ("seed.txt", "run.txt") if sourced else ("seed.txt", "run.txt", "ros.txt")
    return [REQUIREMENTS / name for name in names]


def _environment_stamp() -> Stamp:
    sourced = _environment().get("AMENT_PREFIX_PATH", "") if os.environ.get("ROS_DISTRO") else ""
    return {
        "folder": str(VENV),  # scripts in an environment name it, so a moved one is of no use
        "ros": sourced or "PyPI",
        "requirements": _hash_of(_locks()),
    }


def _workspace_stamp() -> Stamp:
    shared = ("colcon.meta", "colcon_defaults.yaml", "tools/ros_wheels.cmake")
    return {
        "for_all": [_read(ENVIRONMENT_STAMP), _hash_of(ROOT / name for name in shared)],
        "packages": {name: _hash_of_package(folder) for name, folder in _packages()},
        "besides": ["completion", "kernels"],
    }


def _stamp_of(lock: Path) -> Stamp:
    return {"environment": _read(ENVIRONMENT_STAMP), "requirements": _hash_of([lock])}


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


def _environment() -> dict[str, str]:
    """The variables of a shell in which .venv is active, and nothing of install/ is sourced.

    Variables that change what Python, CMake, colcon or make do, and that somebody set for another
    project, do not reach the set-up.
    """
    variables = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("PYTHON", "CMAKE_", "COLCON_")) and name not in _NOT_FOR_US
    }
    paths = ["AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH"]
    if os.environ.get("ROS_DISTRO"):
        paths.append("PYTHONPATH")  # so a sourced ROS 2 is found; without it, it is not for us
    for name in paths:
        entries = os.environ.get(name, "").split(os.pathsep)
        others = [entry for entry in entries if entry and not Path(entry).is_relative_to(ROOT)]
        if others:
            variables[name] = os.pathsep.join(others)
        else:
            variables.pop(name, None)
    variables["PYTHONNOUSERSITE"] = "1"
    variables["VIRTUAL_ENV"] = str(VENV)
    variables["PATH"] = f"{VENV / 'bin'}{os.pathsep}{variables.get('PATH', os.defpath)}"
    return variables


_NOT_FOR_US = (
    # Says that the library path is set for the ROS 2 wheels: but of which environment?
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
    "BASH_ENV",
    "DESTDIR",
    "MAKEFLAGS",
    "MAKELEVEL",
    "MFLAGS",
)


def _remove(folder: Path) -> None:
    """Remove what the set-up made before, whole."""
    if folder.is_symlink() or folder.is_file():
        folder.unlink()
    elif folder.exists():
        try:
            shutil.rmtree(folder)
        except OSError as error:
            raise SetUpError(f"{error.filename} cannot be removed: {error.strerror}") from None


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
