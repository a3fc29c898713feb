"""
A recording as a file for other tools: CSV, Parquet, or MATLAB's .mat.

The table is that of `measuring.columns`: a row per PWM period, a column per quantity, named with
its unit. The waveform within the periods, where it was recorded, is a table of its own.
"""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.bags import Recording
from mfpcc_experiments.measuring.columns import columns
from mfpcc_experiments.scratch import scratch
from pwm_node.errors import ForPeople
from pwm_node.names import unknown

#: What can be written.
FORMATS = ("csv", "parquet", "mat")

Columns = Mapping[str, NDArray[Any]]

_ROWS_AT_ONCE = 10_000


class ExportError(ForPeople):
    """A recording that cannot be exported as wanted; the text says why and what to do."""


def oversampled(recording: Recording) -> dict[str, NDArray[Any]]:
    """
    Return the waveform within the periods as a table.

    Parameters
    ----------
    recording : Recording
        From `recording.read`.

    Returns
    -------
    dict of ndarray, shape (n m,)
        ``period``, ``time_s``, true phase currents ``i_a_true_A`` ... and leg states ``leg_a`` ...
        (0 or 1) at m equal steps of each of n periods; empty where there is no waveform.
    """
    if recording.i_abc_oversampled is None or recording.legs_oversampled is None:
        return {}
    m = recording.oversampling
    period = np.repeat(recording.state["period"], m)
    table: dict[str, NDArray[Any]] = {
        "period": period,
        "time_s": (period + np.tile(np.arange(m) / m, len(recording.state))) * recording.T_s,
    }
    for n, leg in enumerate("abc"):
        table[f"i_{leg}_true_A"] = recording.i_abc_oversampled[:, :, n].ravel()
    for n, leg in enumerate("abc"):
        table[f"leg_{leg}"] = (recording.legs_oversampled.ravel() >> n) & 1
    return table


def export(recording: Recording, path: Path, form: str) -> list[Path]:
    """
    Write a recording; its files appear whole or not at all, and replace those that are there.

    Parameters
    ----------
    recording : Recording
        From `recording.read`.
    path : Path
        The file. CSV and Parquet hold one table: the waveform within the periods goes into a second
        file beside it, `<name>_oversampled`.
    form : str
        One of `FORMATS`.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    ExportError
        If there is no such format, or it needs a package that is not there.
    OSError
        If a file cannot be written.
    """
    if form not in FORMATS:
        raise ExportError(unknown("format", form, FORMATS))
    tables = {path: columns(recording)}
    waveform = oversampled(recording)
    # beside the file, under other names, of which nothing is left at the end
    with scratch(f".{path.name}.", path.parent) as work:
        if form == "mat":
            _write_mat(work / path.name, tables[path], waveform, recording.config)
        else:
            if waveform:
                tables[path.with_name(f"{path.stem}_oversampled{path.suffix}")] = waveform
            write = _write_csv if form == "csv" else _write_parquet
            for file, table in tables.items():
                write(work / file.name, table, recording.config)
        for file in tables:
            os.replace(work / file.name, file)
    return list(tables)


def _write_csv(path: Path, table: Columns, _: Mapping[str, Any]) -> None:
    """Numbers with all their digits; what was not recorded is an empty cell."""
    count = len(table["period"])
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table)
        for begin in range(0, count, _ROWS_AT_ONCE):
            part = [values[begin : begin + _ROWS_AT_ONCE].tolist() for values in table.values()]
            for row in zip(*part, strict=True):
                writer.writerow(["" if isinstance(v, float) and math.isnan(v) else v for v in row])


def _write_parquet(path: Path, table: Columns, config: Mapping[str, Any]) -> None:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise ExportError(
            "Parquet needs the package pyarrow: 'pip install pyarrow', or choose csv or mat"
        ) from None
    written = pyarrow.table({name: pyarrow.array(values) for name, values in table.items()})
    metadata = {"configuration": json.dumps(config, ensure_ascii=False)}
    parquet.write_table(written.replace_schema_metadata(metadata), path)


def _write_mat(path: Path, table: Columns, waveform: Columns, config: Mapping[str, Any]) -> None:
    """Columns as vectors; of texts MATLAB gets the names once, and which of them it is."""
    from scipy.io import savemat

    variables: dict[str, Any] = {name: values for name, values in table.items() if name != "scheme"}
    if "scheme" in table:
        names = [name for name in np.unique(table["scheme"]).tolist() if name]
        variables["scheme"] = sum(
            (k * (table["scheme"] == name) for k, name in enumerate(names, 1)),
            start=np.zeros(len(table["scheme"]), dtype=np.int64),
        )
        variables["scheme_names"] = np.array(names, dtype=object)
    variables |= {f"oversampled_{name}": values for name, values in waveform.items()}
    variables["configuration"] = json.dumps(config, ensure_ascii=False)
    with path.open("wb") as file:
        savemat(file, variables, oned_as="column", do_compression=True, long_field_names=True)
