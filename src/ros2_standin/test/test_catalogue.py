"""The command line as a whole: what there is, what is missing, and what it costs."""

import subprocess
import sys
from pathlib import Path

import pytest

import ros2_standin
from ros2_standin.catalogue import COMMANDS, MISSING_COMMANDS

FOLDER = Path(ros2_standin.__file__).parent / "commands"


def test_catalogue_lists_the_files():
    listed = {f"{name}/{verb}.py" for name, command in COMMANDS.items() for verb in command.verbs}
    listed |= {f"{name}.py" for name, command in COMMANDS.items() if not command.verbs}
    files = {str(file.relative_to(FOLDER)) for file in FOLDER.rglob("*.py")}
    assert {file for file in files if not file.endswith("__init__.py")} == listed


@pytest.mark.parametrize("line", ["", *COMMANDS])
def test_help(ros2, line):
    outcome = ros2(*line.split(), "-h")
    assert outcome.code == 0
    assert outcome.out.startswith(f"usage: ros2 {line}".rstrip())


def test_command_without_verb_prints_its_help(ros2):
    assert ros2() == ros2("-h")
    assert ros2("topic") == ros2("topic", "-h")


@pytest.mark.parametrize("line", ["nope", "topic nope", "topic list --nope", "param get"])
def test_usage_errors(ros2, line):
    outcome = ros2(*line.split())
    assert outcome.code == 2
    assert outcome.err.startswith("usage: ros2")


@pytest.mark.parametrize(
    "line", [*MISSING_COMMANDS, "topic delay", "pkg create x", "bag record -a --snapshot-mode"]
)
def test_what_is_missing_is_told_in_one_line(ros2, line):
    outcome = ros2(*line.split())
    assert outcome.code == 1
    assert "not in this stand-in" in outcome.err
    assert outcome.err.count("\n") == 1


def test_looking_at_packages_does_without_the_middleware():
    program = (
        "import sys; from ros2_standin.main import execute, parse\n"
        "execute(parse(['pkg', 'list']))\n"
        "sys.exit('rclpy' in sys.modules or 'numpy' in sys.modules)"
    )
    assert (
        subprocess.run([sys.executable, "-c", program], stdout=subprocess.DEVNULL).returncode == 0
    )
