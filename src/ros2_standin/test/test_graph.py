"""Looking at, and talking to, nodes of another process."""

import signal

import pytest
import yaml

pytestmark = pytest.mark.usefixtures("remote")


def test_nodes(ros2, eventually):
    listed = eventually("node", "list", until=lambda o: o.out.count("\n") >= 2)
    assert listed.out == "/axis/listener\n/remote\n"
    parts = (
        "  Publishers:\n    /latched: std_msgs/msg/String\n",
        "    /remote/get_state: lifecycle_msgs/srv/GetState\n",
    )
    info = eventually(
        "node", "info", "/remote", until=lambda o: all(part in o.out for part in parts)
    ).out
    assert info.startswith("/remote\n  Subscribers:\n")
    assert "_hidden" not in info
    assert ros2("node", "info", "/nope") == (1, "", "Unable to find node '/nope'\n")


def test_topics(ros2, eventually):
    listed = eventually("topic", "list", "-t", until=lambda o: "/ticks" in o.out).out
    assert "/ticks [std_msgs/msg/Header]\n" in listed
    assert "_hidden" not in listed
    seen = eventually("topic", "info", "/latched", until=lambda o: o.out.count(" 1\n") == 2)
    assert seen.out == "Type: std_msgs/msg/String\nPublisher count: 1\nSubscription count: 1\n"
    assert ros2("topic", "info", "/nope") == (1, "", "Unknown topic '/nope'\n")
    typed = eventually("topic", "type", "/ticks", until=lambda o: o.code == 0)
    assert typed.out == "std_msgs/msg/Header\n"


def test_services(ros2, eventually):
    name = "/remote/get_state"
    listed = eventually("service", "list", until=lambda o: name in o.out).out
    assert f"{name}\n" in listed
    kind = "lifecycle_msgs/srv/GetState"
    assert eventually("service", "type", name, until=lambda o: o.code == 0).out == f"{kind}\n"
    answer = ros2("service", "call", name, kind).out
    assert "requester: making request: lifecycle_msgs.srv.GetState_Request()\n\n" in answer
    assert "response:\nlifecycle_msgs.srv.GetState_Response(" in answer
    assert ros2("service", "call", name, "lifecycle_msgs/srv/Nope").code == 1


def test_a_call_ends_when_its_server_has_gone(start, slow_server):
    call = start("service", "call", "/slow", "std_srvs/srv/Trigger")
    slow_server.wait_for("asked")
    slow_server.end(signal.SIGTERM)
    assert call.end() == 1
    assert "No answer: who offered the service /slow has gone" in call.output, call.output


def test_parameters(ros2, tmp_path):
    assert ros2("param", "get", "remote", "gain").out == "Double value is: 1.5\n"
    assert ros2("param", "get", "/remote", "filter.names").out == "String values are: ['a', 'b']\n"
    assert ros2("param", "get", "remote", "number", "--hide-type").out == "7\n"
    assert ros2("param", "get", "remote", "nope") == (1, "", "Parameter not set\n")
    assert ros2("param", "set", "remote", "gain", "2.5").out == "Set parameter successful\n"
    refused = ros2("param", "set", "remote", "mode", "bad")
    assert refused == (0, "", "Setting parameter failed: 'bad' is no mode\n")
    assert ros2("param", "describe", "remote", "gain", "number").out == (
        "Parameter name: gain\n  Type: double\n  Description: Gain (V/A)\n  Constraints:\n"
        "    Min value: 0.0\n    Max value: 10.0\n"
        "Parameter name: number\n  Type: integer\n  Constraints:\n    Read only: true\n"
    )
    dump = ros2("param", "dump", "remote").out
    values = yaml.safe_load(dump)["/remote"]["ros__parameters"]
    assert values["gain"] == 2.5
    assert values["filter"] == {"names": ["a", "b"], "poles": [1.0, 2.0]}
    file = tmp_path / "p.yaml"
    file.write_text("/**:\n  ros__parameters: {gain: 3.5, number: 8}\n")
    loaded = ros2("param", "load", "remote", file)
    assert loaded.out == "Set parameter gain successful\n"
    assert loaded.err.startswith("Set parameter number failed: ")


def test_parameters_are_loaded_from_the_section_of_the_node(ros2, tmp_path):
    file = tmp_path / "p.yaml"
    mine, other = "ros__parameters: {gain: 4.5}", "ros__parameters: {gain: 7.5}"
    for text in (
        f"/other: {{{other}}}\n/remote: {{{mine}}}\n/zzz: {{{other}}}\n",
        f"other: {{{other}}}\nremote: {{{mine}}}\n",
        f"/remote: {{{mine}}}\n/**: {{{other}}}\n",
        f"/**: {{{mine}}}\n/other: {{{other}}}\n",
    ):
        ros2("param", "set", "remote", "gain", "1.5")
        file.write_text(text)
        assert ros2("param", "load", "remote", file).out == "Set parameter gain successful\n"
        assert ros2("param", "get", "remote", "gain").out == "Double value is: 4.5\n", text
    file.write_text(f"/other: {{{other}}}\n")
    refused = ros2("param", "load", "remote", file)
    assert refused.code == 1
    assert refused.err.endswith("it has nothing for /remote, only for /other\n")


def test_parameters_of_all_nodes(ros2, eventually):
    listed = eventually("param", "list", until=lambda o: "/remote:" in o.out and "/axis" in o.out)
    assert "/remote:\n  filter.names\n  filter.poles\n  gain\n" in listed.out
    typed = eventually("param", "list", "remote", "--param-type", until=lambda o: o.code == 0)
    assert "  mode (type: string)\n" in typed.out


@pytest.mark.parametrize(
    "line", ["param get nope x", "param set nope x 1", "param dump nope", "lifecycle get nope"]
)
def test_node_that_is_not_there(ros2, line):
    assert ros2(*line.split()) == (1, "", "Node not found\n")


def test_lifecycle(ros2, eventually):
    assert eventually("lifecycle", "nodes", until=lambda o: bool(o.out)).out == "/remote\n"
    assert ros2("lifecycle", "get", "remote").out == "unconfigured [1]\n"
    assert ros2("lifecycle", "set", "remote", "configure").out == "Transitioning successful\n"
    assert ros2("lifecycle", "list", "remote").out.startswith(
        "- cleanup [2]\n\tStart: inactive\n\tGoal: cleaningup\n"
    )
    wrong = ros2("lifecycle", "set", "remote", "nope")
    assert wrong.code == 1
    assert wrong.err.startswith("Unknown transition requested, available ones are:\n- cleanup [2]")
    assert ros2("lifecycle", "set", "remote", "2").out == "Transitioning successful\n"


def test_echo(ros2):
    assert ros2("topic", "echo", "--once", "/latched").out == "data: stays\n---\n"
    stamped = ros2("topic", "echo", "--once", "--csv", "/ticks").out
    assert stamped.startswith("0,0,")
    assert ros2("topic", "echo", "--once", "/ticks", "--field", "stamp.sec").out == "0\n---\n"
    wrong = ros2("topic", "echo", "--once", "/ticks", "--field", "nope")
    assert wrong.code == 1
    assert wrong.err.startswith("Invalid field 'nope': ")
    chosen = ros2("topic", "echo", "--once", "/ticks", "--filter", "int(m.frame_id) % 10 == 3")
    assert chosen.out.endswith("3'\n---\n")


def test_echo_of_nothing(ros2):
    assert ros2("topic", "echo", "/nope") == (
        1,
        "WARNING: topic [/nope] does not appear to be published yet\n",
        "Could not determine the type for the passed topic\n",
    )
    assert ros2("topic", "echo", "--timeout", "0.1", "/nope", "std_msgs/msg/String").code == 0


def test_pub(ros2, start):
    echo = start("topic", "echo", "--once", "/said", "std_msgs/msg/String")
    outcome = ros2(
        "topic", "pub", "--times", "3", "--rate", "20", "/said", "std_msgs/String", "data: x"
    )
    assert "publishing #3: std_msgs.msg.String(data='x')\n\n" in outcome.out
    assert echo.end() == 0
    assert echo.output == "data: x\n---\n"
    nobody = ros2("topic", "pub", "-1", "/q", "std_msgs/String", "--max-wait-time-secs", "0.1")
    assert nobody.err.startswith("Timed out waiting for subscribers: Expected 1 ")


@pytest.mark.parametrize(
    ("kind", "code"), [(signal.SIGINT, 2), (signal.SIGTERM, 15)], ids=["SIGINT", "SIGTERM"]
)
def test_measuring_until_stopped(start, kind, code):
    process = start("topic", "hz", "/ticks")
    process.wait_for("average rate: ")
    assert process.end(kind) == code
    assert "Traceback" not in process.output
