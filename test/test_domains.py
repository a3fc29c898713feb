"""Tests do not meet on the graph, whatever runs beside them."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import domains
import pytest


def test_a_domain_that_is_taken_is_passed_over(
    domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # locks that nobody else knows
    monkeypatch.setattr(domains, "_numbers", iter([7, 7, 8]))
    with domains.own_domain() as one:
        with domains.own_domain() as other:
            assert (one, other) == (7, 8)
            assert os.environ["ROS_DOMAIN_ID"] == "8"
    assert os.environ["ROS_DOMAIN_ID"] == str(domain)
