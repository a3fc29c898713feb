"""`ros2 bag`: what is recorded is played as it was."""

import signal
import threading
import time
from contextlib import contextmanager

import pytest
import rclpy
from harness import PATIENCE
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader
from std_msgs.msg import Header

from ros2_standin.bags.recorded_qos import offer_of
from ros2_standin.listen import Spinner

TOPICS = ("/ticks", "/latched")


@contextmanager
def taken_from(topic):
    """Take the serialized messages of a topic, and wait until there are so many."""
    rclpy.init()
    node = rclpy.create_node("taker")
    taken = []
    node.create_subscription(Header, topic, lambda data: taken.append(bytes(data)), 1000, raw=True)
    spinner = Spinner(node)

    def wait_for(count):
        deadline = time.monotonic() + PATIENCE
        while len(taken) < count and time.monotonic() < deadline:
            spinner.spin(0.05)
        return taken

    try:
        yield wait_for
    finally:
        spinner.close()
        node.destroy_node()
        rclpy.shutdown()


@contextmanager
def publishing(topic):
    """Publish some thousand times a second, from a thread."""
    rclpy.init()
    node = rclpy.create_node("flood")
    publisher = node.create_publisher(Header, topic, 1000)
    enough = threading.Event()

    def flood():
        while not enough.is_set():
            publisher.publish(Header(frame_id="drop"))
            enough.wait(2e-4)

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        yield
    finally:
        enough.set()
        thread.join()
        node.destroy_node()
        rclpy.shutdown()


@pytest.fixture(scope="module")
def bag(remote, start, tmp_path_factory):
    """A recording of the remote node's topics."""
    folder = tmp_path_factory.mktemp("bags") / "bag"
    recorder = start("bag", "record", "-o", folder, *TOPICS, "--custom-data", "a=b")
    recorder.wait_for("All requested topics are subscribed")
    with taken_from("/ticks") as wait_for:
        wait_for(50)
    assert recorder.end(signal.SIGINT) == 0
    assert recorder.output.endswith("Recording stopped\n")
    return folder


def test_an_interrupt_at_any_moment_leaves_a_whole_bag(remote, start, tmp_path):
    """Also in the middle of a message: what comes at this rate is written all the time."""
    with publishing("/flood"):
        for n in range(3):
            recorder = start("bag", "record", "-o", tmp_path / str(n), "/flood")
            recorder.wait_for("All requested topics are subscribed")
            # 1 where messages came faster than they were written, which it says
            assert recorder.end(signal.SIGINT) == int("messages were lost" in recorder.output)
            assert "Error" not in recorder.output
            assert all(topic == "/flood" for topic, _, _ in messages(tmp_path / str(n)))


def messages(folder):
    with Reader(folder) as reader:
        return [(c.topic, stamp, bytes(data)) for c, stamp, data in reader.messages()]


def test_recording_has_no_gaps(bag):
    ticks = [data for topic, _, data in messages(bag) if topic == "/ticks"]
    numbers = [int(deserialize_message(data, Header).frame_id) for data in ticks]
    assert len(numbers) > 20
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    with Reader(bag) as reader:
        assert reader.storage.metadata.custom == {"a": "b"}
        offers = {c.topic: offer_of(c.ext.offered_qos_profiles) for c in reader.connections}
        definitions = {c.topic: c.msgdef.data for c in reader.connections}
    assert f"\n{'=' * 80}\nMSG: builtin_interfaces/Time\n" in definitions["/ticks"]
    assert offers["/latched"].durability == 1
    assert offers["/ticks"].durability == 2


def test_info(ros2, bag):
    text = ros2("bag", "info", bag).out
    ticks = sum(topic == "/ticks" for topic, _, _ in messages(bag))
    assert f"\nMessages:          {ticks + 1}\n" in text
    line = "Topic: /ticks | Type: std_msgs/msg/Header | Count: {} | Serialization Format: cdr\n"
    assert line.format(ticks) in text
    assert sorted(ros2("bag", "info", "-t", bag).out.split()) == sorted(TOPICS)
    [file] = bag.glob("*.mcap")
    assert line.format(ticks) in ros2("bag", "info", file).out


def test_play(bag, start):
    expected = [data for topic, _, data in messages(bag) if topic == "/ticks"]
    with taken_from("/again") as wait_for:
        arguments = ("--topics", "/ticks", "--remap", "/ticks:=/again", "--rate", "2")
        player = start("bag", "play", bag, "--delay", "1", *arguments)
        assert wait_for(len(expected)) == expected
        assert player.end() == 0
    assert "Set rate to 2\n" in player.output


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("record", "Need to specify at least one option"),
        ("record /x --exclude-topics /y", "--exclude-topics argument requires"),
        ("record -a -o .", "already exists."),
        ("record -e ( -o new", "not a regular expression"),
        ("record -a -o new --custom-data a", "not of the form KEY=VALUE"),
        ("play nope", "Bag path 'nope' does not exist!"),
        ("play . --remap x", "--remap: 'x' is not of the form old:=new"),
        ("info .", "no metadata.yaml"),
    ],
)
def test_refusals(ros2, tmp_path, monkeypatch, line, reason):
    monkeypatch.chdir(tmp_path)
    outcome = ros2("bag", *line.split())
    assert outcome.code in (1, 2)
    assert reason in outcome.err
    assert not list(tmp_path.iterdir())


def test_damaged_bag(ros2, tmp_path):
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9}")
    assert "damaged" in ros2("bag", "info", tmp_path).err
    (tmp_path / "x.mcap").write_bytes(b"nothing")
    assert ros2("bag", "info", tmp_path / "x.mcap").code == 1
