"""Where a recording comes from: the versions of what can change a result."""

from __future__ import annotations

import importlib.metadata
import platform

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
