"""What the schemes show of themselves: their part of `LutDiagnostics`."""

from __future__ import annotations

import numpy as np

from pwm_node.compiled import kernel

#: Age of an entry that was never updated
NEVER = np.uint32(0xFFFFFFFF)


@kernel
def show_gradients(diag, g_0, g_1, g_2):
    """Fill in the natural entry (dq) and the six forced ones (ab), which V1's and V2's give."""
    re, im = diag.gradient_re, diag.gradient_im
    re[0], im[0] = g_0.real, g_0.imag
    re[1], im[1] = g_1.real, g_1.imag
    re[2], im[2] = g_2.real, g_2.imag
    re[3], im[3] = g_2.real - g_1.real, g_2.imag - g_1.imag
    for j in range(1, 4):
        re[j + 3], im[j + 3] = -re[j], -im[j]


@kernel
def show_shares(diag, natural, active_a, active_b):
    """Fill in the shares of the error; three zeros where none is shared out."""
    diag.error_share[0] = natural
    diag.error_share[1] = active_a
    diag.error_share[2] = active_b


@kernel
def show_nothing_learned(diag):
    """For a scheme without a table."""
    show_shares(diag, 0.0, 0.0, 0.0)
    for j in range(7):
        diag.age[j] = NEVER
