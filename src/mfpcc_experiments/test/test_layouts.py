"""A recording is read by its own definitions: fields that were added since, or are not known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bag_kinds
import numpy as np
import pytest
from ament_index_python.packages import get_package_share_directory
from bag_kinds import Kind
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from synthetic_drive import messages

from mfpcc_experiments.bags import LOOP_TOPICS, BagError, layouts, recording
from mfpcc_experiments.bags.definitions import message_definition
from mfpcc_experiments.notes import Severity
from pwm_node import bits

MESSAGES = list(messages(40, oversampling=3))


def recorded_with(
    path: Path, monkeypatch: pytest.MonkeyPatch, topic: str, change: Callable[[str], str]
) -> Path:
    """Write the recording as if the definition of a topic were another one, by rosbags."""
    type_name = LOOP_TOPICS[topic]
    text = message_definition(type_name)
    other = change(text)
    assert other != text
    stores = [get_typestore(Stores.EMPTY), get_typestore(Stores.EMPTY)]
    for store, definition in zip(stores, (text, other), strict=True):
        store.register(get_types_from_msg(definition, type_name))
    kind = stores[1].types[type_name]
    names = [name for name, _ in stores[1].fielddefs[type_name][1]]

    def convert(data: bytes) -> bytes:
        old = stores[0].deserialize_cdr(data, type_name)
        time = stores[1].types["builtin_interfaces/msg/Time"]
        stamp = time(old.stamp.sec, old.stamp.nanosec)
        values = {name: getattr(old, name, 7) for name in names}
        if "stamp" in names:
            values["stamp"] = stamp
        return bytes(stores[1].serialize_cdr(kind(**values), type_name))

    changed = [(t, at, convert(data) if t == topic else data) for t, at, data in MESSAGES]
    real = message_definition
    with monkeypatch.context() as patch:
        patch.setattr(
            bag_kinds, "message_definition", lambda t: other if t == type_name else real(t)
        )
        return bag_kinds.write(path, [changed], Kind())


def fields(topic: str) -> list[str]:
    store = get_typestore(Stores.EMPTY)
    type_name = LOOP_TOPICS[topic]
    store.register(get_types_from_msg(message_definition(type_name), type_name))
    return [name for name, _ in store.fielddefs[type_name][1]]


def without(field: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        head, *rest = text.split("=" * 80)
        lines = [x for x in head.splitlines() if field not in x.split("#")[0].split()]
        return ("=" * 80).join(["\n".join(lines) + "\n", *rest])

    return change


ARRAYS = {
    "phase_feedback": "feedback",
    "duty_command": "command",
    "lut_diagnostics": "lut",
    "drive_state": "state",
}
ALL = [(topic, field) for topic in ARRAYS for field in fields(topic)]
NEEDED = {"stamp", "period", "i_a", "i_b", "i_c", "encoder_angle", "duty"} | {
    "dc_voltage of phase_feedback"
}


@pytest.mark.parametrize(("topic", "field"), ALL)
def test_a_bag_from_before_a_field_was_added(
    topic: str, field: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "oversampled" in field:
        pytest.skip("the waveforms came both at once")
    path = recorded_with(tmp_path / "bag", monkeypatch, topic, without(field))
    if {field, f"{field} of {topic}"} & NEEDED:
        with pytest.raises(BagError, match=f"another definition .*has no field {field} there"):
            recording.read(path)
        return
    found = recording.read(path)
    expected = recording.read(bag_kinds.write(tmp_path / "new", [MESSAGES], Kind()))
    rows, others = getattr(found, ARRAYS[topic]), getattr(expected, ARRAYS[topic])
    for name in rows.dtype.names:
        if name != field:
            assert bits.of(rows[name]) == bits.of(others[name]), name
    note, *more = [n for n in found.notes if n.severity is Severity.WARNING]
    assert len(more) == (field in ("enable", "gates_on"))
    assert all(f"{field}, which is taken as on" in n.text for n in more)
    assert f"/{topic} was recorded before it had {field}; these take their defaults" in note.text
    if field == "derating":
        assert (rows[field] == 1.0).all()
    elif field == "scheme":
        assert set(found.scheme) == {""}
    elif rows[field].dtype.kind == "f":
        assert np.isnan(rows[field]).all()
    if topic == "drive_state":
        assert bits.of(found.i_abc_oversampled) == bits.of(expected.i_abc_oversampled)


def test_a_field_of_a_later_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def add(text: str) -> str:
        return text.replace("float64 i_a ", "uint8 from_later\nfloat64 i_a ", 1)

    found = recording.read(recorded_with(tmp_path / "bag", monkeypatch, "phase_feedback", add))
    expected = recording.read(bag_kinds.write(tmp_path / "new", [MESSAGES], Kind()))
    assert bits.of(found.feedback) == bits.of(expected.feedback)
    assert "recorded with from_later, unknown to this version and left out" in str(found.notes)


def test_numbers_of_another_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def change(text: str) -> str:
        return text.replace("float64 i_a ", "float32 i_a ", 1)

    found = recording.read(recorded_with(tmp_path / "bag", monkeypatch, "phase_feedback", change))
    expected = recording.read(bag_kinds.write(tmp_path / "new", [MESSAGES], Kind()))
    assert np.array_equal(found.feedback["i_a"], expected.feedback["i_a"].astype(np.float32))
    assert np.array_equal(found.feedback["i_b"], expected.feedback["i_b"])


@pytest.mark.parametrize(
    ("text", "encoding"),
    [("string", "ros2msg"), ("float64 x", "protobuf"), ("float64[] stamp\n", "ros2msg"),
     ("a" * (2 << 20), "ros2msg"), ("struct {", "ros2idl")],
)  # fmt: skip
def test_definitions_that_are_of_no_use(text: str, encoding: str) -> None:
    with pytest.raises(layouts.LayoutError):
        layouts.recorded_layout("mfpcc_msgs/msg/PhaseFeedback", text, encoding)


@pytest.mark.parametrize("type_name", LOOP_TOPICS.values())
def test_definitions_in_idl(type_name: str) -> None:
    """As rosbag2 stores them where a package has no .msg files."""
    text = ""
    for name in (type_name, "builtin_interfaces/msg/Time"):
        package, _, kind = name.split("/")
        path = Path(get_package_share_directory(package)) / "msg" / f"{kind}.idl"
        text += f"{'=' * 80}\nIDL: {name}\n{path.read_text()}\n"
    found = layouts.recorded_layout(type_name, text, "ros2idl")
    assert found == layouts.own_layout(type_name)


def test_the_layout_is_that_of_the_wire() -> None:
    import mfpcc_msgs.msg

    from pwm_node.wire import fixed_dtype, fixed_size

    for type_name in LOOP_TOPICS.values():
        msg_class = getattr(mfpcc_msgs.msg, type_name.split("/")[-1])
        found, wire = layouts.own_layout(type_name), fixed_dtype(msg_class)
        assert found.size == fixed_size(msg_class) and found.dtype.names == wire.names
        for name in wire.names:
            assert found.dtype.fields[name][1] == wire.fields[name][1]
