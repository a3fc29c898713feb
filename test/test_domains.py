"""Tests do not meet on the graph, whatever runs beside them."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import domains
import pytest


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Three domains, with locks that nobody else knows."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(domains, "_NUMBERS", (7, 8, 9))


@pytest.mark.usefixtures("few")
def test_a_domain_that_is_taken_is_passed_over(domain: int) -> None:
    with domains.own_domain() as one:
        with domains.own_domain() as other:
            assert (one, other) == (7, 8)
            assert os.environ["ROS_DOMAIN_ID"] == "8"
    assert os.environ["ROS_DOMAIN_ID"] == str(domain)


@pytest.mark.usefixtures("few")
def test_of_those_that_are_free_it_is_the_one_left_longest_ago(tmp_path: Path) -> None:
    for number, left in ((7, 300), (8, 100), (9, 200)):  # by whatever process
        lock = tmp_path / f"mfpcc_test_domain_{number}.lock"
        lock.touch()
        os.utime(lock, (left, left))
    found = []
    for _ in range(3):
        with domains.own_domain() as number:
            found.append(number)
    assert found == [8, 9, 7]
