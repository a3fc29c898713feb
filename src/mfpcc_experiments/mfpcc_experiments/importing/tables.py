"""Measured files as tables: columns of numbers, block by block, with the line of each row."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.importing.block import ROWS_AT_ONCE, Block, Wanted, missing_column
from mfpcc_experiments.importing.errors import ImportFailedError
from mfpcc_experiments.importing.text import TextTable
from pwm_node.names import shown, unknown


class Table(Protocol):
    """
    A measured file.

    Attributes
    ----------
    unit : str
        What its rows are called: line or row.
    notes : list of str
        What is odd about it.
    configuration : dict
        Of the run, where `mfpcc export` has left it in the file.
    """

    unit: str
    notes: list[str]
    configuration: dict[str, Any]

    def blocks(self) -> Iterator[Block]:
        """The rows, from the first one on each time it is called."""


class _Whole:
    """A table that is in memory, since its format cannot be read in pieces."""

    unit = "row"

    def __init__(
        self, columns: Mapping[str | int, NDArray[np.float64]], configuration: dict[str, Any]
    ) -> None:
        self._columns = columns
        self.notes: list[str] = []
        self.configuration = configuration

    def blocks(self) -> Iterator[Block]:
        count = len(next(iter(self._columns.values())))
        for begin in range(0, count, ROWS_AT_ONCE):
            end = min(count, begin + ROWS_AT_ONCE)
            values = {name: column[begin:end] for name, column in self._columns.items()}
            yield Block(np.arange(begin + 1, end + 1), values, end / count)


def open_table(path: Path, wanted: Wanted, *, table: str = "") -> Table:
    """
    Open a measured file by its ending: .csv (.txt, .tsv), .parquet, .mat.

    Parameters
    ----------
    path : Path
        The file.
    wanted : sequence of str or int
        Its columns.
    table : str
        In a ``.mat`` file: the structure that holds them.

    Raises
    ------
    ImportFailedError
        If there is no such file, it is none of these, or lacks a column.
    """
    kinds: dict[str, Callable[[], Table]] = {
        ".csv": lambda: TextTable(path, wanted),
        ".txt": lambda: TextTable(path, wanted),
        ".tsv": lambda: TextTable(path, wanted),
        ".parquet": lambda: _Parquet(path, wanted),
        ".mat": lambda: _mat(path, wanted, table),
    }
    suffix = path.suffix.lower()
    if not path.is_file():
        raise ImportFailedError(f"{path}: there is no such file")
    if suffix not in kinds:
        raise ImportFailedError(f"{path}: {unknown('ending', suffix, kinds)}")
    return kinds[suffix]()


def _configuration(text: Any) -> dict[str, Any]:
    """What `mfpcc export` has stored of the run; nothing where it was another program."""
    try:
        found = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


class _Parquet:
    """A Parquet file, read batch by batch."""

    unit = "row"

    def __init__(self, path: Path, wanted: Wanted) -> None:
        try:
            from pyarrow import ArrowException, parquet
        except ImportError:
            raise ImportFailedError(
                f"{path}: Parquet needs the package pyarrow: 'pip install pyarrow'"
            ) from None
        self._path, self.notes = path, list[str]()
        self._errors = (ArrowException, OSError)
        self._open = lambda: parquet.ParquetFile(path)
        try:
            schema = self._open().schema_arrow
        except self._errors as error:
            raise self._wrong(error) from None
        names = schema.names
        self._names: dict[str | int, str] = {}
        for column in wanted:
            name = names[column - 1] if isinstance(column, int) and column <= len(names) else column
            if name not in names:
                raise missing_column(path, column, names)
            self._names[column] = str(name)
        stored = (schema.metadata or {}).get(b"configuration")
        self.configuration = _configuration(stored)

    def _wrong(self, error: BaseException) -> ImportFailedError:
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        return ImportFailedError(f"{self._path}: is no Parquet file that can be read: {first}")

    def blocks(self) -> Iterator[Block]:
        begin = 0
        try:
            file = self._open()
            count = file.metadata.num_rows
            columns = sorted(set(self._names.values()))
            for batch in file.iter_batches(batch_size=ROWS_AT_ONCE, columns=columns):
                values = {
                    wanted: _numbers(
                        batch.column(name).to_numpy(zero_copy_only=False), self._path, name
                    )
                    for wanted, name in self._names.items()
                }
                end = begin + batch.num_rows
                yield Block(np.arange(begin + 1, end + 1), values, end / count)
                begin = end
        except self._errors as error:
            raise self._wrong(error) from None


def _numbers(column: NDArray[Any], path: Path, name: str | int) -> NDArray[np.float64]:
    """A column as numbers, however it is stored."""
    try:
        if column.dtype.kind in "biuf":
            return column.astype(np.float64)
        if column.dtype.kind in "OSU":
            return np.array([np.nan if v is None else float(v) for v in column], np.float64)
    except (TypeError, ValueError):
        pass
    bad = next((v for v in column.ravel() if not _is_number(v)), "")
    raise ImportFailedError(f"{path}: column '{name}' holds {shown(bad)}, which is no number")


def _is_number(value: Any) -> bool:
    try:
        float(value)
    except (TypeError, ValueError):
        return False
    return True


def _mat(path: Path, wanted: Wanted, table: str) -> Table:
    """A MATLAB file, of version 7.3 (HDF5) or an older one."""
    with path.open("rb") as file:
        begin = file.read(128)
    if b"MATLAB 7.3" in begin or begin[:8] == b"\x89HDF\r\n\x1a\n":
        found = _mat_73(path)
    else:
        found = _mat_5(path)
    configuration = _configuration(found.get("configuration"))
    for part in table.split(".") if table else ():
        inside = found.get(part)
        if not isinstance(inside, dict):
            structures = [name for name, value in found.items() if isinstance(value, dict)]
            raise ImportFailedError(f"{path}: {unknown('structure', part, structures)}")
        found = inside
    columns: dict[str | int, NDArray[np.float64]] = {}
    for name in wanted:
        if name not in found:
            vectors = [n for n, v in found.items() if isinstance(v, np.ndarray) and v.size > 1]
            raise missing_column(path, name, vectors)
        columns[name] = _vector(found[name], path, name)
    lengths = {name: len(column) for name, column in columns.items()}
    longest, shortest = max(lengths, key=lengths.__getitem__), min(lengths, key=lengths.__getitem__)
    if lengths[longest] != lengths[shortest]:
        raise ImportFailedError(
            f"{path}: '{longest}' has {lengths[longest]} values and '{shortest}' "
            f"{lengths[shortest]}: these are not columns of one table"
        )
    if not lengths[longest]:
        raise ImportFailedError(f"{path}: there are no rows")
    return _Whole(columns, configuration)


def _vector(value: Any, path: Path, name: str | int) -> NDArray[np.float64]:
    array = np.asarray(value)
    if array.ndim > 1 and max(array.shape) != array.size:
        shape = " x ".join(map(str, array.shape))
        raise ImportFailedError(f"{path}: '{name}' is a matrix of {shape}, not a column")
    return _numbers(array.ravel(), path, name)


def _mat_5(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    try:
        found = loadmat(path, simplify_cells=True)
    except Exception as error:  # noqa: BLE001 (of a damaged file SciPy raises what it likes)
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ImportFailedError(f"{path}: is no MATLAB file that can be read: {first}") from None
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _mat_73(path: Path) -> dict[str, Any]:
    try:
        import h5py
    except ImportError:
        raise ImportFailedError(
            f"{path}: a MATLAB file of version 7.3 needs the package h5py: 'pip install h5py', or "
            "save it with '-v7' in MATLAB"
        ) from None

    def plain(group: Any) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, item in group.items():
            if isinstance(item, h5py.Group):
                found[name] = plain(item)
            elif item.attrs.get("MATLAB_class") == b"char":
                found[name] = "".join(map(chr, np.asarray(item).T.ravel()))
            elif item.dtype.kind in "biuf":
                found[name] = np.asarray(item)
        return found

    try:
        with h5py.File(path, "r") as file:
            return plain(file)
    except OSError as error:
        first = str(error).splitlines()[0]
        raise ImportFailedError(f"{path}: is no MATLAB file that can be read: {first}") from None
