import array
import math

import pytest

from pwm_node.parameters import Parameter, ParameterError, Table


def limits_in_order(values):
    if values["low"] > values["high"]:
        return f"'low' ({values['low']}) must not exceed 'high' ({values['high']})"
    return None


@pytest.fixture
def table():
    return Table(
        [
            Parameter("low", 1.0, "lower limit", unit="A", minimum=0.0),
            Parameter("high", 2.0, "upper limit", unit="A", maximum=10.0),
            Parameter("scheme", "mbpcc", "who controls", choices=("mbpcc", "mfpcc")),
            Parameter("seed", 0, "of the noise", minimum=0, read_only=True),
            Parameter("on", True, "switch"),
            Parameter("gains", [1.0, 2.0], "per axis", minimum=0.0),
            Parameter("schedule", [], "changes", read_only=True),
        ],
        check=limits_in_order,
    )


def reason(call, *args):
    with pytest.raises(ParameterError) as caught:
        call(*args)
    return caught.value.reason


def test_kinds_follow_from_the_defaults(table):
    kinds = [table[name].kind for name in table]
    assert kinds == ["float", "float", "str", "int", "bool", "list[float]", "list[str]"]


def test_a_whole_number_will_do_for_a_float(table):
    accepted = table.validate({"high": 5})
    assert accepted == {"high": 5.0}
    assert isinstance(accepted["high"], float)


@pytest.mark.parametrize("value", ["5", True, None, [1.0]])
def test_wrong_types_are_named(table, value):
    text = reason(table.validate, {"high": value})
    assert "'high'" in text and "a number" in text and repr(value) in text


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_only_finite_numbers(table, value):
    assert "finite" in reason(table.validate, {"high": value})


def test_range_is_told_with_unit(table):
    assert reason(table.validate, {"high": 11.0}) == ("'high' = 11.0 is out of range: at most 10 A")
    assert "at least 0 A" in reason(table.validate, {"low": -1.0})
    assert table.validate({"low": 0.0}) == {"low": 0.0}


def test_nearest_choice_and_nearest_name(table):
    assert "did you mean 'mbpcc'" in reason(table.validate, {"scheme": "mbpc"})
    assert "did you mean 'scheme'" in reason(table.validate, {"shceme": "mbpcc"})


def test_lists(table):
    assert table.validate({"gains": array.array("d", [3.0, 4.0])}) == {"gains": [3.0, 4.0]}
    assert "out of range" in reason(table.validate, {"gains": [-1.0]})
    assert "list" in reason(table.validate, {"gains": "12"})
    assert "list of texts" in reason(table.validate, {"schedule": [1]})


def test_the_rule_across_parameters_sees_all_changes_together(table):
    assert "'low' (3.0) must not exceed 'high' (2.0)" in reason(table.validate, {"low": 3.0})
    assert table.validate({"low": 3.0, "high": 4.0}) == {"low": 3.0, "high": 4.0}
    current = table.complete({"low": 3.0, "high": 4.0})
    assert "must not exceed" in reason(table.validate, {"high": 2.5}, current)


def test_read_only_is_for_the_start_only(table):
    assert table.validate({"seed": 3}) == {"seed": 3}
    assert "read-only" in reason(table.validate, {"seed": 3}, table.defaults())


def test_checking_changes_nothing(table):
    current = table.defaults()
    before = dict(current)
    table.validate({"low": 1.5}, current)
    assert current == before


def test_defaults_are_fresh(table):
    table.defaults()["gains"].append(5.0)
    assert table.defaults()["gains"] == [1.0, 2.0]


def test_a_default_can_follow_from_another_value():
    parameters = [Parameter("a", 1.0, ""), Parameter("twice", 0.0, "")]
    table = Table(parameters, follow=lambda values: {"twice": 2.0 * values["a"]})
    assert table.complete({}) == {"a": 1.0, "twice": 2.0}
    assert table.complete({"a": 3}) == {"a": 3.0, "twice": 6.0}
    assert table.complete({"a": 3, "twice": 5}) == {"a": 3.0, "twice": 5.0}


def test_values_as_text(table):
    assert table["high"].parse("1e-3") == 1e-3
    assert table["on"].parse("false") is False
    assert table["scheme"].parse("mfpcc") == "mfpcc"
    assert table["gains"].parse("[1, 2.5]") == [1.0, 2.5]
    assert "'high' = 'fast'" in reason(table["high"].parse, "fast")
    assert "true or false" in reason(table["on"].parse, "maybe")


def test_a_bad_table_is_refused():
    with pytest.raises(ValueError, match="twice"):
        Table([Parameter("a", 1.0, ""), Parameter("a", 2.0, "")])
    with pytest.raises(ParameterError):
        Table([Parameter("a", 1.0, "", maximum=0.5)])
