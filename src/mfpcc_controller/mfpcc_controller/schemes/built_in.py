"""What a built-in scheme is made of: one object per file of this folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pwm_node.parameters import Parameter, Value


def _nothing_to_configure(cfg: np.void, mem: np.void, values: Mapping[str, Any]) -> None:
    """For a scheme without parameters."""


def _no_rule(values: Mapping[str, Value]) -> str | None:
    """For a scheme whose parameters are judged one by one."""
    return None


@dataclass(frozen=True, kw_only=True)
class BuiltIn:
    """
    A compiled current-control scheme.

    Attributes
    ----------
    name : str
        Value of the parameter `scheme`, and name of the scheme's fields in the records.
    step : kernel
        `step(cfg, mem)`: the work of one period (see the package).
    show : kernel
        `show(cfg, mem, diag)`: its part of `LutDiagnostics`; called only when they are published.
    parameters : tuple of Parameter
        What of it can be set.
    check : callable
        `check(values)`: rules across its parameters, as of `pwm_node.parameters.Table`.
    cfg : dtype, optional
        Its part of `CONTROL_CFG`, which is `cfg.<name>` in kernels.
    configure : callable
        `configure(cfg, mem, values)`: fills `cfg[name]` from the values of all parameters. It gets
        one record of `CONTROL_CFG` and of `CONTROL_MEMORY`, the rest of which is filled already.
    memory : dtype, optional
        Its part of `CONTROL_MEMORY`, `mem.<name>`. The field `ready` says whether it holds
        something; the controller clears it when the scheme in control has failed.
    gain : float
        Share of the predicted error that a period takes off, where `deadbeat.gain` leaves it open;
        for schemes that use `search.correction`.
    """

    name: str
    step: Callable[..., Any]
    show: Callable[..., Any]
    parameters: tuple[Parameter, ...] = ()
    check: Callable[[Mapping[str, Value]], str | None] = _no_rule
    cfg: np.dtype[np.void] | None = None
    configure: Callable[[np.void, np.void, Mapping[str, Any]], None] = _nothing_to_configure
    memory: np.dtype[np.void] | None = None
    gain: float = 1.0
