"""
Two drives side by side, each in a namespace of its own.

    ros2 launch mfpcc_experiments two_axes.launch.py axis1_scheme:=mbpcc axis2_load_torque:=2.0
"""

from __future__ import annotations

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

AXES = ("axis1", "axis2")

#: Arguments of drive.launch.py that are the same for both, with their defaults.
SHARED = {"composed": "true", "real_time_factor": "", "black_box": ""}
#: Those that each axis has its own of, as `axis1_scheme`.
OWN = ("motor", "scheme", "speed_ref_rpm", "load_torque", "parameters", "record")


def generate_launch_description() -> LaunchDescription:
    """Return what to launch."""
    shared = [
        DeclareLaunchArgument(
            name, default_value=default, description=f"`{name}` of drive.launch.py, for both axes"
        )
        for name, default in SHARED.items()
    ]
    own = [
        DeclareLaunchArgument(
            f"{axis}_{name}", default_value="", description=f"`{name}` of drive.launch.py, {axis}"
        )
        for axis in AXES
        for name in OWN
    ]
    return LaunchDescription([*shared, *own, *map(one_axis, AXES)])


def one_axis(axis: str) -> GroupAction:
    """Return the drive of one axis. The group keeps its arguments from reaching the other one."""
    source = PythonLaunchDescriptionSource(str(Path(__file__).with_name("drive.launch.py")))
    arguments = {name: LaunchConfiguration(name) for name in SHARED}
    arguments |= {name: LaunchConfiguration(f"{axis}_{name}") for name in OWN}
    return GroupAction(
        [
            IncludeLaunchDescription(
                source, launch_arguments=[("namespace", axis), *arguments.items()]
            )
        ]
    )
