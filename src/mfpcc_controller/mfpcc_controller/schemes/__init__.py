"""The built-in current-control schemes, one file each.

A scheme is a kernel `step(cfg, mem)`: from the measured current, the committed output `mem.now`
and its own memory it chooses `mem.next` and predicts the current of the next sample into
`mem.i_hat`. What it has of earlier samples counts only while `mem.contiguous` (the sample before
is there, and its output is known) and `mem.kept` (the same scheme was in control then); otherwise
it starts from the committed output, so that a switch between schemes makes no bump.

The file of a scheme holds all there is of it, its parameters and its part of the records too, and
ends with one `SCHEME` (see `built_in`). To add a scheme is to write such a file and to enter it in
the list here. Everything else is made from the list: the values of the parameters `scheme` and
`fallback_scheme`, the parameter table, the records, and the compiled dispatch below.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from mfpcc_controller.schemes import (
    mbpcc,
    mbpcc_single_vector,
    mfpcc,
    mfpcc_two_vector,
    mls_mfpcc,
    mls_mfpcc_paper,
    neso_mfpcc,
    pi_foc,
    ultra_local_eso,
    ultra_local_smo,
)
from mfpcc_controller.schemes.built_in import BuiltIn
from pwm_node.compiled import kernel

#: The position is the number by which the kernels know a scheme.
BUILT_IN: tuple[BuiltIn, ...] = (
    mls_mfpcc.SCHEME,
    mls_mfpcc_paper.SCHEME,
    mfpcc.SCHEME,
    mbpcc.SCHEME,
    mbpcc_single_vector.SCHEME,
    neso_mfpcc.SCHEME,
    pi_foc.SCHEME,
    ultra_local_eso.SCHEME,
    ultra_local_smo.SCHEME,
    mfpcc_two_vector.SCHEME,
)

NAMES = tuple(scheme.name for scheme in BUILT_IN)
PARAMETERS = tuple(row for scheme in BUILT_IN for row in scheme.parameters)
CFG_FIELDS = [(scheme.name, scheme.cfg) for scheme in BUILT_IN if scheme.cfg]
MEMORY_FIELDS = [(scheme.name, scheme.memory) for scheme in BUILT_IN if scheme.memory]


def _generated(head: str, lines: Iterable[str], **functions: Callable[..., Any]) -> Any:
    """Return a kernel of the given source, in which `functions` are known by their names.

    A loop over a tuple of kernels would call them by pointers, and nothing would be inlined.
    """
    source = "\n    ".join([f"def {head}:", *lines])
    names: dict[str, Any] = {"__name__": __name__, **functions}
    exec(compile(source, __file__, "exec"), names)
    function = names[head.partition("(")[0]]
    function.__source__ = source  # it stands in no file
    return kernel(function)


def _dispatch(head: str, kernels: Iterable[Callable[..., Any]]) -> Any:
    """Return the kernel of the given head that calls the one of the scheme in control."""
    arguments = head[head.index("(") :]
    lines = (
        f"{'el' if n else ''}if mem.active == {n}: {name}{arguments}"
        for n, name in enumerate(NAMES)
    )
    return _generated(head, lines, **dict(zip(NAMES, kernels, strict=True)))


#: The scheme in control, `mem.active`, chooses the next output.
step = _dispatch("step(cfg, mem)", (scheme.step for scheme in BUILT_IN))

#: The scheme in control fills its part of the diagnostics.
show = _dispatch("show(cfg, mem, diag)", (scheme.show for scheme in BUILT_IN))

#: Every scheme starts anew: whatever one that failed has learned is not to be trusted.
forget = _generated("forget(mem)", (f"mem.{name}.ready = False" for name, _ in MEMORY_FIELDS))
