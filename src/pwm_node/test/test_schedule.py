import pytest

from pwm_node.parameters import Parameter, Table
from pwm_node.schedule import ScheduleError, parse, period_of

T_S = 1e-4


@pytest.fixture
def table():
    return Table(
        [
            Parameter("load_torque", 0.0, "", unit="N m", minimum=-20.0, maximum=20.0),
            Parameter("limit", 10.0, ""),
            Parameter("scheme", "mbpcc", "", choices=("mbpcc", "off")),
            Parameter("motor", "seed_750", "", read_only=True),
        ],
        check=lambda v: "load above limit" if v["load_torque"] > v["limit"] else None,
    )


def test_entries_come_sorted_and_merged(table):
    entries = ["0.3 load_torque 5", "0.1 scheme off", "0.3 scheme mbpcc", "0.3 load_torque 6.0"]
    assert parse(entries, table, T_S) == [
        (1000, {"scheme": "off"}),
        (3000, {"load_torque": 6.0, "scheme": "mbpcc"}),
    ]
    assert parse([], table, T_S) == []


@pytest.mark.parametrize(
    ("time", "period"), [(0.0, 0), (0.3, 3000), (0.2999, 2999), (0.00015, 2), (59.9999, 599999)]
)
def test_an_entry_is_due_at_the_first_period_from_its_time_on(time, period):
    assert period_of(time, T_S) == period


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ("0.2 load_torque", "expected '<time in s> <parameter> <value>'"),
        ("soon load_torque 5.0", "'soon' is not a time"),
        ("-1 load_torque 5.0", "'-1' is not a time"),
        ("nan load_torque 5.0", "'nan' is not a time"),
        ("0.2 laod_torque 5.0", "did you mean 'load_torque'"),
        ("0.2 load_torque 50", "out of range"),
        ("0.2 load_torque much", "a number"),
        ("0.2 scheme mbpc", "did you mean 'mbpcc'"),
        ("0.2 motor ipmsm", "read-only"),
    ],
)
def test_errors_name_the_entry_and_the_reason(table, entry, says):
    with pytest.raises(ScheduleError) as caught:
        parse([entry], table, T_S)
    assert entry in str(caught.value) and says in str(caught.value)


def test_rules_across_parameters_are_checked_along_the_schedule(table):
    parse(["0.1 limit 20.0", "0.2 load_torque 15.0"], table, T_S)
    with pytest.raises(ScheduleError, match="load above limit"):
        parse(["0.3 limit 20.0", "0.2 load_torque 15.0"], table, T_S)
    with pytest.raises(ScheduleError, match="load above limit"):
        parse(["0.1 load_torque 5.0"], table, T_S, {**table.defaults(), "limit": 4.0})
