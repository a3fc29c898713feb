"""The controller's configuration and memory as NumPy records.

Complex numbers are space vectors, amplitude-invariant: `dq` in the rotor frame, `ab` in the
stationary frame. `k` is the sample at hand; the output computed from it applies in period k + 1.
"""

from __future__ import annotations

import numpy as np

#: Longest moving-least-squares window
WINDOW_MAX = 32

CONTROL_CFG = np.dtype(
    [
        ("scheme", np.int64),  # position in parameters.SCHEMES
        ("T_s", np.float64),  # (s)
        ("period_ns", np.int64),
        # the controller's model of the motor (est_par with the mismatch applied)
        ("R_s", np.float64),  # (ohm)
        ("L_d", np.float64),  # (H)
        ("L_q", np.float64),
        ("psi_f", np.float64),  # (V s)
        ("n_p", np.float64),
        # references
        ("speed_control", np.bool_),
        ("w_M_ref", np.float64),  # (rad/s)
        ("i_dq_ref", np.complex128),  # (A); its q part is the speed loop's in speed control
        ("i_max", np.float64),  # (A)
        # speed loop, from the motor file's values
        ("k_p", np.float64),  # (A s/rad)
        ("k_i", np.float64),  # (A/rad)
        ("k_t", np.float64),  # reference feedforward (A s/rad)
        # rotor observer
        ("pll_k_p", np.float64),  # (1/s)
        ("pll_k_i", np.float64),  # (1/s^2)
        # search
        ("rank_sectors", np.bool_),
        ("project", np.bool_),
        # MLS-MFPCC
        ("mls_window", np.int64),
        ("mls_beta", np.float64),
        ("mls_eta_min", np.float64),
        ("mls_eta_max", np.float64),
        ("mls_e_0", np.float64),  # (A)
        ("mls_g_max", np.float64),  # (A)
        # MFPCC
        ("mfpcc_u_min", np.float64),  # (V)
    ],
    align=True,
)

#: What the inverter does in one period: two adjacent active vectors and their shares.
OUTPUT = np.dtype(
    [
        ("a", np.int64),  # 1..6, or 0: none
        ("b", np.int64),
        ("d_a", np.float64),
        ("d_b", np.float64),
    ],
    align=True,
)

MLS_MEMORY = np.dtype(
    [
        ("ready", np.bool_),  # the look-up table holds something
        ("g", np.complex128, (7,)),  # [0] in dq, [1..6] in ab (A per period)
        # window, newest at [head]; the natural entry's, and the pair's (emptied at a new pair)
        ("head", np.int64),
        ("filled", np.int64),
        ("natural_at", np.uint64),  # period of the last update
        ("forced_at", np.uint64),
        ("e_0", np.complex128, (WINDOW_MAX,)),
        ("pair_filled", np.int64),
        ("pair_a", np.int64),
        ("d_a", np.float64, (WINDOW_MAX,)),
        ("d_b", np.float64, (WINDOW_MAX,)),
        ("e_a", np.complex128, (WINDOW_MAX,)),
        ("e_b", np.complex128, (WINDOW_MAX,)),
    ],
    align=True,
)

MFPCC_MEMORY = np.dtype(
    [
        ("ready", np.bool_),
        ("g", np.complex128, (7,)),  # whole increments, all in dq (A per period)
        ("di_prev", np.complex128),  # increment of period k - 2 (A)
        ("u_prev", np.complex128),  # voltage of period k - 2, in dq (V)
        ("history", np.bool_),  # the two above are there
        ("updated_at", np.uint64),
    ],
    align=True,
)

CONTROL_MEMORY = np.dtype(
    [
        ("period", np.uint64),  # k
        ("running", np.bool_),  # a sample has been taken before
        ("contiguous", np.bool_),  # and it was sample k - 1
        # rotor
        ("theta_m", np.float64),  # measured electrical angle (rad)
        ("w_m", np.float64),  # estimated electrical speed (rad/s)
        ("pll_theta", np.float64),  # the observer's angle at sample k + 1 (rad)
        ("pll_samples", np.int64),
        # exp(-1j angle): at the sample, and in the middle of periods k - 1, k, k + 1
        ("turn", np.complex128),
        ("turn_past", np.complex128),
        ("turn_now", np.complex128),
        ("turn_next", np.complex128),
        # currents (A)
        ("i_dq", np.complex128),
        ("i_dq_past", np.complex128),  # sample k - 1
        ("i_dq_ref", np.complex128),
        ("i_hat", np.complex128),  # prediction of sample k, made at k - 1; replaced by that of k + 1
        ("e", np.complex128),  # i_dq - i_hat
        ("u_dc", np.float64),  # measured (V)
        # outputs of the periods k - 1 (past), k (now, committed) and k + 1 (next, to choose)
        ("past", OUTPUT),
        ("now", OUTPUT),
        ("next", OUTPUT),
        # speed loop
        ("i_q_int", np.float64),  # its integral (A)
        ("speed_ready", np.bool_),  # it has started
        # room for the forced gradients in the rotor frame, V1..V6 at [1..6]
        ("G", np.complex128, (7,)),
        # what the scheme shows of itself
        ("g", np.complex128, (7,)),  # gradients in use (A per period)
        ("share", np.float64, (3,)),
        ("eta", np.float64),
        ("age", np.uint32, (7,)),
        ("updated", np.uint8),
        ("bounded", np.bool_),
        # schemes' own
        ("active", np.int64),  # scheme of the last sample
        ("scheme_kept", np.bool_),  # it is this sample's too
        ("mls", MLS_MEMORY),
        ("mfpcc", MFPCC_MEMORY),
    ],
    align=True,
)
