"""
Recordings of measured drives, in the files of other tools, as bags.

`import_file` writes the bag; `mapping` says what the columns of a file are, `tables` and `text`
read them in pieces (`block`), `clock` numbers the rows by periods, `samples` makes samples and
commands.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mfpcc_experiments.front_door import front_door

if TYPE_CHECKING:
    from mfpcc_experiments.importing.errors import ImportFailedError
    from mfpcc_experiments.importing.imports import Imported, import_file
    from mfpcc_experiments.importing.mapping import Map, load

__all__ = ["ImportFailedError", "Imported", "Map", "import_file", "load"]

__getattr__ = front_door(
    __name__,
    {
        "errors": ("ImportFailedError",),
        "imports": ("Imported", "import_file"),
        "mapping": ("Map", "load"),
    },
)
