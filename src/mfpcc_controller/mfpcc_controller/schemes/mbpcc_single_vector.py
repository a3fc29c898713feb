"""Single-vector MBPCC: all seven vectors are tried with the model, the best applies for a period.

The conventional finite-set predictive current control (Rodriguez et al. 2007,
doi:10.1109/TIE.2006.888802) with the compensation of the delay of one period (Cortes, Rodriguez,
Silva, Flores 2012, doi:10.1109/TIE.2011.2157284). Beside `mfpcc` it tells what the table costs;
beside `mbpcc`, what three vectors bring.
"""

from __future__ import annotations

from mfpcc_controller import model, search
from mfpcc_controller.schemes import mbpcc
from mfpcc_controller.schemes.built_in import BuiltIn
from mfpcc_controller.vectors import set_output
from pwm_node.compiled import kernel


@kernel
def step(cfg, mem):
    """Predict sample k + 1 with the committed output, try all seven for k + 2."""
    i_1 = model.predict(cfg, mem)
    x = search.correction(cfg, mem, i_1) - model.natural(cfg, mem.w_m, i_1)
    G_1, G_2 = model.forced_vectors(cfg, mem.u_dc, mem.turn_next)
    best = search.nearest_vector(x, G_1, G_2)
    set_output(mem.next, best, 0, 1.0 if best > 0 else 0.0, 0.0)
    mem.i_hat = i_1


SCHEME = BuiltIn(name="mbpcc_single_vector", step=step, show=mbpcc.show)
