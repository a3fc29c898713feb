"""The controller's configuration and memory as NumPy records.

Complex numbers are space vectors, amplitude-invariant: `dq` in the rotor frame, `ab` in the
stationary frame. `k` is the sample at hand; the output computed from it applies in period k + 1.
"""

from __future__ import annotations

import numpy as np

from mfpcc_controller import protection, schemes

CONTROL_CFG = np.dtype(
    [
        ("scheme", np.int64),  # position in schemes.BUILT_IN; beyond: a plug-in
        ("fallback", np.int64),  # who takes over when it fails
        ("enable", np.bool_),  # False: gates off
        ("pwm_frequency", np.float64),  # (Hz)
        ("T_s", np.float64),  # (s)
        # the controller's model of the motor (est_par with the mismatch applied)
        ("R_s", np.float64),  # (ohm)
        ("L_d", np.float64),  # (H)
        ("L_q", np.float64),
        ("psi_f", np.float64),  # (V s)
        ("b_d", np.float64),  # T_s / L_d (A per V and period)
        ("b_q", np.float64),  # T_s / L_q
        ("n_p", np.float64),
        # references
        ("speed_control", np.bool_),
        ("w_M_ref", np.float64),  # (rad/s)
        ("i_dq_ref", np.complex128),  # (A); its q part is the speed loop's in speed control
        ("i_max", np.float64),  # (A)
        ("torque_max", np.float64),  # as the i_q (A) that makes it with the magnet's flux alone
        # maximum torque per ampere: psi_f / (4 (L_q - L_d)) of the motor file (A); 0: off
        ("mtpa", np.float64),
        ("weaken", np.bool_),  # field weakening
        # the motor file's, from which references are made whatever mismatch the current control has
        ("ref_L_d", np.float64),  # (H)
        ("ref_L_q", np.float64),
        ("ref_psi_f", np.float64),  # (V s)
        # speed loop, from the motor file's values
        ("k_p", np.float64),  # (A s/rad)
        ("k_i", np.float64),  # (A/rad)
        ("k_t", np.float64),  # reference feedforward (A s/rad)
        # rotor observer
        ("pll_k_p", np.float64),  # (1/s)
        ("pll_k_i", np.float64),  # (1/s^2)
        # search
        ("gain", np.float64, (len(schemes.BUILT_IN),)),  # of each scheme on the predicted error
        ("rank_sectors", np.bool_),
        ("project", np.bool_),
        *protection.CFG_FIELDS,
        # schemes' own
        *schemes.CFG_FIELDS,
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
        ("u", np.complex128),  # mean voltage in ab, over u_dc
        ("on", np.bool_),  # gates on
    ],
    align=True,
)

CONTROL_MEMORY = np.dtype(
    [
        ("period", np.uint64),  # k
        ("running", np.bool_),  # a sample has been taken before
        ("consecutive", np.bool_),  # and it was sample k - 1
        ("contiguous", np.bool_),  # and the gates were on in period k - 1: its output is known
        # rotor
        ("theta_m", np.float64),  # measured electrical angle (rad)
        ("w_m", np.float64),  # estimated electrical speed (rad/s)
        ("jitter", np.float64),  # change of the encoder's own error since sample k - 1 (rad)
        ("pll_error", np.float64),  # measured angle less the observer's (rad)
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
        ("i_hat", np.complex128),  # predicted sample k, from k - 1; the scheme puts in sample k + 1
        ("e", np.complex128),  # i_dq - i_hat
        ("u_dc", np.float64),  # measured (V)
        ("derating", np.float64),  # share of the current limit that the inverter allows
        # outputs of the periods k - 1 (past), k (now, committed) and k + 1 (next, to choose)
        ("past", OUTPUT),
        ("now", OUTPUT),
        ("next", OUTPUT),
        # speed loop and field weakening
        ("torque_int", np.float64),  # integral of the speed loop (A, as cfg.torque_max)
        ("speed_ready", np.bool_),  # it has started
        ("torque_limited", np.bool_),  # it asks for more torque than there is
        ("flux_share", np.float64),  # allowed flux over that of voltage and speed
        ("weakened", np.bool_),  # the flux is at its limit
        # who controls
        ("chosen", np.int64),  # cfg.scheme of the last sample
        ("active", np.int64),  # who controlled then: the chosen scheme, or the fallback
        ("kept", np.bool_),  # the same as at the sample before
        ("fallen", np.bool_),  # the chosen scheme failed; until another one is chosen
        ("failed", np.bool_),  # the fallback failed too: gates off
        ("guard", protection.MEMORY),
        # what the scheme did with this sample
        ("eta", np.float64),  # learning rate
        ("updated", np.uint8),  # entries updated, bit by bit
        ("bounded", np.bool_),
        # schemes' own
        *schemes.MEMORY_FIELDS,
    ],
    align=True,
)
