"""Numbers in text: CSV and its relatives, with decimal points or commas, line by line."""

from __future__ import annotations

import codecs
import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from mfpcc_experiments.importing.block import ROWS_AT_ONCE, Block, Wanted, missing_column
from mfpcc_experiments.importing.errors import ImportFailedError
from pwm_node.names import shown

_DELIMITERS = ";\t,"
# The names of the columns, or the first numbers, have to come within so many lines.
_LONGEST_HEAD = 200
# Characters of a line
_LONGEST_LINE = 1 << 20
# What stands in a cell without a value.
_EMPTY = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--"}


class TextTable:
    """
    A text file with a row of numbers on each line.

    What separates the cells (semicolon, tab, comma), the decimal comma, and the line with the
    names are found out; lines before it, as oscilloscopes write them, and a line of units after it
    are passed over.

    Parameters
    ----------
    path : Path
        The file.
    wanted : sequence of str or int
        Its columns.

    Raises
    ------
    ImportFailedError
        If it is no such file, or lacks a column.
    """

    unit = "line"

    def __init__(self, path: Path, wanted: Wanted) -> None:
        self._path = path
        self._wanted = list(wanted)
        self.notes: list[str] = []
        self.configuration: dict[str, Any] = {}
        with path.open("rb") as file:
            begin = file.read(4)
        utf_16 = begin[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        self._encoding = "utf-16" if utf_16 else "utf-8-sig"
        self._size = max(1, path.stat().st_size)
        self._find_head()

    # --- The head --------------------------------------------------------------------------------

    def _find_head(self) -> None:
        """Find what separates cells, the line of the names, and the places of the columns."""
        with self._open() as file:
            head = []
            for _, line in zip(range(_LONGEST_HEAD), self._lines(file), strict=False):
                head.append(line)
        if not head:
            raise ImportFailedError(f"{self._path}: the file is empty")
        names = [name for name in self._wanted if isinstance(name, str)]
        best: tuple[int, list[str]] = (-1, [])
        for delimiter in _DELIMITERS:
            for number, line in enumerate(head):
                cells = [cell.strip() for cell in _cells(line, delimiter)]
                there = sum(name in cells for name in names)
                if there > best[0]:
                    best = there, cells
                if there == len(names) and self._begins(head, number, delimiter, cells):
                    return
        name = next(name for name in [*names, *self._wanted] if name not in best[1])
        if isinstance(name, int):
            raise ImportFailedError(
                f"{self._path}: within the first {len(head)} lines there is none with numbers in "
                f"the columns {', '.join(map(str, self._wanted))}"
            )
        raise missing_column(self._path, name, [cell for cell in best[1] if cell])

    def _begins(self, head: list[str], number: int, delimiter: str, cells: list[str]) -> bool:
        """Whether the table begins with this line of names, or of numbers where none are named."""
        places = [
            cells.index(column) if isinstance(column, str) else column - 1
            for column in self._wanted
        ]
        if max(places) >= len(cells):
            return False
        named = any(isinstance(column, str) for column in self._wanted)
        if not named:
            number -= 1  # the line itself is the first of numbers
        self._delimiter, self._places, self._width = delimiter, places, max(places) + 1
        self._names = len(cells) if named else 0
        following = [
            (k, row)
            for k in range(number + 1, len(head))
            if head[k].strip() and len(row := _cells(head[k], delimiter)) >= self._width
        ]
        self._comma = delimiter != "," and any(
            "," in cell and "." not in cell
            for _, row in following
            for cell in (row[place] for place in places)
        )
        self._first = number + 1
        if not named:
            self._first = following[0][0] if following else 0
        if following and not any(self._is_number(following[0][1][place]) for place in places):
            if not named:
                return False
            units = [following[0][1][place].strip() for place in places]
            if any(units):
                listed = ", ".join(shown(unit) for unit in units[:8])
                self.notes.append(f"line {following[0][0] + 1} is passed over as units: {listed}")
                self._first = following[0][0] + 1
        return True

    def _is_number(self, cell: str) -> bool:
        try:
            self._number(cell)
        except ValueError:
            return False
        # an empty cell is none either
        return cell.strip().lower() not in _EMPTY

    # --- The rows --------------------------------------------------------------------------------

    def _open(self) -> TextIO:
        return self._path.open(encoding=self._encoding, errors="replace", newline=None)

    def _lines(self, file: TextIO) -> Iterator[str]:
        """Lines, none of them of a length that memory would not hold."""
        number = 0
        try:
            while line := file.readline(_LONGEST_LINE):
                number += 1
                if len(line) == _LONGEST_LINE:
                    raise ImportFailedError(
                        f"{self._path}: line {number} is longer than {_LONGEST_LINE} characters: "
                        "this is no table in text"
                    )
                if "\0" in line:
                    raise ImportFailedError(
                        f"{self._path}: line {number} holds zero bytes: this is no text"
                    )
                yield line
        except UnicodeError:
            raise ImportFailedError(
                f"{self._path}: line {number + 1} is no text in {self._encoding}"
            ) from None

    def blocks(self) -> Iterator[Block]:
        """Rows, in blocks of bounded size."""
        rows: list[list[str]] = []
        lines: list[int] = []
        with self._open() as file:
            for number, line in enumerate(self._lines(file), 1):
                if number <= self._first or line.isspace():
                    continue
                cells = _cells(line, self._delimiter)
                if len(cells) < self._width:
                    raise self._wrong(
                        number,
                        f"has {len(cells)} cells, too few for the columns that the map names: is "
                        "it cut?",
                    )
                if self._names and any(cells[self._names :]):
                    raise self._wrong(
                        number,
                        f"has {len(cells)} cells, and {self._names} columns have a name: if these "
                        "are decimal commas, separate the columns with semicolons",
                    )
                rows.append([cells[place] for place in self._places])
                lines.append(number)
                if len(rows) == ROWS_AT_ONCE:
                    yield self._block(rows, lines, min(1.0, file.buffer.tell() / self._size))
                    rows, lines = [], []
        if rows:
            yield self._block(rows, lines, 1.0)

    def _wrong(self, number: int, text: str) -> ImportFailedError:
        return ImportFailedError(f"{self._path}: line {number} {text}")

    def _block(self, rows: list[list[str]], lines: list[int], done: float) -> Block:
        values = {}
        for column, cells in zip(self._wanted, zip(*rows, strict=True), strict=True):
            text = "".join(cells)
            try:
                if "_" in text or self._comma:
                    raise ValueError
                numbers = list(map(float, cells))
            except ValueError:
                numbers = [
                    self._checked(cell, number, column)
                    for cell, number in zip(cells, lines, strict=True)
                ]
            values[column] = np.array(numbers)
        return Block(np.array(lines, np.int64), values, done)

    def _checked(self, cell: str, line: int, column: str | int) -> float:
        try:
            return self._number(cell)
        except ValueError:
            where = f"{self._path}: line {line}: column '{column}' holds {shown(cell.strip())}"
            if "," in cell and "." in cell:
                why = "with both a point and a comma; write numbers without thousands separators"
            elif self._comma and "." in cell:
                why = "with a decimal point, while other lines have decimal commas"
            elif "," in cell:
                why = "with a decimal comma, while other lines have decimal points"
            else:
                why = "which is no number"
            raise ImportFailedError(f"{where}, {why}") from None

    def _number(self, cell: str) -> float:
        cell = cell.strip()
        if cell.lower() in _EMPTY:
            return float("nan")
        if "_" in cell:
            raise ValueError
        if self._comma:
            if "." in cell:
                raise ValueError
            cell = cell.replace(",", ".")
        return float(cell)


def _cells(line: str, delimiter: str) -> list[str]:
    try:
        return next(csv.reader([line.rstrip("\r\n")], delimiter=delimiter), [])
    except csv.Error:
        return line.rstrip("\r\n").split(delimiter)
