"""Messages as text, and from text."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterValue
from std_msgs.msg import Float64MultiArray, Header, String

from ros2_standin.messages import Style, fill, read_values
from ros2_standin.types import interface_class, message_class


@pytest.fixture
def message():
    status = DiagnosticStatus(level=b"\x02", name="naïve", values=[KeyValue(key="k" * 9)])
    return DiagnosticArray(status=[status, DiagnosticStatus()])


def test_yaml(message):
    lines = Style(length=8).yaml(message).splitlines()
    assert lines[:6] == [
        "header:",
        "  stamp:",
        "    sec: 0",
        "    nanosec: 0",
        "  frame_id: ''",
        "status:",
    ]
    assert '- level: "\\x02"' in lines
    assert "  name: naïve" in lines
    assert "  - key: kkkkkkkk..." in lines


def test_long_sequences_are_cut():
    message = Float64MultiArray(data=[0.5, 1.5, 2.5])
    assert "data:\n- 0.5\n- 1.5\n- '...'\n" in Style(length=2).yaml(message)
    assert Style(length=2).csv(message).endswith("0.5,1.5,...")
    assert "data: [0.5, 1.5, 2.5]\n" in Style().yaml(message, flow=True)


def test_outlines(message):
    text = Style(no_arr=True, no_str=True).yaml(message)
    assert "'<sequence type: diagnostic_msgs/msg/DiagnosticStatus, length: 2>'" in text
    assert "frame_id: '<string length: <0>>'" in text


def test_csv(message):
    assert Style().csv(message) == "0,0,,b'\\x02',naïve,,,kkkkkkkkk,,b'\\x00',,,,"


def test_numpy_numbers_are_plain():
    kind = interface_class("unique_identifier_msgs/msg/UUID")
    assert Style().yaml(kind()) == "uuid:\n" + 16 * "- 0\n"


def test_fill():
    message = DiagnosticArray()
    fill(message, {"status": [{"name": "a", "values": [{"key": "k"}]}], "header": {"frame_id": 3}})
    assert message.status == [DiagnosticStatus(name="a", values=[KeyValue(key="k")])]
    assert message.header.frame_id == "3"
    value = ParameterValue()
    fill(value, {"double_array_value": [1, 2], "bool_value": True})
    assert list(value.double_array_value) == [1.0, 2.0]
    assert value.bool_value is True


def test_fill_times():
    array, header = DiagnosticArray(), Header()
    setters = fill(array, {"header": "auto"}, times=True)
    setters += fill(header, {"stamp": "now"}, times=True)
    for setter in setters:
        setter(Header().stamp.__class__(sec=4))
    assert array.header.stamp.sec == header.stamp.sec == 4


@pytest.mark.parametrize("values", [{"nope": 1}, {"header": 3}, {"status": [{"nope": 1}]}])
def test_fill_refuses(values):
    with pytest.raises((AttributeError, TypeError)):
        fill(DiagnosticArray(), values)


@pytest.mark.parametrize("text", ["3", "[", ""])
def test_values_must_be_a_mapping(text):
    with pytest.raises(RuntimeError, match="YAML"):
        read_values(text)


def test_classes_by_name():
    assert interface_class("std_msgs/String") is interface_class("std_msgs/msg/String") is String
    for name in ("std_msgs/msg/Nope", "nope/msg/X", "String", "a/b/c/d"):
        with pytest.raises(LookupError):
            interface_class(name)
    with pytest.raises(RuntimeError, match="invalid"):
        message_class("rcl_interfaces/srv/GetParameters", "invalid")
