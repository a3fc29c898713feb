"""The bits of values, to compare them or to send them on.

What lies between the fields of a structured array, to align them, is no value: NumPy need not copy
it (2.4 does not), and so two arrays with the same values may differ there.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def of(values: Any) -> bytes:
    """Return the bytes of values, field by field.

    Parameters
    ----------
    values : ndarray or NumPy scalar
        Of any type, structured or not.
    """
    names = values.dtype.names
    if names is None:
        return bytes(values.tobytes())
    return b"".join(of(values[name]) for name in names)


def with_clean_gaps(values: Any) -> Any:
    """Return a copy of an array that has zeros between its fields.

    Parameters
    ----------
    values : ndarray
        Of any type, structured or not.
    """
    clean = np.zeros(values.shape, values.dtype)
    _fill(clean, values)
    return clean


def _fill(clean: Any, values: Any) -> None:
    if values.dtype.names is None:
        clean[...] = values
    else:
        for name in values.dtype.names:
            _fill(clean[name], values[name])
