"""A rotor that makes no way towards its reference, or turns back, with all the torque there is.

A blocked rotor does so, and a drive with a wrong number of pole pairs: it stands, swings, or runs
the other way, at full current. A heavy load does not: it gets faster.
"""

from __future__ import annotations

import math

import numpy as np

from pwm_node.compiled import kernel

# Share of the time in which all the torque was asked for, from which a lack of progress is a stall
_SHARE = 0.2

#: Since the reference has its sign, for at most the time that makes a stall
MEMORY = np.dtype(
    [
        ("ahead", np.float64),  # sign of the reference
        ("time", np.float64),  # (s)
        ("limited", np.float64),  # of it, at the limit of the torque (s)
        ("way", np.float64),  # turned ahead (rad, electrical)
        ("w_before", np.float64),  # speed ahead at the beginning (rad/s, electrical)
        ("went", np.bool_),  # has been on its way, and after that on its way back
        ("turned_back", np.bool_),
    ],
    align=True,
)


@kernel
def stalled(cfg, mem, motion):
    """Count a sample in; whether the time that makes a stall is over, and the drive has stalled."""
    rest = cfg.w_rest
    ahead = math.copysign(1.0, cfg.w_M_ref)
    if not cfg.speed_control or abs(cfg.w_M_ref) * cfg.n_p <= rest or ahead != motion.ahead:
        motion.ahead = ahead
        motion.time = 0.0
        return False
    w = ahead * mem.w_m
    if motion.time == 0.0:
        motion.limited = 0.0
        motion.way = 0.0
        motion.w_before = w
        motion.went = False
        motion.turned_back = False
    motion.time += cfg.T_s
    motion.way += cfg.T_s * w
    motion.went |= w > rest
    motion.turned_back |= motion.went and w < -rest
    if mem.torque_limited:
        motion.limited += cfg.T_s
    if motion.time < cfg.stall_time:
        return False
    moves = motion.way > rest * motion.time or w - motion.w_before > rest
    limited = motion.limited > _SHARE * motion.time
    motion.time = 0.0
    return limited and (motion.turned_back or not moves)
