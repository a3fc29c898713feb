"""The executable `drive`: plant and controller in one process until stopped, with a black box."""

from __future__ import annotations

import sys

from rclpy.node import Node

from mfpcc_controller.node import MfpccController
from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.graph import black_box
from mfpcc_experiments.graph.black_box import BlackBoxNode
from pmsm_sim.node import PmsmSim
from pmsm_sim.parameters import TABLE as PLANT
from pwm_node.ros import spin
from pwm_node.ros.node import PwmNode


def main() -> int:
    """Run plant and controller in one process until stopped, with a black box."""
    nodes: list[PwmNode] = []

    def plant() -> Node:
        nodes.append(PmsmSim(also_known=(*CONTROLLER, black_box.PARAMETER)))
        return nodes[-1]

    def controller() -> Node:
        nodes.append(MfpccController(also_known=(*PLANT, black_box.PARAMETER)))
        return nodes[-1]

    def black_box_node() -> Node:
        node = BlackBoxNode(nodes)
        _introduce(*nodes)
        return node

    return spin.main(plant, controller, black_box_node)


def _introduce(plant: PwmNode, controller: PwmNode) -> None:
    """Log what runs here, and what can be typed next."""
    factor = plant.values["real_time_factor"]
    pace = f"at {factor:g} times real time" if factor else "in lock-step, as fast as it goes"
    values = controller.values
    if values["control_mode"] == "speed":
        goal = f"{values['speed_ref_rpm']:g} r/min"
    else:
        goal = f"i_d {values['i_d_ref']:g} A, i_q {values['i_q_ref']:g} A"
    name = controller.get_fully_qualified_name()
    logger = controller.get_logger()
    logger.info(
        f"a simulated drive: motor {plant.values['motor']}, scheme {values['scheme']}, {goal}, "
        f"{pace}; Ctrl-C stops it"
    )
    logger.info(
        f"from another shell: 'ros2 param set {name} speed_ref_rpm 500.0', "
        f"'ros2 topic echo --once {plant.get_namespace().rstrip('/')}/drive_state', "
        f"'ros2 param list {name}'"
    )


if __name__ == "__main__":
    sys.exit(main())
