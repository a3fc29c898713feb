"""The loop at full speed, and how it starts, stops and goes on."""

import math
import signal
import time
from contextlib import closing

import pytest
from harness import PATIENCE, until

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("mfpcc_msgs.msg")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from lifecycle_msgs.msg import State, Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from mfpcc_msgs.msg import PhaseFeedback  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.experimental.events_executor import EventsExecutor  # noqa: E402
from rclpy.parameter import Parameter as RosParameter  # noqa: E402
from rclpy.parameter_client import AsyncParameterClient  # noqa: E402
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from rclpy.task import Future  # noqa: E402

from pwm_node.ros import loop_topics, spin  # noqa: E402
from pwm_node.ros.loop_topics import LoopSubscription  # noqa: E402
from pwm_node.ros.spin import run  # noqa: E402


class Client:
    """A node outside of the process that it looks at; whatever it waits for, it does in bounds."""

    def __init__(self, domain):
        self.context = rclpy.Context()
        self.context.init(args=[], domain_id=domain)
        self.node = rclpy.create_node("client", context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self.parts = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 10)

    def _take(self, message):
        for part in message.status:
            self.parts[part.name] = (part, {pair.key: pair.value for pair in part.values})

    def look(self):
        self._executor.spin_once(0.02)

    def until(self, condition, what):
        def holds():
            self.look()
            return condition()

        until(holds, what)

    def period(self):
        """The period that ping has told of last, -1 before the first."""
        _, values = self.parts.get("ping: loop", (None, {"period": "-1"}))
        return int(values["period"])

    def goes_on(self, periods=100):
        """Wait until the loop has run so many periods more."""
        self.parts.clear()
        self.until(lambda: self.period() >= 0, "diagnostics")
        end = self.period() + periods
        self.until(lambda: self.period() >= end, f"{periods} periods more")

    def answer(self, future):
        self.until(future.done, "an answer")
        return future.result()

    def close(self):
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def client(domain):
    with closing(Client(domain)) as it:
        yield it


@pytest.fixture
def running(start):
    """Both toy nodes at full speed, in a process of their own."""
    process = start("both")
    yield process
    assert not process.ended, process.output
    assert process.end(signal.SIGINT) == 0, process.output


def run_to_the_end(context, *nodes):
    """Run nodes until the first has nothing more to do."""
    until = Future()
    ping = nodes[0]
    end = time.monotonic() + PATIENCE

    def look():
        done = ping.period >= 0 and ping.awaited is None
        if (done or time.monotonic() > end) and not until.done():
            until.set_result(None)

    ping.create_timer(0.01, look)
    assert run(nodes, until=until) == 0
    assert ping.awaited is None, f"stuck in period {ping.period}"
    for node in nodes:
        node.destroy_node()


def test_lock_step_in_one_process_with_a_schedule(toy, context):
    given = {"periods": 3000, "schedule": ["0.1 load 5.0", "0.2 load -5.0"]}
    overrides = [RosParameter(name, value=value) for name, value in given.items()]
    ping = toy.Ping(context=context, parameter_overrides=overrides)
    pong = toy.Pong(context=context)
    run_to_the_end(context, ping, pong)
    assert (ping.period, pong.period) == (2999, 2999)
    assert ping.refused == 0
    assert ping.loads == {1000: 5.0, 2000: -5.0}


def test_parameters_are_live_at_full_speed(running, client):
    parameters = AsyncParameterClient(client.node, "/ping")
    client.until(parameters.services_are_ready, "ping is there")
    client.goes_on()

    def set_load(value):
        (result,) = client.answer(
            parameters.set_parameters([RosParameter("load", value=value)])
        ).results
        return result

    for load in range(1, 11):
        assert set_load(float(load)).successful
    client.until(lambda: client.parts["ping: load"][1]["load"] == "10", "the load acts")
    client.goes_on()

    wrong = set_load(50.0)
    assert not wrong.successful
    assert wrong.reason == "'load' = 50.0 is out of range: -20 to 20 N m"


def test_what_has_waited_for_too_long_is_refused_and_never_left_without_an_answer(
    toy, context, client, monkeypatch
):
    monkeypatch.setattr(spin, "_LATE", 0.0)
    node = toy.Ping(context=context)
    executor = EventsExecutor(context=context)
    executor.add_node(node)
    due = spin._Due(executor)
    parameters = AsyncParameterClient(client.node, "/ping")
    results = []

    def ask(times, load):
        """Ask so many times at once, and serve one after the other until all are answered."""
        two = [RosParameter("load", value=load), RosParameter("count", value=2)]
        futures = [parameters.set_parameters(two) for _ in range(times)]

        def answered():
            due.serve(0.0)
            client.look()
            return all(future.done() for future in futures)

        until(answered, "all are answered")
        results.extend(future.result().results for future in futures)

    asked = []

    def known():
        due.serve(0.0)
        client.look()
        # what is answered before the client is known is lost
        if parameters.services_are_ready():
            asked.append(parameters.get_parameters(["load"]))
        return any(each.done() for each in asked)

    until(known, "ping answers")

    def refused():
        ask(8, 1.0)  # a client keeps ten answers
        return [each for each in results if not each[0].successful]

    until(refused, "some come too late")
    for first, second in refused():
        assert not first.successful and not second.successful
        assert first.reason == second.reason
        assert first.reason.startswith("not set, since this request has waited for too long: ")
    monkeypatch.setattr(spin, "_LATE", math.inf)
    ask(1, 2.0)
    assert [each.successful for each in results[-1]] == [True, True]
    assert (node.values["load"], node.values["count"]) == (2.0, 2)
    executor.shutdown()
    node.destroy_node()


def test_managed_life_cycle(running, client):
    change = client.node.create_client(ChangeState, "/ping/change_state")
    state = client.node.create_client(GetState, "/ping/get_state")
    client.until(lambda: change.service_is_ready() and state.service_is_ready(), "ping is there")

    def to(transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        assert client.answer(change.call_async(request)).success
        return client.answer(state.call_async(GetState.Request())).current_state.id

    client.goes_on()
    assert to(Transition.TRANSITION_DEACTIVATE) == State.PRIMARY_STATE_INACTIVE
    assert to(Transition.TRANSITION_ACTIVATE) == State.PRIMARY_STATE_ACTIVE
    client.goes_on()
    for _ in range(3):
        assert to(Transition.TRANSITION_DEACTIVATE) == State.PRIMARY_STATE_INACTIVE
        assert to(Transition.TRANSITION_CLEANUP) == State.PRIMARY_STATE_UNCONFIGURED
        for count in (client.node.count_publishers, client.node.count_subscribers):
            topic = "phase_feedback" if count == client.node.count_publishers else "duty_command"
            client.until(lambda count=count, topic=topic: count(topic) == 0, f"{topic} has gone")
        assert to(Transition.TRANSITION_CONFIGURE) == State.PRIMARY_STATE_INACTIVE
        assert to(Transition.TRANSITION_ACTIVATE) == State.PRIMARY_STATE_ACTIVE
        client.goes_on()


def test_diagnostics(running, client):
    def runs():
        part, _ = client.parts.get("ping: loop", (None, {}))
        return part is not None and part.message == "running"

    client.until(runs, "the loop runs")
    part, values = client.parts["ping: loop"]
    assert part.level == DiagnosticStatus.OK and part.hardware_id == "ping"
    assert float(values["loop rate (Hz)"]) > 0.0
    assert values["missed periods"] == "0" and values["lost periods"] == "0"


def test_a_node_goes_and_another_comes_in_the_same_process(toy, context):
    # The first time, long enough before that a publisher's history is full (5000 messages).
    ping = toy.Ping(context=context, parameter_overrides=[RosParameter("periods", value=12000)])
    pongs = [toy.Pong(context=context)]
    due = list(range(6000, 11000, 250))

    def replace():
        if due and ping.period > due[0]:
            due.pop(0)
            executor = ping.executor
            executor.remove_node(pongs[-1])
            pongs[-1].destroy_node()
            pongs.append(toy.Pong(context=context))
            executor.add_node(pongs[-1])
            pongs[-1].trigger_configure()
            pongs[-1].trigger_activate()

    ping.create_timer(0.01, replace)
    run_to_the_end(context, ping, pongs[0])
    assert len(pongs) > 2 and max(pong.period for pong in pongs[1:]) == 11999
    pongs[-1].destroy_node()


def test_a_new_subscriber_in_the_process_of_a_publisher_with_a_full_history(toy, context):
    # The case of the test above at its worst: nothing is published for a while.
    node = toy.Ping(context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    publisher = node.create_loop_publisher(PhaseFeedback, "phase_feedback")
    data = node.sample.to_bytes()

    def served(condition):
        executor.spin_once(0.01)
        publisher.settle()
        return condition()

    def subscriber(before):
        subscription = LoopSubscription(node, PhaseFeedback, "phase_feedback", print, "")
        subscription.direct = True
        until(lambda: served(lambda: publisher._matches > before), "they are matched")
        return subscription

    first = subscriber(0)
    for _ in range(5100):
        publisher.publish(data)
        assert first.take(PhaseFeedback, True) is not None
    first.destroy()
    second = subscriber(publisher._matches)
    until(lambda: served(lambda: publisher.new_listener), "the publisher has begun anew")
    executor.spin_once(0.2)  # longer than the middleware's own repair would look
    for _ in range(100):
        publisher.publish(data)
        assert second.take(PhaseFeedback, True) is not None
    executor.shutdown()
    node.destroy_node()


def test_a_subscriber_that_takes_nothing_for_ever_does_not_end_the_loop(toy, context, monkeypatch):
    monkeypatch.setattr(loop_topics, "_PATIENCE", 0.5)
    node = toy.Ping(context=context)
    publisher = node.create_loop_publisher(PhaseFeedback, "phase_feedback")
    all_of_it = QoSProfile(
        history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE, depth=0
    )
    dead = node.create_subscription(
        PhaseFeedback, "phase_feedback", lambda _: None, all_of_it, raw=True
    )
    until(lambda: publisher.listeners == 1, "they are matched")
    for period in range(10_100):  # 5000 are kept at either side
        node.sample.fixed["period"] = period
        publisher.publish(node.sample.to_bytes())

    listener = LoopSubscription(node, PhaseFeedback, "phase_feedback", print, "")
    until(lambda: publisher.listeners == 2, "who comes now is matched")
    for period in range(20_000):
        node.sample.fixed["period"] = period
        publisher.publish(node.sample.to_bytes())
        message, _ = listener.take(PhaseFeedback, False)
        assert message.period == period
    node.destroy_subscription(dead)
    node.destroy_node()


def test_a_message_for_a_subscription_that_has_gone_is_dropped(toy, context):
    node = toy.Ping(context=context)
    executor = EventsExecutor(context=context)
    executor.add_node(node)
    publisher = node.create_loop_publisher(PhaseFeedback, "phase_feedback")
    taken = []

    def serve():
        spin._serve_one(executor, 0.01)
        return publisher.listeners == 1

    for times in range(1, 4):
        subscription = LoopSubscription(node, PhaseFeedback, "phase_feedback", taken.append, "")
        until(serve, "they are matched")
        publisher.publish(node.sample.to_bytes())
        until(lambda times=times: serve() and len(taken) == times, "a message is served")
        publisher.publish(node.sample.to_bytes())
        subscription.destroy()
        publisher.publish(node.sample.to_bytes())
        until(lambda: not serve(), "the subscription has gone")
        assert len(taken) == times
    executor.shutdown()
    node.destroy_node()


def test_two_processes_of_which_one_is_killed_and_started_again(start):
    ping = start("ping", "--ros-args", "-p", "periods:=6000")
    pong = start("pong", "--ros-args", "-p", "fail_at:=3000")
    pong.wait_for("asked to fail")
    assert pong.wait() == 1
    ping.wait_for("duty_command: nothing came for 4 s, waiting: nobody publishes it; start it with")
    again = start("pong")
    ping.wait_for("duty_command: goes on after")
    ping.wait_for("done 6000")
    assert again.end(signal.SIGINT) == 0
    assert ping.end(signal.SIGINT) == 0


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("which", ["both", "pong"])
def test_signals_stop_cleanly_also_twice(start, which, kind):
    process = start(which, "--ros-args", "-p", "periods:=500")
    process.wait_for("done 500" if which == "both" else "pong ready")
    assert process.end(kind, kind) == 0
    assert "pong at rest" in process.output
    assert "Traceback" not in process.output and "rror" not in process.output


def test_an_exception_ends_the_process_with_one_line(start):
    process = start("both", "--ros-args", "-p", "fail_at:=100")
    assert process.wait() == 1
    errors = [line for line in process.output.splitlines() if "RuntimeError" in line]
    assert len(errors) == 1 and "asked to fail" in errors[0] and "toy.py:" in errors[0]
    assert "Traceback" not in process.output
    assert "pong at rest" in process.output


@pytest.mark.parametrize("entries", ["[]", '[""]'])
def test_an_empty_list_in_a_parameter_file(start, tmp_path, entries):
    file = tmp_path / "ping.yaml"
    file.write_text(f"ping:\n  ros__parameters:\n    schedule: {entries}\n    periods: 500\n")
    process = start("both", "--ros-args", "--params-file", str(file))
    process.wait_for("done 500")


def test_a_misspelt_parameter_ends_the_start(start):
    process = start("both", "--ros-args", "-p", "fial_at:=100")
    assert process.wait() == 1
    assert process.output.startswith("error: unknown parameter 'fial_at'")


def test_what_is_meant_for_others_is_ignored(start, tmp_path):
    file = tmp_path / "all.yaml"
    file.write_text(
        "/**:\n  ros__parameters: {periods: 500, camera: {fps: 30}, laod: 1.0, scheme: two}\n"
    )
    process = start("ping", "--ros-args", "--params-file", str(file))
    process.wait_for("parameters of others, ignored: ")
    said = f"{file}: parameters of others, ignored: camera.fps, laod (did you mean load?)"
    assert said in process.output, process.output
    assert process.end(signal.SIGINT) == 0


def test_in_its_own_section_a_misspelt_parameter_is_an_error(start, tmp_path):
    file = tmp_path / "ping.yaml"
    file.write_text("/**:\n  ros__parameters: {fps: 3}\nping:\n  ros__parameters: {laod: 1.0}\n")
    process = start("ping", "--ros-args", "--params-file", str(file))
    assert process.wait() == 1
    assert "error: unknown parameter 'laod'; did you mean 'load'?" in process.output


def test_one_new_name_for_two_nodes(start):
    process = start("both", "--ros-args", "-r", "__node:=x")
    assert process.wait() == 1
    assert process.output.endswith(
        "error: two nodes of this process would be named /x: a new name for one of them needs the "
        "old one in front of it ('-r pmsm_sim:__node:=plant')\n"
    )
    process = start("both", "--ros-args", "-r", "ping:__node:=x", "-p", "periods:=500")
    process.wait_for("done 500")
    assert process.end(signal.SIGINT) == 0


def test_an_idle_node_does_not_look_round_and_round(toy, context, monkeypatch):
    node = toy.Pong(context=context)
    enough, turns, ticks = Future(), [], []
    look = spin._direct_subscriptions
    monkeypatch.setattr(spin, "_direct_subscriptions", lambda ex: turns.append(1) or look(ex))

    def tick():
        ticks.append(1)
        if len(ticks) == 20:
            enough.set_result(None)

    node.create_timer(0.1, tick)
    assert run([node], until=enough) == 0
    # it waits 0.2 s a turn; one that waits for nothing would take some 10,000
    assert len(turns) < 200
    node.destroy_node()


def test_shutdown_of_the_context_ends_the_run(toy, context):
    ping, pong = toy.Ping(context=context), toy.Pong(context=context)
    ping.create_timer(0.2, context.shutdown)
    assert run([ping, pong]) == 0


def test_a_transition_that_raises_says_so(toy, context, capfd):
    class Broken(toy.Pong):
        def configure(self):
            raise ValueError("no such motor")

    node = Broken(context=context)
    assert run([node]) == 1
    assert "cannot configure" in capfd.readouterr().err
    node.destroy_node()
