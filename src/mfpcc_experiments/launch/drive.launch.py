"""
The drive: simulated inverter and motor, controller, and a recorder if one is asked for.

    ros2 launch mfpcc_experiments drive.launch.py scheme:=mbpcc load_torque:=2.0
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch_ros.actions import Node

from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.graph.black_box import DIRECTORY, PARAMETER
from pmsm_sim.parameters import TABLE as PLANT

#: Parameters that are arguments, too. All the others can be set by a parameter file.
PARAMETERS = (
    "motor",
    "pwm_frequency",
    "real_time_factor",
    "load_torque",
    "scheme",
    "control_mode",
    "speed_ref_rpm",
)


def generate_launch_description() -> LaunchDescription:
    """Return what to launch."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "composed",
                default_value="true",
                choices=["true", "false"],
                description="Both nodes in one process, which is faster, or each in its own",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="Namespace of all nodes, e.g. axis1"
            ),
            DeclareLaunchArgument(
                "parameters",
                default_value="",
                description="Parameter file, with the nodes' names as keys, e.g. of "
                "`ros2 param dump`; the other arguments take precedence over it",
            ),
            DeclareLaunchArgument(
                "record",
                default_value="",
                description="Folder of a new recording of everything on the loop; empty: none",
            ),
            DeclareLaunchArgument(
                "black_box",
                default_value="",
                description="Folder for the bags that are written at faults. Not given: "
                f"{DIRECTORY} for a composed drive, none for a drive in two processes",
            ),
            *(DeclareLaunchArgument(n, default_value="", description=about(n)) for n in PARAMETERS),
            OpaqueFunction(function=drive),
        ]
    )


def about(name: str) -> str:
    """Describe a parameter; the node's own table knows it."""
    parameter = PLANT[name] if name in PLANT else CONTROLLER[name]
    unit = f" ({parameter.unit})" if parameter.unit else ""
    limits = f"; {parameter.limits}" if parameter.limits else ""
    return f"{parameter.description}{unit}{limits}. Not given: {parameter.default}"


def drive(context: LaunchContext) -> list[Node]:
    """Return the nodes for the arguments that were given."""
    given = context.launch_configurations
    # Parsed by the tables: a value that a node would refuse is refused before anything starts.
    plant, controller = (
        {
            name: table[name].parse(given[name])
            for name in PARAMETERS
            if name in table and given[name]
        }
        for table in (PLANT, CONTROLLER)
    )
    if given["record"]:
        plant["recorders"] = controller["recorders"] = 1  # the first period waits for it
    file = [given["parameters"]] if given["parameters"] else []
    if file and not Path(file[0]).is_file():
        raise RuntimeError(f"{file[0]}: no such parameter file")

    def node(package: str, executable: str, **options: Any) -> Node:
        # When one of them ends, what is left is no drive.
        return Node(
            package=package,
            executable=executable,
            namespace=given["namespace"],
            output="screen",
            on_exit=Shutdown(reason=f"{executable} has ended"),
            **options,
        )

    composed = given["composed"] == "true"
    # A composed drive has its black box in itself; otherwise a recorder keeps it.
    box = {PARAMETER: given["black_box"]} if given["black_box"] and composed else {}
    arguments = ["--out", given["record"]] if given["record"] else []
    if given["black_box"] and not composed:
        arguments += ["--black-box", given["black_box"]]
    nodes = []
    if arguments:
        nodes.append(node("mfpcc_experiments", "record", arguments=arguments))
    if composed:
        parameters = [*file, {**plant, **controller, **box}]
        nodes.append(node("mfpcc_experiments", "drive", parameters=parameters))
    else:
        nodes.append(node("pmsm_sim", "pmsm_sim", parameters=[*file, plant]))
        nodes.append(node("mfpcc_controller", "controller", parameters=[*file, controller]))
    return nodes
