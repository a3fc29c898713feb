"""Parameters of a node as ROS sees them."""

import pytest

pytest.importorskip("rclpy")

from rclpy.parameter import Parameter as RosParameter

from pwm_node.parameters import ParameterError
from pwm_node.schedule import ScheduleError


@pytest.fixture
def make(toy, context):
    nodes = []

    def _make(**given):
        while nodes:  # of a name there is one at a time
            nodes.pop().destroy_node()
        overrides = [RosParameter(name, value=value) for name, value in given.items()]
        nodes.append(toy.Ping(context=context, parameter_overrides=overrides))
        nodes[-1].core = toy.Log(nodes[-1].values)
        return nodes[-1]

    yield _make
    for node in nodes:
        node.destroy_node()


def put(node, **changes):
    return node.set_parameters_atomically(
        [RosParameter(name, value=value) for name, value in changes.items()]
    )


def test_descriptors_teach(make):
    load, count, scheme, limit = make().describe_parameters(["load", "count", "periods", "limit"])
    assert load.description == "Load torque (N m)"
    span = load.floating_point_range[0]
    assert (span.from_value, span.to_value) == (-20.0, 20.0)
    assert count.integer_range[0].to_value == 9
    assert scheme.read_only and not load.read_only
    assert limit.additional_constraints == "at least 0 N m"


def test_what_is_accepted_acts(make):
    node = make()
    assert put(node, load=5.0).successful
    assert node.get_parameter("load").value == 5.0
    assert node.values["load"] == 5.0
    assert node.core.applied == [{"load": 5.0}]


def test_a_whole_number_will_do(make):
    node = make(limit=18)
    assert node.get_parameter("limit").value == 18.0
    assert put(node, load=5).successful
    assert node.get_parameter("load").value == 5.0


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"load": 50.0}, "'load' = 50.0 is out of range: -20 to 20 N m"),
        ({"load": "5"}, "a number"),
        ({"laod": 5.0}, "unknown parameter 'laod'; did you mean 'load'?"),
        ({"periods": 5}, "read-only"),
        ({"load": 18.0}, "'load' must not exceed 'limit'"),
        ({"count": 4, "load": 50.0}, "out of range"),
        ({"count": 4, "typo": 1}, "unknown parameter 'typo'"),
    ],
)
def test_what_is_rejected_says_why_and_changes_nothing(make, changes, reason):
    node = make()
    before = dict(node.values)
    result = put(node, **changes)
    assert not result.successful and reason in result.reason
    assert node.values == before and node.core.applied == []
    assert {name: node.get_parameter(name).value for name in ("load", "count")} == {
        "load": 0.0,
        "count": 3,
    }


def test_together_what_is_not_possible_one_by_one(make):
    node = make()
    assert put(node, load=18.0, limit=19.0).successful
    assert node.core.applied == [{"load": 18.0, "limit": 19.0}]
    results = node.set_parameters(
        [RosParameter("load", value=19.5), RosParameter("count", value=4)]
    )
    assert [result.successful for result in results] == [False, True]


def test_rclpys_own_parameters_pass(make):
    node = make(use_sim_time=False)
    assert put(node, use_sim_time=True).successful
    assert node.core.applied == []


def test_misspelt_at_start(make):
    with pytest.raises(ParameterError, match="unknown parameter 'laod'; did you mean 'load'"):
        make(laod=5.0)
    with pytest.raises(ParameterError, match="out of range"):
        make(load=50.0)
    make(scheme="two")  # known to the other node of the process


def test_an_empty_schedule_has_a_type(make):
    node = make()
    assert node.get_parameter("schedule").value == [""]
    assert node.values["schedule"] == []
    assert make(schedule=[""]).values["schedule"] == []


def test_schedule_is_applied_as_it_falls_due(make):
    node = make(schedule=["0.2 load 5", "0.1 load -3", "0.2 limit 6.0"])
    assert node.next_change == 1000
    node.apply_due(1500)
    assert node.get_parameter("load").value == -3.0 and node.next_change == 2000
    node.apply_due(2000)
    assert node.core.applied == [{"load": -3.0}, {"load": 5.0, "limit": 6.0}]
    assert node.next_change > 1 << 60
    with pytest.raises(ScheduleError, match="did you mean 'load'"):
        make(schedule=["0.2 laod 5"])
