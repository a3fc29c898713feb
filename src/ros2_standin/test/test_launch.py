"""`ros2 launch`: plain launch files run, and end as they should."""

import signal
from pathlib import Path

import pytest
import yaml

from ros2_standin.launching.context import LaunchContext
from ros2_standin.launching.output import LaunchError
from ros2_standin.launching.processes import Node, ParameterValue
from ros2_standin.launching.substitutions import LaunchConfiguration
from ros2_standin.launching.supervisor import Supervisor

HEAD = """
import sys
from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument, ExecuteProcess, GroupAction, IncludeLaunchDescription, LogInfo,
    OpaqueFunction, Shutdown,
)
from launch.conditions import IfCondition, UnlessCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node

def python(program, **options):
    return ExecuteProcess(cmd=[sys.executable, "-u", "-c", program], name="p", **options)
"""

WAIT = "import signal; print('up'); signal.pause()"
DEAF = (
    "import pathlib, signal; signal.signal(signal.SIGINT, signal.SIG_IGN); "
    "pathlib.Path({!r}).touch(); signal.pause()"
)
UNTIL = "import pathlib, time\nwhile not pathlib.Path({!r}).exists(): time.sleep(0.01)"


@pytest.fixture
def file(tmp_path):
    """Write a launch file with these entities."""

    def write(entities, name="x.launch.py", before=""):
        path = tmp_path / name
        path.write_text(
            f"{HEAD}{before}\ndef generate_launch_description():\n"
            f"    return LaunchDescription([{entities}])\n"
        )
        return path

    return write


def test_arguments_are_shown(ros2, file):
    path = file("DeclareLaunchArgument('a', default_value='1', description='A', choices=['1'])")
    assert ros2("launch", path, "--show-args").out == (
        "Arguments (pass arguments as '<name>:=<value>'):\n\n    'a':\n"
        "        A. Valid choices are: ['1']\n        (default: '1')\n"
    )
    assert ros2("launch", file(""), "-s").out.endswith("\n  No arguments.\n")


def test_conditions_and_arguments(ros2, file):
    path = file(
        "DeclareLaunchArgument('go', default_value='true'),"
        "LogInfo(msg=['go is ', LaunchConfiguration('go')]),"
        "LogInfo(msg='if', condition=IfCondition(LaunchConfiguration('go'))),"
        "LogInfo(msg='unless', condition=UnlessCondition(LaunchConfiguration('go'))),"
        "OpaqueFunction(function=lambda context: [LogInfo(msg=str(context.launch_configurations))])"
    )
    said = ros2("launch", path, "go:=0", "other:=x").out.splitlines()[1:]
    assert said == [
        "[INFO] [launch.user]: go is 0",
        "[INFO] [launch.user]: unless",
        "[INFO] [launch.user]: {'go': '0', 'other': 'x'}",
    ]


def test_groups_keep_their_arguments(ros2, file):
    file(
        "DeclareLaunchArgument('a', default_value='none'), LogInfo(msg=LaunchConfiguration('a'))",
        name="inner.launch.py",
    )
    include = (
        "GroupAction([IncludeLaunchDescription(PythonLaunchDescriptionSource("
        "str(Path(__file__).with_name('inner.launch.py'))){})])"
    )
    path = file(
        ",".join([include.format(", launch_arguments=[('a', 'one')]"), include.format("")]),
        before="from pathlib import Path",
    )
    assert ros2("launch", path).out.splitlines()[1:] == [
        "[INFO] [launch.user]: one",
        "[INFO] [launch.user]: none",
    ]


def test_output_and_end(ros2, file):
    outcome = ros2("launch", file("python('print(1); print(2)'), python('raise SystemExit(3)')"))
    assert outcome.code == 0
    lines = outcome.out.splitlines()
    assert lines[1].startswith("[INFO] [p-1]: process started with pid [")
    assert "[p-1] 1" in lines
    assert any(line.startswith("[INFO] [p-1]: process has finished cleanly [pid") for line in lines)
    assert any("[ERROR] [p-2]: process has died [pid " in x and "exit code 3" in x for x in lines)


def test_end_of_one_is_the_end_of_all(ros2, file):
    outcome = ros2("launch", file(f"python({WAIT!r}), python('print(1)', on_exit=Shutdown())"))
    assert (
        "[INFO] [launch]: process[p-2] was required: shutting down launched system" in outcome.out
    )
    assert "[INFO] [p-1]: sending signal 'SIGINT' to process[p-1]" in outcome.out
    assert "[ERROR] [p-1]: process has died" in outcome.out


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_stopping(start, file, kind):
    process = start("launch", file(f"python({WAIT!r})"))
    process.wait_for("[p-1] up")
    assert process.end(kind) == 0
    assert "[WARNING] [launch]: user interrupted with" in process.output
    assert "[INFO] [p-1]: sending signal 'SIGINT'" in process.output


def test_who_does_not_listen_is_told_louder(ros2, file, monkeypatch, tmp_path):
    monkeypatch.setattr("ros2_standin.launching.supervisor.PATIENCE", 0.2)
    deaf = str(tmp_path / "deaf")
    first, second = DEAF.format(deaf), UNTIL.format(deaf)
    path = file(f"python({first!r}), python({second!r}, on_exit=Shutdown())")
    said = ros2("launch", path).out
    assert (
        "failed to terminate '0.2' seconds after receiving 'SIGINT', escalating to 'SIGTERM'"
        in said
    )
    assert "exit code -15" in said


def test_node_that_is_not_there(ros2, file):
    said = ros2("launch", file("Node(package='ros2_standin', executable='x')")).out
    assert "executable 'x' not found in package 'ros2_standin'" in said
    assert (
        "package 'nope' not found"
        in ros2("launch", file("Node(package='nope', executable='x')")).out
    )


def command_line(node, context, monkeypatch):
    """Return the command line of a node, and what its parameter files hold."""
    monkeypatch.setattr(node, "_path", lambda context: "/e")
    command = node.command(context)
    files = [command[n + 1] for n, part in enumerate(command) if part == "--params-file"]
    held = [yaml.safe_load(Path(file).read_text()) for file in files if Path(file).is_file()]
    return command, [one["/**"]["ros__parameters"] for one in held]


def test_command_line_of_a_node(tmp_path, monkeypatch):
    context = LaunchContext({"g": "2"}, Supervisor(tmp_path))
    node = Node(
        package="p",
        executable="e",
        name="n",
        namespace="axis",
        arguments=["a"],
        parameters=["f.yaml", {"gain": LaunchConfiguration("g"), "mode": "fast", "x": 1.5}],
        remappings=[("old", "new")],
        ros_arguments=["--log-level", "warn"],
    )
    command, values = command_line(node, context, monkeypatch)
    command.pop(-3)
    assert " ".join(command) == (
        "/e a --ros-args --log-level warn -r __node:=n -r __ns:=/axis "
        "--params-file f.yaml --params-file -r old:=new"
    )
    assert values == [{"gain": 2, "mode": "fast", "x": 1.5}]


def test_every_dict_of_parameters_counts(tmp_path, monkeypatch):
    context = LaunchContext({}, Supervisor(tmp_path))
    dicts = [{"a": 1}, {"b": 2, "a": 3}, {"c": {"d": 4}}]
    for _ in range(2):  # nor does a second node overwrite them
        node = Node(package="p", executable="e", parameters=dicts)
        assert command_line(node, context, monkeypatch)[1] == dicts


@pytest.mark.parametrize(
    ("given", "value"),
    [
        # as the real launch_ros takes them
        ("2025", "2025"),
        ("/x/box #1", "/x/box #1"),
        ("a: b", "a: b"),
        ("", ""),
        ("true", "true"),
        (["1", "a: b"], ["1", "a: b"]),
        ([1, 2.5], [1.0, 2.5]),
        (LaunchConfiguration("number"), 2025),
        (LaunchConfiguration("empty"), ""),
        ([LaunchConfiguration("number"), ".5"], 2025.5),
        (ParameterValue(LaunchConfiguration("number"), value_type=str), "2025"),
        (ParameterValue(LaunchConfiguration("odd"), value_type=str), "a: b"),
        (ParameterValue(LaunchConfiguration("number"), value_type=float), 2025.0),
        (ParameterValue(LaunchConfiguration("number")), 2025),
        (ParameterValue("2025", value_type=str), "2025"),
    ],
)
def test_text_stays_text(tmp_path, monkeypatch, given, value):
    context = LaunchContext({"number": "2025", "odd": "a: b", "empty": ""}, Supervisor(tmp_path))
    node = Node(package="p", executable="e", parameters=[{"x": given}])
    [values] = command_line(node, context, monkeypatch)[1]
    assert values == {"x": value} and type(values["x"]) is type(value)


@pytest.mark.parametrize("given", ["a: b", "[1", "null", "{}"])
def test_text_that_no_parameter_can_be_in_yaml_is_told(tmp_path, monkeypatch, given):
    context = LaunchContext({"x": given}, Supervisor(tmp_path))
    node = Node(package="p", executable="e", parameters=[{"x": LaunchConfiguration("x")}])
    with pytest.raises(LaunchError, match="value_type=str"):
        command_line(node, context, monkeypatch)


@pytest.mark.parametrize(
    ("entities", "reason"),
    [
        ("DeclareLaunchArgument('a')", "Required launch argument 'a'"),
        ("DeclareLaunchArgument('a', default_value='2', choices=['1'])", "is not valid. Valid"),
        ("LogInfo(msg='', condition=IfCondition('maybe'))", "neither true nor false"),
        ("LogInfo(msg=LaunchConfiguration('a'))", "launch configuration 'a' does not exist"),
        ("ExecuteProcess(cmd=['/nope'])", "No such file or directory"),
        ("1 / 0", "division by zero"),
    ],
)
def test_errors_in_launch_files(ros2, file, entities, reason):
    outcome = ros2("launch", file(entities))
    assert outcome.code == 1
    assert outcome.out.count("[ERROR] [launch]: Caught exception in launch") == 1
    assert reason in outcome.out


def test_what_is_missing_of_launch_is_told(ros2, file):
    outcome = ros2("launch", file("", before="from launch.actions import TimerAction"))
    assert outcome.code == 1
    assert "launch.actions.TimerAction: not in this stand-in" in outcome.out


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("nope x.launch.py", "Package 'nope' not found"),
        ("ros2_standin nope.launch.py", "file 'nope.launch.py' was not found in the share"),
        (f"{__file__} a", "malformed launch argument 'a'"),
    ],
)
def test_usage(ros2, line, reason):
    outcome = ros2("launch", *line.split())
    assert outcome.code == 1
    assert reason in outcome.err
