"""What the machine must have for the set-up, looked at before anything is done."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sysconfig
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

# colcon's scripts and the message generators are not made for other ones, in the path of any file.
_PATH = re.compile(r"[\w./+@~,=-]+", re.ASCII)
# What .venv, build and install take (GB), with the wheels in the cache beside them.
_ROOM = 2.0

_C = "#include <stdio.h>\nint main(void) { return 0; }\n"
_CXX = "#include <Python.h>\n#include <string>\nint main() { return std::string().size(); }\n"


def path_problem(folder: Path) -> str | None:
    """Return what is wrong with the path of the workspace, if anything."""
    wrong = sorted(set(_PATH.sub("", str(folder))))
    if not wrong:
        return None
    return (
        f"the path of this folder, '{ascii(str(folder))[1:-1]}', holds "
        f"{' and '.join(ascii(character) for character in wrong)}, which colcon and CMake cannot "
        "cope with. Move it to a path of letters a to z, digits and _ - . only"
    )


def problems(folder: Path, variables: Mapping[str, str]) -> Iterator[str]:
    """What is missing for making the environment and the workspace in a folder."""
    if not os.access(folder, os.W_OK):
        yield f"{folder} cannot be written: the set-up makes .venv, build and install there"
    elif shutil.disk_usage(folder).free < _ROOM * 1e9:
        free = shutil.disk_usage(folder).free / 1e9
        yield f"room on the disk of {folder}: {free:.1f} GB are free, and {_ROOM:.0f} GB are needed"
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        yield "a folder for temporary files that can be written (TMPDIR)"
        return
    headers = Path(sysconfig.get_path("include"))
    if not (headers / "Python.h").is_file():
        yield (
            f"Python's header files, {headers}/Python.h (on Debian and Ubuntu: apt install "
            "python3-dev)"
        )
        headers = Path()
    yield from _compiler("C", "CC", ("cc", "gcc", "clang"), _C, headers, variables)
    source = _CXX if headers.name else _CXX.replace("#include <Python.h>\n", "")
    yield from _compiler("C++", "CXX", ("c++", "g++", "clang++"), source, headers, variables)
    if not shutil.which("make", path=variables.get("PATH")):
        yield "make (on Debian and Ubuntu: apt install make)"


def _compiler(
    language: str,
    variable: str,
    names: tuple[str, ...],
    source: str,
    headers: Path,
    variables: Mapping[str, str],
) -> Iterator[str]:
    """Say what is wrong with the compiler that CMake will take, if anything."""
    chosen = variables.get(variable, "").strip()
    try:
        candidates = [shlex.split(chosen)] if chosen else [[name] for name in names]
    except ValueError as error:
        yield f"a {language} compiler: {variable}={chosen} cannot be read ({error})"
        return
    found = next((c for c in candidates if shutil.which(c[0], path=variables.get("PATH"))), None)
    if found is None:
        asked = f"{variable}={chosen}: there is none of that name" if chosen else ", ".join(names)
        yield f"a {language} compiler ({asked}; on Debian and Ubuntu: apt install g++)"
        return
    suffix = {"C": "c", "C++": "c++"}[language]
    with tempfile.TemporaryDirectory() as scratch:
        done = subprocess.run(
            [*found, "-x", suffix, "-", f"-I{headers}", "-o", f"{scratch}/probe"],
            input=source,
            env=dict(variables),
            capture_output=True,
            text=True,
            errors="replace",
        )
    if done.returncode != 0:
        said = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr)
        yield f"a {language} compiler that works: {shlex.join(found)} says: {said.strip()}"
