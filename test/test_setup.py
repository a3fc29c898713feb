"""The workspace is what its descriptions say; a set-up that fails says so, and is not trusted."""

from __future__ import annotations

import ast
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from xml.etree import ElementTree

import pytest
from ament_index_python import get_package_prefix, get_packages_with_prefixes
from harness import PATIENCE

ROOT = Path(__file__).resolve().parent.parent
PYTHON_PACKAGES = sorted(file.parent.name for file in ROOT.glob("src/*/setup.py"))
OURS = (*PYTHON_PACKAGES, "mfpcc_msgs", "mfpcc_config")
FROM_ROS = get_packages_with_prefixes().keys()
# rosdep knows no key for these; they come from requirements/run.txt and dev.txt alone.
WITHOUT_KEY = ("lz4", "mcap", "motulator", "rosbags", "zstandard")
# Used where somebody has them, and asks for what needs them.
OPTIONAL = {"distributed", "h5py", "optuna", "pandas", "pyarrow"}
# The package of configuration files is used by name, and imported by nobody; what launch files
# import, they import where they are launched.
USED_BY_NAME = {"pwm_node": {"mfpcc_config"}, "mfpcc_experiments": {"launch", "launch_ros"}}
# What the tests of all packages share lies beside this file.
SHARED_BY_TESTS = {file.stem for file in Path(__file__).parent.glob("*.py")}

EXECUTABLES = [
    ("pmsm_sim", "pmsm_sim"),
    ("mfpcc_controller", "controller"),
    ("mfpcc_experiments", "drive"),
    ("mfpcc_experiments", "record"),
    ("mfpcc_experiments", "replay"),
]


def manifest(package: str) -> ElementTree.Element:
    folder = ROOT / ("config" if package == "mfpcc_config" else f"src/{package}")
    return ElementTree.parse(folder / "package.xml").getroot()


def imports(folder: Path) -> set[str]:
    """Top-level names of what the Python files below a folder import, less the standard library."""
    names: set[str] = set()
    for file in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                names.update(alias.name.split(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                names.add(node.module.split(".")[0])
    return names - sys.stdlib_module_names - SHARED_BY_TESTS - OPTIONAL


def dependencies(names: set[str]) -> set[str]:
    """What package.xml calls some imported packages."""
    return {
        name if name in FROM_ROS else f"python3-{name}" for name in names if name not in WITHOUT_KEY
    }


# Packages -------------------------------------------------------------------------------------


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_declared_dependencies_are_the_true_ones(package):
    declared = {node.text for node in manifest(package).iter("exec_depend")}
    used = dependencies(imports(ROOT / "src" / package / package) - {package})
    used |= USED_BY_NAME.get(package, set())
    assert not used - declared, "to be added to package.xml"
    assert not declared - used, "to be removed from package.xml"


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_dependencies_of_the_tests_are_declared(package):
    declared = {
        node.text
        for kind in ("exec_depend", "test_depend")
        for node in manifest(package).iter(kind)
    }
    used = dependencies(imports(ROOT / "src" / package / "test") - {package})
    assert not used - declared, "to be added to package.xml, as test_depend"


def test_dependencies_point_one_way():
    allowed = {
        "pwm_node": set(),
        "pmsm_sim": {"pwm_node", "mfpcc_msgs"},
        "mfpcc_controller": {"pwm_node", "mfpcc_msgs"},
        "mfpcc_experiments": {"pmsm_sim", "mfpcc_controller", "pwm_node", "mfpcc_msgs"},
    }
    for package, may in allowed.items():
        used = imports(ROOT / "src" / package / package) & set(OURS)
        assert used - {package} <= may, package


def test_packages_agree_on_version_and_licence():
    versions = {package: manifest(package).findtext("version") for package in OURS}
    for package in PYTHON_PACKAGES:
        setup = (ROOT / "src" / package / "setup.py").read_text()
        versions[f"{package}/setup.py"] = re.search(r'version="(.+?)"', setup).group(1)
    assert len(set(versions.values())) == 1, versions
    assert {manifest(package).findtext("license") for package in OURS} == {"Apache-2.0"}


def test_every_message_is_generated():
    folder = ROOT / "src/mfpcc_msgs"
    text = (folder / "CMakeLists.txt").read_text()
    for kind in ("msg", "srv"):
        listed = re.findall(rf"\b{kind}/\w+\.{kind}", text)
        assert listed == sorted(f"{kind}/{file.name}" for file in folder.glob(f"{kind}/*"))


@pytest.mark.parametrize(("package", "executable"), EXECUTABLES)
def test_executable_is_where_ros2_run_looks(package, executable):
    file = Path(get_package_prefix(package), "lib", package, executable)
    assert os.access(file, os.X_OK)


def test_command_is_on_the_path():
    assert Path(shutil.which("mfpcc") or "").parts[-3:] == ("mfpcc_experiments", "bin", "mfpcc")


# Requirements ---------------------------------------------------------------------------------


def locked(file: Path) -> dict[str, str]:
    """Version and marker of each package that a lock file names."""
    text = file.read_text().replace("\\\n", " ")
    pinned = {}
    for line in text.splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        hashes = r"(?: +--hash=sha256:[0-9a-f]{64})+ *"
        match = re.fullmatch(rf"([\w.-]+)==([^ ]+)( ; .+?)?{hashes}", line)
        assert match, f"{file.name}: {line[:80]}"
        name, version, marker = match.groups()
        pinned[name + (marker or "")] = version
    return pinned


def locked_names(file: str) -> set[str]:
    return {name.split(" ")[0] for name in locked(ROOT / f"requirements/{file}.txt")}


def test_locks_hold_names_versions_and_hashes_only():
    for file in sorted((ROOT / "requirements").iterdir()):
        assert "://" not in file.read_text(), file.name
    locks = {file.stem: locked(file) for file in (ROOT / "requirements").glob("*.txt")}
    assert {"installer", "seed", "run", "ros", "sweep", "dev", "mutants"} == locks.keys()
    assert all(locks.values())
    for one, other in itertools.combinations(locks, 2):  # they are installed together
        for name in locks[one].keys() & locks[other].keys():
            assert locks[one][name] == locks[other][name], f"{name} in {one} and {other}"


def required(*files: str) -> set[str]:
    """Names that requirements/FILE.in ask for."""
    text = "".join((ROOT / f"requirements/{file}.in").read_text() for file in files)
    lines = [line for line in text.splitlines() if line and line[0] not in "#-"]
    return {re.split(r"[<>=\[; ]", line)[0].replace("-", "_") for line in lines}


def test_all_that_is_imported_is_required():
    used = {name for p in PYTHON_PACKAGES for name in imports(ROOT / "src" / p / p)} - {*FROM_ROS}
    assert {"pyyaml" if name == "yaml" else name for name in used} - required("sweep") == (
        required("run")
    )


def test_all_that_tests_and_tools_import_is_required():
    tools = {file.stem for file in (ROOT / "tools").glob("*.py")}
    folders = [ROOT / "test", ROOT / "bench", ROOT / "tools", *ROOT.glob("src/*/test")]
    ours = {*OURS, *FROM_ROS, *tools, *(file.stem for file in (ROOT / "bench").glob("*.py"))}
    used = {name for folder in folders for name in imports(folder)} - ours
    names = {"yaml": "pyyaml", "markdown_it": "markdown_it_py", "launch": "", "launch_ros": ""}
    used = {names.get(name, name) for name in used}
    assert used - {""} <= required("run", "build", "sweep", "dev", "seed", "mutants")


def test_a_demonstration_needs_nothing_that_only_development_does():
    runs = set().union(*(locked_names(file) for file in ("seed", "run", "ros")))
    for name in ("hypothesis", "motulator", "mypy", "pytest-timeout", "ruff", "uv"):
        assert name in locked_names("dev")
        assert name not in runs
    sweeps = locked_names("sweep")
    assert {"pyarrow", "distributed", "optuna"} <= sweeps - runs
    assert sweeps <= locked_names("dev")  # so that they are tested


# Set-up ---------------------------------------------------------------------------------------


def run(
    *command: str | Path, cwd: Path = ROOT, **variables: str
) -> subprocess.CompletedProcess[str]:
    environment = {"PATH": "/usr/bin:/bin", "HOME": os.environ.get("HOME", "/"), **variables}
    return subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    """Return a workspace with the set-up program and requirements that cannot be had."""
    shutil.copytree(ROOT / "tools", tmp_path / "tools")
    (tmp_path / "requirements").mkdir()
    for name in ("installer", "seed", "run", "ros"):
        lock = f"no-such-package-{name}==1.0 --hash=sha256:{'0' * 64}\n"
        (tmp_path / f"requirements/{name}.txt").write_text(lock)
    return tmp_path


def test_unfit_python_is_told_in_a_sentence(empty):
    python = empty / "python"
    python.write_text('#!/bin/sh\necho "is Python 3.9.18, not 3.10 to 3.13"; exit 1\n')
    python.chmod(0o755)
    done = run(empty / "tools/set_up.sh", "environment", PYTHON=str(python))
    assert done.returncode == 1
    assert "needs CPython 3.10 to 3.13" in done.stderr
    assert f"{python} is Python 3.9.18" in done.stderr
    assert "Traceback" not in done.stderr


def test_another_ros_distribution_is_refused(empty):
    program = (sys.executable, empty / "tools/set_up.py", "environment")
    done = run(*program, ROS_DISTRO="kilted")
    assert done.returncode == 1
    assert "kilted" in done.stderr
    assert "jazzy" in done.stderr
    assert not (empty / ".venv").exists()


def test_failing_step_is_named_shown_and_not_trusted(empty):
    base = getattr(sys, "_base_executable", sys.executable)
    done = run(base, empty / "tools/set_up.py", "environment", PIP_NO_INDEX="1", PIP_FIND_LINKS="")
    assert done.returncode == 1
    assert "the step 'build tools, by pip' failed" in done.stderr
    assert "no-such-package-seed" in done.stdout  # pip's own words
    assert "venv ..." in done.stdout
    assert not (empty / ".venv/.complete").exists()


@pytest.mark.parametrize(
    "name", ["with space", "it's", 'a"quote', "dol$lar", "a:colon", "a%b", "größe"]
)
def test_a_path_that_cannot_work_is_refused_at_once(empty, name):
    folder = empty / name
    folder.mkdir()
    (empty / "tools").rename(folder / "tools")
    (empty / "requirements").rename(folder / "requirements")
    done = run(folder / "tools/set_up.sh", "environment", PYTHON=sys.executable, cwd=folder)
    assert done.returncode == 1
    assert done.stderr.startswith("set-up: the path of this folder")
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""
    assert not (folder / ".venv").exists()


def test_all_that_the_machine_lacks_is_told_before_anything_is_done(empty):
    variables = {"CC": "no-such-cc", "CXX": "g++ -no-such-option", "PATH": "/usr/bin:/bin"}
    done = run(sys.executable, empty / "tools/set_up.py", "workspace", **variables)
    assert done.returncode == 1
    assert "a C compiler (CC=no-such-cc: there is none of that name" in done.stderr
    assert "a C++ compiler that works: g++ -no-such-option says: " in done.stderr
    assert not (empty / ".venv").exists()
    done = run(sys.executable, empty / "tools/set_up.py", "workspace", PATH="/nonexistent")
    assert [line[:14] for line in done.stderr.splitlines()[1:]] == [
        "  - a C compil",
        "  - a C++ comp",
        "  - make (on D",
    ]


def test_an_environment_of_somebody_else_is_left_alone(empty):
    (empty / ".venv").mkdir()
    (empty / ".venv/precious").touch()
    done = run(sys.executable, empty / "tools/set_up.py", "environment")
    assert done.returncode == 1
    assert ".venv was not made by this set-up" in done.stderr
    assert (empty / ".venv/precious").exists()


def test_an_environment_that_is_half_removed_is_ours_and_not_whole(tmp_path, monkeypatch):
    """Whichever file goes first, a set-up that is killed there is followed by another."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    program = import_module("set_up")
    folder = tmp_path / ".venv"
    folder.mkdir()
    names = {
        "VENV": "",
        "MARK": program.MARK.name,
        "ENVIRONMENT_STAMP": program.ENVIRONMENT_STAMP.name,
    }
    for name, file in names.items():
        monkeypatch.setattr(program, name, folder / file)
        if file:
            (folder / file).touch()
    more = {
        part: (lock, folder / stamp.name, what)
        for part, (lock, stamp, what) in program.MORE.items()
    }
    monkeypatch.setattr(program, "MORE", more)
    for _, stamp, _ in more.values():
        stamp.touch()
    (folder / "bin").mkdir()
    (folder / "pyvenv.cfg").touch()

    def killed(path: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(program.shutil, "rmtree", killed)
    with pytest.raises(KeyboardInterrupt):
        program._empty_environment()
    left = {path.name for path in folder.iterdir()}
    assert {program.MARK.name, "bin"} <= left <= {program.MARK.name, "bin", "pyvenv.cfg"}


@pytest.mark.parametrize("python", ["python3.12", "3.12"])
def test_a_python_of_pyenv_is_found_where_it_is_not_active(tmp_path, python):
    there = tmp_path / "home/.pyenv/versions/3.12.77/bin/python"
    there.parent.mkdir(parents=True)
    there.write_text(f"#!/bin/sh\necho {there}\n")
    there.chmod(0o755)
    shim = tmp_path / "python3.12"  # what stands on the path of one who has not activated it
    shim.write_text("#!/bin/sh\necho pyenv: command not found >&2\nexit 127\n")
    shim.chmod(0o755)
    program = ROOT / "tools/set_up.sh"
    path = f"{tmp_path}:/usr/bin:/bin"
    done = run(program, "--which", PYTHON=python, PATH=path, HOME=str(tmp_path / "home"))
    assert (done.returncode, done.stdout) == (0, f"{there}\n"), done.stderr


def test_the_set_up_compiles_what_the_nodes_will_call(monkeypatch):
    import rclpy

    from mfpcc_controller.controller import control
    from mfpcc_controller.node import MfpccController
    from pmsm_sim.node import PmsmSim
    from pmsm_sim.plant import advance, latch

    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    kernels = __import__("kernels")
    kernels.plant()
    kernels.controller()
    compiled = [set(kernel.signatures) for kernel in (latch, advance, control)]
    assert all(compiled)
    rclpy.init()
    try:
        for node in (PmsmSim(), MfpccController()):
            node.trigger_configure()
            assert node.core is not None
            node.destroy_node()
    finally:
        rclpy.shutdown()
    assert [set(kernel.signatures) for kernel in (latch, advance, control)] == compiled


def test_what_is_set_for_another_python_reaches_neither_the_set_up_nor_a_target():
    """With PYTHONWARNINGS=error, say, a warning in any library would end what is run."""
    lists = (
        re.search(r"^unset (PYTHONHOME(?:.|\\\n)*)$", (ROOT / "tools/set_up.sh").read_text(), re.M),
        re.search(r"^unexport (PYTHONHOME(?:.|\\\n)*)$", (ROOT / "Makefile").read_text(), re.M),
    )
    of_set_up, of_targets = ({n for n in re.findall(r"\w+", m[1]) if n[0] != "_"} for m in lists)
    assert of_set_up == of_targets
    rule = "show: ; @env\n"
    done = subprocess.run(
        ["make", "-f", "-", "show"],
        input=(ROOT / "Makefile").read_text() + rule,
        cwd=ROOT,
        env={"PATH": "/usr/bin:/bin", **dict.fromkeys(of_targets, "set")},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    assert not of_targets & {name for name, _ in lines_of(done.stdout)}


# Containers -----------------------------------------------------------------------------------


def test_a_container_is_made_by_the_same_commands():
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    text = (ROOT / "Dockerfile").read_text().replace("\\\n", " ")
    lines = [line.split(maxsplit=1) for line in text.splitlines() if line and line[0] != "#"]
    assert [word for word, _ in lines] == ["FROM", "RUN", "ENV", "WORKDIR", "COPY", "RUN", "CMD"]
    machine, build = (rest for word, rest in lines if word == "RUN")
    assert {"g++", "make"} <= set(machine.split())  # what the README asks of a machine
    (command,) = (json.loads(rest) for word, rest in lines if word == "CMD")
    device = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text())
    for used in (build.split(), command, device["postCreateCommand"].split()):
        assert used[0] == "make" and used[1] in targets, used
    ignored = (ROOT / ".dockerignore").read_text().split()
    assert {".venv", "build", "install", "out"} <= set(ignored)


# A whole set-up -------------------------------------------------------------------------------


def test_nothing_is_done_when_all_is_there():
    python = ROOT / ".venv/bin/python"
    if not python.exists():
        pytest.skip("this workspace was built without the set-up program")
    variables = {k: v for k, v in os.environ.items() if k in ("ROS_DISTRO", "AMENT_PREFIX_PATH")}
    done = run(python, ROOT / "tools/set_up.py", "environment", **variables)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


# Shells and CMake -----------------------------------------------------------------------------


def lines_of(mapping: str) -> Iterator[tuple[str, str]]:
    for line in mapping.splitlines():
        name, _, value = line.partition("=")
        yield name, value


def shell(script: str, cwd: Path, **variables: str) -> Mapping[str, str]:
    done = run("bash", "-euc", script, cwd=cwd, **variables)
    assert done.returncode == 0, done.stderr
    return dict(lines_of(done.stdout))


def test_setup_bash_can_be_sourced_anywhere_and_twice(tmp_path):
    names = "PATH AMENT_PREFIX_PATH ROS_AUTOMATIC_DISCOVERY_RANGE VIRTUAL_ENV"
    show = f"for name in {names}; do echo $name=${{!name}}; done"
    once = shell(f"source '{ROOT}/setup.bash'; {show}", tmp_path)
    twice = shell(f"source '{ROOT}/setup.bash'; source '{ROOT}/setup.bash'; {show}", tmp_path)
    assert once == twice
    assert once["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert f"{ROOT}/install/mfpcc_experiments/bin" in once["PATH"].split(":")
    chosen = shell(
        f"source '{ROOT}/setup.bash'; {show}", tmp_path, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET"
    )
    assert chosen["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"


def test_setup_bash_refuses_where_nothing_is_built(tmp_path):
    shutil.copy(ROOT / "setup.bash", tmp_path)
    done = run("bash", "-uc", f"source '{tmp_path}/setup.bash'; echo code $?", cwd=tmp_path)
    assert done.stdout == "code 1\n"
    assert f"make -C {tmp_path} build" in done.stderr
    assert run("bash", tmp_path / "setup.bash").returncode == 1  # executed, not sourced


def test_setup_bash_refuses_what_was_built_for_another_folder_or_ros(tmp_path):
    """In a copied folder it would start the code of the one it was copied from."""
    shutil.copy(ROOT / "setup.bash", tmp_path)
    for name in (".venv/bin/activate", "install/setup.bash", "install/mfpcc.completion.bash"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"echo sourced {name}; VIRTUAL_ENV=/x\n")
    (tmp_path / "install/.complete").touch()
    stamp = tmp_path / ".venv/.complete"
    script = f"source '{tmp_path}/setup.bash'; echo code $?"
    for folder, ros, distro, said in (
        (ROOT, "PyPI", "", "built in another folder"),
        (tmp_path, "PyPI", "humble", "this shell has ROS 2 humble"),
        (tmp_path, "PyPI", "", ""),
        (tmp_path, "/opt/ros/jazzy", "jazzy", ""),
        (tmp_path, "/opt/ros/jazzy", "", ""),  # what is built sources it
    ):
        stamp.write_text(json.dumps({"folder": f"{folder}/.venv", "ros": ros}, indent=1))
        done = run("bash", "-uc", script, cwd=tmp_path, ROS_DISTRO=distro)
        assert ("sourced" in done.stdout) == (not said), done.stdout
        assert said in done.stderr
        assert len(done.stderr.splitlines()) == bool(said)
        assert done.stdout.endswith(f"code {int(bool(said))}\n")


@pytest.mark.parametrize("wheels", [False, True])
def test_cmake_include_acts_on_the_wheels_only(tmp_path, wheels):
    index = tmp_path / "venv/share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    if wheels:
        (index / "rclpy").touch()
    source = tmp_path / "source"
    source.mkdir()
    (source / "CMakeLists.txt").write_text(
        """cmake_minimum_required(VERSION 3.22)
project(probe NONE)
add_library(imported INTERFACE IMPORTED)
set_target_properties(imported PROPERTIES
  INTERFACE_INCLUDE_DIRECTORIES "/opt/python/cp312/include;/usr/include")
function(report)
  get_target_property(folders imported INTERFACE_INCLUDE_DIRECTORIES)
  file(WRITE result "PREFIXES=$ENV{AMENT_PREFIX_PATH}\\nFOLDERS=${folders}\\n")
endfunction()
cmake_language(DEFER CALL report)
"""
    )
    include = f"-DCMAKE_PROJECT_INCLUDE={ROOT}/tools/ros_wheels.cmake"
    cmake = shutil.which("cmake")
    venv = str(tmp_path / "venv")
    variables = {"VIRTUAL_ENV": venv, "AMENT_PREFIX_PATH": "/elsewhere"}
    done = run(cmake, "-S", source, "-B", tmp_path / "build", include, cwd=source, **variables)
    assert done.returncode == 0, done.stderr
    result = dict(lines_of((source / "result").read_text()))
    if wheels:
        assert result == {"PREFIXES": f"{venv}:/elsewhere", "FOLDERS": "/usr/include"}
    else:
        assert result["PREFIXES"] == "/elsewhere"
        assert result["FOLDERS"] == "/opt/python/cp312/include;/usr/include"
