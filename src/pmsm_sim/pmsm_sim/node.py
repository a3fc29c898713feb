"""The node `/pmsm_sim`: the simulated inverter and motor on the graph.

Lock-step (`real_time_factor` 0): a period begins when its command has come, so a run is the same
bit for bit however slow the machine. Paced: periods follow the wall clock, and a command that is
not there in time is a missed period.
"""

from __future__ import annotations

import sys

from mfpcc_msgs.msg import DriveState, DutyCommand, PhaseFeedback
from pmsm_sim.parameters import TABLE
from pmsm_sim.plant import ACCEPTED, OUT_OF_RANGE, Plant, advance, latch
from pwm_node.node import HOT_QOS, PwmNode
from pwm_node.spin import main as run_node
from pwm_node.wire import Wire, WireError
