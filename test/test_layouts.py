"""The viewer layouts show fields that there are."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mfpcc_msgs.msg
import pytest

LAYOUTS = Path(__file__).parents[1] / "config/layouts"
TYPES = {
    "phase_feedback": mfpcc_msgs.msg.PhaseFeedback,
    "lut_diagnostics": mfpcc_msgs.msg.LutDiagnostics,
    "drive_state": mfpcc_msgs.msg.DriveState,
    "drive_status": mfpcc_msgs.msg.DriveStatus,
}


def foxglove() -> dict[str, Any]:
    layout: dict[str, Any] = json.loads((LAYOUTS / "foxglove.json").read_text())
    return layout


def paths_of_foxglove() -> Iterator[str]:
    for panel in foxglove()["configById"].values():
        for path in [*panel.get("paths", ()), panel.get("xAxisPath", {"value": ""})]:
            if path["value"]:
                yield path["value"]


def paths_of_plotjuggler() -> Iterator[str]:
    for curve in ElementTree.parse(LAYOUTS / "plotjuggler.xml").iter("curve"):
        for key in ("curve_x", "curve_y") if "curve_x" in curve.attrib else ("name",):
            yield curve.attrib[key]


@pytest.mark.parametrize("path", sorted({*paths_of_foxglove(), *paths_of_plotjuggler()}))
def test_field_is_there(path: str) -> None:
    match = re.fullmatch(r"/(\w+)[./](\w+)(?:\[(\d+)(?::(\d+))?\])?", path)
    assert match is not None
    topic, field, *indices = match.groups()
    types = TYPES[topic].get_fields_and_field_types()
    assert field in types
    length = re.search(r"\[(\d+)\]$", types[field])
    used = [int(index) for index in indices if index is not None]
    assert bool(used) == (length is not None)
    assert all(index < int(length.group(1)) for index in used if length is not None)


def test_every_panel_of_foxglove_has_its_place() -> None:
    layout = foxglove()
    placed: list[str] = []

    def collect(part: Any) -> None:
        if isinstance(part, str):
            placed.append(part)
        else:
            collect(part["first"])
            collect(part["second"])

    collect(layout["layout"])
    assert sorted(placed) == sorted(layout["configById"])


def test_plotjuggler_areas_are_counted() -> None:
    for splitter in ElementTree.parse(LAYOUTS / "plotjuggler.xml").iter("DockSplitter"):
        assert int(splitter.attrib["count"]) == len(splitter)
        assert len(splitter.attrib["sizes"].split(";")) == len(splitter)
