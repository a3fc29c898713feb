"""A tuning on the disk: what it is, the trials of each study, what was judged of each scheme."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mfpcc_experiments.files import write_whole
from mfpcc_experiments.sweeping.errors import SweepError
from mfpcc_experiments.tuning.study import Trial

#: The file that says what the tuning is.
MARK = "tuning.json"


class Folder:
    """
    A tuning on the disk. Every file appears whole or not at all.

    Parameters
    ----------
    path : Path
        Where.
    content : mapping
        What it is: another one does not go on with it.
    resume : bool
        Whether there may be some of it already.

    Raises
    ------
    SweepError
        If there is something else.
    """

    def __init__(self, path: Path, content: Mapping[str, Any], *, resume: bool) -> None:
        self.path = path
        text = json.dumps(content, indent=1) + "\n"
        if (path / MARK).is_file():
            if not resume:
                raise SweepError(
                    f"{path} holds a tuning: go on with it by --resume, or choose another --out"
                )
            if (path / MARK).read_text(encoding="utf-8") != text:
                raise SweepError(
                    f"{path}: this was begun for other schemes, with another budget or another "
                    "version of the code: choose another --out"
                )
        else:
            if path.exists() and (not path.is_dir() or any(path.iterdir())):
                raise SweepError(f"{path} holds something else than a tuning: choose another --out")
            path.mkdir(parents=True, exist_ok=True)
            write_whole(path / MARK, text)

    def trials(self, scheme: str, repeat: int) -> list[Trial]:
        """What a study has looked at so far."""
        return [Trial(**each) for each in self._read(f"{scheme}_{repeat}.json")]

    def keep_trials(self, scheme: str, repeat: int, trials: list[Trial]) -> None:
        """Put them onto the disk."""
        self._write(f"{scheme}_{repeat}.json", [asdict(trial) for trial in trials])

    def judged(self, scheme: str) -> list[dict[str, Any]]:
        """What was judged of a scheme; empty where it was not yet."""
        return self._read(f"{scheme}_judged.json")

    def keep_judged(self, scheme: str, rows: list[dict[str, Any]]) -> None:
        """Put it onto the disk."""
        self._write(f"{scheme}_judged.json", rows)

    def _read(self, name: str) -> list[dict[str, Any]]:
        try:
            found: list[dict[str, Any]] = json.loads((self.path / name).read_text(encoding="utf-8"))
        except FileNotFoundError:
            return []
        except ValueError:
            raise SweepError(f"{self.path / name}: cannot be read: remove it") from None
        return found

    def _write(self, name: str, rows: list[dict[str, Any]]) -> None:
        lines = ",\n".join(json.dumps(row) for row in rows)
        write_whole(self.path / name, f"[\n{lines}\n]\n")
