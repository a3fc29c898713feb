"""Prove that the environment of this Python is what lock files say: all of it, nothing else.

    check_environment.py LOCK...

Each package that a lock names for this machine is there in that version; each that is there is
named (pip apart, which Python's own `venv` puts there); and what each one requires is there too, so
that the locks are complete, though nothing was resolved. Exit code 1, and a line for each fault.
"""

from __future__ import annotations

import sys
import sysconfig
from collections.abc import Iterable, Iterator
from importlib import import_module
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

at = Distribution.at
# What `venv` itself installs.
PYTHONS_OWN = {"pip"}
# What everything stands on: the build, the kernels, ROS 2.
IMPORTED = ("colcon_core", "numba", "rclpy")


def locked(file: Path) -> Iterator[Requirement]:
    """Yield the packages that a lock file names for this machine."""
    for line in file.read_text().replace("\\\n", " ").splitlines():
        pinned = line.partition("--hash")[0].strip()
        if pinned and not pinned.startswith("#"):
            requirement = Requirement(pinned)
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                yield requirement


def faults(files: Iterable[Path]) -> Iterator[str]:
    """Yield where environment and locks differ."""
    wanted = {canonicalize_name(r.name): r for file in files for r in locked(file)}
    folders = {Path(sysconfig.get_path(kind)) for kind in ("purelib", "platlib")}
    described = [path for folder in folders for path in folder.glob("*.*-info")]
    there = {canonicalize_name(at(path).metadata["Name"]): path for path in described}
    for name, requirement in wanted.items():
        if name not in there:
            yield f"{requirement} is locked, and not installed"
        elif at(there[name]).version not in requirement.specifier:
            yield f"{requirement} is locked, and {at(there[name]).version} is installed"
        else:
            yield from missing(name, "")
    # The wheels of ROS 2 hold descriptions of what is inside them, too.
    locked_files = {
        file.parts[0]
        for name in wanted.keys() & there.keys()
        for file in at(there[name]).files or ()
    }
    for name in there.keys() - wanted.keys() - PYTHONS_OWN:
        if there[name].name not in locked_files:
            yield f"{name} {at(there[name]).version} is installed, and in no lock"


def missing(name: str, extra: str) -> Iterator[str]:
    """Yield what a package, or one of its extras, requires and does not have."""
    for text in distribution(name).requires or ():
        requirement = Requirement(text)
        marker = requirement.marker
        if marker and not marker.evaluate({"extra": extra}):
            continue
        if extra and (not marker or marker.evaluate({"extra": ""})):
            continue  # required without the extra too, and looked at then
        try:
            version = distribution(requirement.name).version
        except PackageNotFoundError:
            yield f"{name} requires {requirement}, and there is none"
            continue
        if not requirement.specifier.contains(version, prereleases=True):
            yield f"{name} requires {requirement}, and {version} is installed"
        for own in requirement.extras:
            if (requirement.name, own) != (name, extra):
                yield from missing(requirement.name, own)


def main(files: Iterable[str]) -> int:
    found = sorted(set(faults(Path(file) for file in files)))
    for line in found:
        print(line)
    if found:
        return 1
    for name in IMPORTED:
        import_module(name)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
