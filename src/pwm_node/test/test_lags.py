"""The histogram of lags, against all values at once."""

import json

import numpy as np
import pytest

from pwm_node.lags import Lags, bins_of, end_of, from_text, percentiles


@pytest.fixture
def values():
    rng = np.random.default_rng(7)
    return np.exp(rng.normal(np.log(60e3), 1.5, 20_000)).astype(int)  # ns, 1 us to some 20 ms


@pytest.fixture
def lags(values):
    it = Lags()
    for value in values:
        it.add(int(value))
    return it


def test_percentiles_are_those_of_all_values(lags, values):
    assert lags.count == len(values) and lags.longest == values.max()
    exact = np.percentile(values, (1, 50, 99, 99.9), method="inverted_cdf") * 1e-3
    assert lags.percentiles((1, 50, 99, 99.9)) == pytest.approx(exact, rel=1 / 32)
    assert all(
        told >= true for told, true in zip(lags.percentiles((1, 50, 99)), exact[:3], strict=True)
    )
    assert lags.percentiles((100,)) == [values.max() * 1e-3]


def test_each_value_is_counted_in_its_bin(lags, values):
    bins = np.array(lags.bins())
    counted, _ = np.histogram(values, np.r_[bins[:, 0], end_of(int(bins[-1, 0]))])
    assert (counted == bins[:, 1]).all()


def test_bins_follow_each_other_without_a_gap():
    lags = Lags()
    for n in range(5000):
        lags.add(n)
    first = [begin for begin, _ in lags.bins()]
    assert [end_of(begin) for begin in first[:-1]] == first[1:]
    assert all(end_of(begin) - begin <= max(begin / 32, 1) for begin in first)


def test_what_lies_outside_is_counted_at_the_ends():
    lags = Lags()
    for n in (-5, 0, 1 << 60):
        lags.add(n)
    assert [count for _, count in lags.bins()] == [2, 1] and lags.longest == 1 << 60
    assert all(np.isnan(Lags().percentiles()))


def test_it_is_stored_and_told_and_read_again(lags):
    stored = json.loads(json.dumps(lags.to_json()))
    rows = bins_of(stored)
    assert [tuple(row) for row in rows] == lags.bins()
    assert percentiles(rows) == pytest.approx(lags.percentiles())
    told = from_text(lags.to_text())
    assert told["bins_ns"] == stored["bins_ns"] and told["periods"] == stored["periods"]
    assert from_text("")["periods"] == 0


@pytest.mark.parametrize(
    "bins",
    [
        *(None, [], "x", {"a": 1}, [[1]], [[1, 2, 3]], [[1, "x"]], [[1, None]]),
        *([[-1, 2]], [[1, 0]], [[2, 1], [1, 1]], [[1, 1 << 70]], [[1 << 62, 1]]),
    ],
)
def test_what_is_no_histogram_is_none(bins):
    assert bins_of({"bins_ns": bins}) is None
    assert bins_of(bins) is None
