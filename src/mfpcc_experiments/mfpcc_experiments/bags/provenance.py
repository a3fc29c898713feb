"""
Where a recording comes from: what the writer says about its run, and how a reader finds it again.

A file holds the full configuration of its run and, at its end, a summary, as metadata records of
JSON; ``metadata.yaml`` repeats in ``custom_data`` what a person looks for.
"""

from __future__ import annotations

import importlib.metadata
import json
import platform
import zlib
from collections.abc import Mapping
from typing import Any

#: Names of the metadata records that hold the run's configuration and its summary.
CONFIG_RECORD = "mfpcc_config"
SUMMARY_RECORD = "mfpcc_summary"

# Keys of the configuration that `custom_data` repeats.
_CUSTOM = ("experiment", "scheme", "motor", "engine", "seed")

# Distributions whose version can change a result.
_DISTRIBUTIONS = (
    "pmsm_sim",
    "mfpcc_controller",
    "mfpcc_experiments",
    "pwm_node",
    "numpy",
    "numba",
    "ros-rclpy",
)


def versions() -> dict[str, str]:
    """Versions of what can change a result: Python and distributions."""
    found = {"python": platform.python_version()}
    for name in _DISTRIBUTIONS:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            # a plain ROS installation does not know all of them by these names
            continue
    return found


def custom_data(config: Mapping[str, Any]) -> dict[str, str]:
    """What ``custom_data`` of the metadata says of a run with this configuration."""
    return {key: str(config[key]) for key in _CUSTOM if config.get(key) is not None}


def json_record(data: Any) -> dict[str, str]:
    """
    Content of a metadata record that holds one JSON value.

    Metadata records carry no checksum of their own, and a recording whose rotor has silently got
    another number of pole pairs is worse than none: so this one does.
    """
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"))
    return {"json": text, "crc32": _checksum(text)}


def json_value(entries: Mapping[str, str]) -> Any:
    """
    Value of a metadata record; the entries themselves where `json_record` did not make them.

    Raises
    ------
    ValueError
        If it is not what was written.
    """
    text = entries.get("json")
    if text is None or "crc32" not in entries:
        return entries
    if _checksum(text) != entries["crc32"]:
        raise ValueError("the checksum does not match")
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _checksum(text: str) -> str:
    return f"{zlib.crc32(text.encode()):08x}"
