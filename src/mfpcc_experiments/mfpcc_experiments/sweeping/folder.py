"""
A sweep on the disk: what it is, in one file, and its rows, one file for each chunk.

Every file appears whole or not at all, and its name says what is in it. So the folder is all the
state that a sweep has.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mfpcc_experiments.files import write_whole
from mfpcc_experiments.sweeping.errors import SweepError
from mfpcc_experiments.sweeping.plan import Plan
from mfpcc_experiments.sweeping.spec import Spec
from mfpcc_experiments.sweeping.work import shared
from pwm_node import interrupts

#: The file that says what the sweep is.
MARK = "sweep.json"

_FORMAT = 1


class Folder:
    """
    A sweep on the disk.

    Parameters
    ----------
    path : Path
        Where.
    content : mapping
        What `MARK` holds.
    """

    def __init__(self, path: Path, content: Mapping[str, Any]) -> None:
        self.path = path
        self.content = dict(content)
        self.plan = Plan(Spec.model_validate(content["spec"]), tuple(content["schemes"]))
        now = shared(self.plan)
        if any(now[key] != content[key] for key in ("base", "motors")):
            raise SweepError(
                f"{path}: the experiment or a motor file is another one now than when the sweep "
                "began: choose another --out"
            )

    def file(self, chunk: int) -> Path:
        """Where the rows of a chunk are."""
        return self.path / f"{self.content['hash']}-{chunk:06d}.parquet"

    def done(self) -> list[int]:
        """Chunks that are there."""
        return [n for n in range(self.plan.chunks) if self.file(n).is_file()]

    def rows_of(self, chunk: int) -> int:
        """How many rows a chunk has."""
        _, start, stop = self.plan.chunk(chunk)
        return stop - start

    def keep(self, chunk: int, data: bytes) -> None:
        """Put the rows of a chunk onto the disk."""
        path = self.file(chunk)
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        with interrupts.finished():
            try:
                temporary.write_bytes(data)
                os.replace(temporary, path)
            except OSError as error:
                temporary.unlink(missing_ok=True)
                raise OSError(error.errno, error.strerror, str(path)) from None


def begin(path: Path, plan: Plan, fingerprint: Mapping[str, str], *, resume: bool) -> Folder:
    """
    Make the folder of a sweep, or go on with one.

    Parameters
    ----------
    path : Path
        Where.
    plan : Plan
        The sweep.
    fingerprint : mapping
        Of this machine, as from `work.fingerprint`.
    resume : bool
        Whether there may be some of it already.

    Raises
    ------
    SweepError
        If there is something else, or somebody who would give other rows began it.
    """
    content: dict[str, Any] = {
        "format": _FORMAT,
        "spec": plan.spec.model_dump(mode="json"),
        "schemes": list(plan.schemes),
        **{key: shared(plan)[key] for key in ("base", "motors")},
        "chunk_rows": plan.chunk_rows,
        "code": fingerprint["code"],
    }
    text = json.dumps(content, sort_keys=True)
    content["hash"] = hashlib.sha256(text.encode()).hexdigest()[:12]
    content["rows"] = plan.rows
    content["arithmetic"] = fingerprint["arithmetic"]
    if (path / MARK).is_file():
        there = _content(path)
        if not resume:
            raise SweepError(
                f"{path} holds a sweep: go on with it by --resume, or choose another --out"
            )
        for key, what in (
            ("code", "with another version of the code"),
            ("hash", "from another file, or for other schemes"),
            ("arithmetic", "on a processor whose arithmetic gives other digits"),
        ):
            if there.get(key) != content[key]:
                raise SweepError(f"{path}: this sweep was begun {what}: choose another --out")
        for left in path.glob(".*.parquet.*"):
            left.unlink(missing_ok=True)
    else:
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise SweepError(f"{path} holds something else than a sweep: choose another --out")
        path.mkdir(parents=True, exist_ok=True)
        write_whole(path / MARK, json.dumps(content, indent=1) + "\n")
    return Folder(path, content)


def load(path: Path) -> Folder:
    """
    Open the folder of a sweep.

    Raises
    ------
    SweepError
        If there is none.
    """
    if not (path / MARK).is_file():
        raise SweepError(f"{path}: there is no sweep here (no {MARK})")
    return Folder(path, _content(path))


def _content(path: Path) -> dict[str, Any]:
    try:
        content = json.loads((path / MARK).read_text(encoding="utf-8"))
    except ValueError:
        raise SweepError(f"{path / MARK}: cannot be read: choose another --out") from None
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise SweepError(f"{path / MARK}: written by another version: choose another --out")
    return content
