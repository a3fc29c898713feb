"""`ros2 pkg`, `run` and `interface`, on a package made for the test."""

import signal
import sys

import pytest

from ros2_standin.main import execute, parse

PROGRAM = f"""#!{sys.executable}
import sys
print("given", *sys.argv[1:], flush=True)
sys.exit(3 if "fail" in sys.argv else 0)
"""

WAITING = f"""#!{sys.executable}
import signal, sys
signal.signal(signal.SIGTERM, lambda *_: sys.exit(5))
print("waiting", flush=True)
signal.pause()
"""

DEFINITION = """# A thing.

builtin_interfaces/Time stamp   # when it was
Part[<=3] parts     # what it is made of
string name "no # comment"

uint8 GOOD=1
"""


@pytest.fixture
def prefix(tmp_path, monkeypatch):
    """A package `made` with two executables, a manifest and two message definitions."""
    share = tmp_path / "share/made"
    for kind, content in (("packages", ""), ("rosidl_interfaces", "msg/Part.msg\nmsg/Thing.msg")):
        index = tmp_path / "share/ament_index/resource_index" / kind
        index.mkdir(parents=True)
        (index / "made").write_text(content)
    (share / "msg").mkdir(parents=True)
    (share / "msg/Thing.msg").write_text(DEFINITION)
    (share / "msg/Part.msg").write_text("# A part.\nint32 number\n")
    (share / "package.xml").write_text("<package><name>made</name></package>")
    folder = tmp_path / "lib/made"
    (folder / "inner").mkdir(parents=True)
    for name, content in (("program", PROGRAM), ("waiting", WAITING), ("inner/twice", PROGRAM)):
        (folder / name).write_text(content)
        (folder / name).chmod(0o755)
    (folder / "twice").symlink_to(folder / "inner/twice")
    (folder / "data").write_text("not executable")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path), prepend=":")
    return tmp_path


def test_packages(ros2, prefix):
    assert "made\n" in ros2("pkg", "list").out
    assert ros2("pkg", "prefix", "made").out == f"{prefix}\n"
    assert ros2("pkg", "prefix", "--share", "made").out == f"{prefix}/share/made\n"
    assert ros2("pkg", "prefix", "nope") == (1, "", "Package not found\n")


def test_executables(ros2, prefix):
    expected = "made twice\nmade program\nmade twice\nmade waiting\n"
    assert ros2("pkg", "executables", "made").out == expected
    assert f"{prefix}/lib/made/program\n" in ros2("pkg", "executables", "--full-path").out
    assert ros2("pkg", "executables", "nope") == (1, "", "Package 'nope' not found\n")


def test_run(prefix, capfd):
    assert execute(parse(["run", "made", "program", "a", "--ros-args", "-p", "x:=1"])) == 0
    assert execute(parse(["run", "--prefix", f"{sys.executable} -B", "made", "program"])) == 0
    assert execute(parse(["run", "made", "program", "fail"])) == 3
    assert capfd.readouterr().out == (
        "given a --ros-args -p x:=1\ngiven\ngiven fail\n[ros2run]: Process exited with failure 3\n"
    )


def test_run_refuses(ros2, prefix):
    assert ros2("run", "nope", "x").err == "Package 'nope' not found\n"
    assert ros2("run", "made", "data").err == "No executable found\n"
    several = ros2("run", "made", "twice")
    assert several.code == 1
    assert several.err.startswith("Multiple executables found:\n- ")


def test_run_passes_the_end_on(prefix, start):
    process = start("run", "made", "waiting")
    process.wait_for("waiting")
    assert process.end(signal.SIGTERM) == 5
    assert process.output.endswith("Process exited with failure 5\n")


def test_run_tells_of_a_signal(prefix, start):
    (prefix / "lib/made/program").write_text(f"#!{sys.executable}\nimport os; os.abort()")
    process = start("run", "made", "program")
    assert process.end() == 256 - signal.SIGABRT
    assert process.output.endswith("[ros2run]: Aborted\n")


def test_interfaces(ros2, prefix):
    assert ros2("interface", "package", "made").out == "made/msg/Part\nmade/msg/Thing\n"
    assert "    made/msg/Thing\n" in ros2("interface", "list", "-m").out
    assert ros2("interface", "list", "-s").out.startswith("Services:\n")
    assert ros2("interface", "package", "nope") == (1, "", "Unknown package 'nope'\n")


def test_definition(ros2, prefix):
    # What is odd about it (the lone #, the comments of nested types) is as in ROS 2.
    assert ros2("interface", "show", "made/msg/Thing").out == (
        "# A thing.\n\n"
        "builtin_interfaces/Time stamp   # when it was\n\tint32 sec\n\tuint32 nanosec\n"
        "Part[<=3] parts     # what it is made of\n\tint32 number\n"
        'string name "no # comment"\n\nuint8 GOOD=1\n'
    )
    assert ros2("interface", "show", "--no-comments", "made/msg/Thing").out == (
        "builtin_interfaces/Time stamp   #\n\tint32 sec\n\tuint32 nanosec\n"
        "Part[<=3] parts     #\n\tint32 number\n"
        'string name "no # comment"\nuint8 GOOD=1\n'
    )
    assert "\t# A part.\n" in ros2("interface", "show", "--all-comments", "made/msg/Thing").out


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("made", "Invalid name 'made'. Expected three parts separated by '/'"),
        ("nope/msg/X", "Unknown package 'nope'"),
        ("made/msg/../X", "Invalid name 'made/msg/../X'. Expected three parts separated by '/'"),
    ],
)
def test_definition_of_nothing(ros2, prefix, name, reason):
    assert ros2("interface", "show", name) == (1, "", f"{reason}\n")
