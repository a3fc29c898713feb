"""Two-level inverter with centre-aligned PWM: from duties to switching instants and voltages."""

from __future__ import annotations

import math

from pwm_node.compiled import kernel

_INV_SQRT3 = 1.0 / math.sqrt(3.0)


@kernel
def leg_voltage(legs, u_dc):
    """Stator voltage (u_alpha, u_beta) (V) of the leg states `legs` (bits a, b, c).

    `u_j = 2/3 u_dc exp(1j (j - 1) pi / 3)`, method section 1, written by legs.
    """
    s_a = legs & 1
    s_b = (legs >> 1) & 1
    s_c = (legs >> 2) & 1
    return u_dc * (2 * s_a - s_b - s_c) / 3.0, u_dc * (s_b - s_c) * _INV_SQRT3


@kernel
def set_pattern(st, T_s):
    """Switching pattern of one period from `st.duty`.

    Leg x is high in `T_s/2 (1 - d_x) .. T_s/2 (1 + d_x)`. The three rising edges in time order,
    then the three falling ones mirrored, bound seven intervals; some may have no length.
    """
    d_0, d_1, d_2 = st.duty[0], st.duty[1], st.duty[2]
    b_0, b_1, b_2 = 1, 2, 4
    if d_0 < d_1:
        d_0, d_1, b_0, b_1 = d_1, d_0, b_1, b_0
    if d_1 < d_2:
        d_1, d_2, b_1, b_2 = d_2, d_1, b_2, b_1
    if d_0 < d_1:
        d_0, d_1, b_0, b_1 = d_1, d_0, b_1, b_0
    half = 0.5 * T_s
    st.t_switch[0] = 0.0
    st.t_switch[1] = half * (1.0 - d_0)
    st.t_switch[2] = half * (1.0 - d_1)
    st.t_switch[3] = half * (1.0 - d_2)
    st.t_switch[4] = half * (1.0 + d_2)
    st.t_switch[5] = half * (1.0 + d_1)
    st.t_switch[6] = half * (1.0 + d_0)
    st.t_switch[7] = T_s
    st.legs[0] = 0
    st.legs[1] = b_0
    st.legs[2] = b_0 | b_1
    st.legs[3] = 7
    st.legs[4] = b_0 | b_1
    st.legs[5] = b_0
    st.legs[6] = 0
