"""The house stays in order: imports go one way, and folders and files stay small enough to read.

docs/architecture.md is the map; what it says of the packages is checked here too.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("pwm_node", "pmsm_sim", "mfpcc_controller", "mfpcc_experiments", "ros2_standin")
MAY_IMPORT = {
    "pwm_node": set(),
    "pmsm_sim": {"pwm_node"},
    "mfpcc_controller": {"pwm_node"},
    "mfpcc_experiments": {"pwm_node", "pmsm_sim", "mfpcc_controller"},
    "ros2_standin": {"pwm_node"},
}
#: Of mfpcc_experiments, from the bottom up: none imports one that comes after it.
ROOMS = (
    "bags", "measuring", "identifying", "importing", "reporting", "graph", "running", "firmware",
    "sweeping", "tuning", "paper", "proofs", "method", "datasheet", "verbs",
)  # fmt: skip
LONGEST_FILE = 500  # lines
LARGEST_FOLDER = 16  # modules


def folder_of(package: str) -> Path:
    return ROOT / "src" / package / package


def modules(package: str) -> dict[str, Path]:
    """The modules of a package by their dotted names."""
    found = {}
    for path in sorted(folder_of(package).rglob("*.py")):
        parts = path.relative_to(folder_of(package).parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = {name: path for package in PACKAGES for name, path in modules(package).items()}


def imports(tree: ast.AST) -> Iterator[tuple[str, list[str]]]:
    """Modules that are imported, with the names that are taken; in functions and for types too."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module, [alias.name for alias in node.names]
        elif isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, []
        yield from imports(node)


def used_by(path: Path) -> set[str]:
    """Modules of ours that a file imports."""
    found = set()
    for module, names in imports(ast.parse(path.read_text(encoding="utf-8"))):
        submodules = {f"{module}.{name}" for name in names} & set(MODULES)
        found |= submodules
        if module in MODULES and len(submodules) < max(len(names), 1):
            found.add(module)
    return found


def test_no_import_comes_back_to_where_it_began():
    graph = {name: used_by(path) - {name} for name, path in MODULES.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        pytest.fail(f"import circle: {' <- '.join(circle.args[1])}")


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_import_only_what_the_map_allows(package):
    for name, path in modules(package).items():
        others = {used.split(".")[0] for used in used_by(path)} - {package}
        assert others <= MAY_IMPORT[package], f"{name} imports {others - MAY_IMPORT[package]}"


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_import_only_those_below_them(room):
    above = {f"mfpcc_experiments.{other}" for other in ROOMS[ROOMS.index(room) + 1 :]}
    for name, path in modules("mfpcc_experiments").items():
        if name.startswith(f"mfpcc_experiments.{room}"):
            used = {".".join(used.split(".")[:2]) for used in used_by(path)}
            assert not used & above, f"{name} imports {used & above}"


def test_every_room_is_on_the_map():
    rooms = {name.split(".")[1] for name in modules("mfpcc_experiments") if name.count(".") > 1}
    assert rooms == set(ROOMS)
    page = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    for room in ROOMS:
        assert f"| `{room}/` |" in page


@pytest.mark.parametrize("package", ["pmsm_sim", "mfpcc_controller"])
def test_only_the_node_imports_ros(package):
    for name, path in modules(package).items():
        taken = {module for module, _ in imports(ast.parse(path.read_text(encoding="utf-8")))}
        ros = {module for module in taken if module.split(".")[0] == "rclpy"}
        ros |= {module for module in taken if module.startswith("pwm_node.ros")}
        assert not ros or name == f"{package}.node", f"{name} imports {ros}"


def test_no_file_is_too_long():
    lengths = {name: len(path.read_text("utf-8").splitlines()) for name, path in MODULES.items()}
    assert {name: n for name, n in lengths.items() if n > LONGEST_FILE} == {}


def test_no_folder_holds_too_many_modules():
    counts: dict[Path, int] = {}
    for path in MODULES.values():
        if path.name != "__init__.py":
            counts[path.parent] = counts.get(path.parent, 0) + 1
    assert {str(f): n for f, n in counts.items() if n > LARGEST_FOLDER} == {}


def test_the_oldest_python_has_all_that_is_used() -> None:
    """A name that only a newer standard library has is met at run time, on that Python alone."""
    vermin = Path(sys.executable).with_name("vermin")
    options = ("--no-tips", "--quiet", "--target=3.10-", "--violations")
    not_the_module = ("--exclude", "operator.call")  # of a fixture
    places = [ROOT / name for name in ("src", "tools", "bench", "test", "conftest.py")]
    command = [vermin, *options, *not_the_module, *places]
    found = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert found.returncode == 0, found.stdout + found.stderr
