"""Files and folders of results that appear whole or not at all."""

from __future__ import annotations

import contextlib
import glob
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import click

from mfpcc_experiments.scratch import held, left_over
from pwm_node import interrupts
from pwm_node.errors import ForPeople

#: The file that every folder of results has, and by which it is known as one.
MARK = "metrics.json"

# A recording below this size (bytes) holds message definitions and next to no message.
_EMPTY_BAG = 50_000


class ResultFolderError(ForPeople, ValueError):
    """A place where the results cannot go; the text says why and what to do."""


def write_whole(path: Path, text: str) -> None:
    """
    Write a text file.

    Parameters
    ----------
    path : Path
        File; replaced if it is there.
    text : str
        Content.

    Raises
    ------
    OSError
        If it cannot be written; what was there stays.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    with interrupts.finished():
        try:
            temporary.write_text(text, encoding="utf-8")
            os.replace(temporary, path)
        except OSError as error:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise OSError(error.errno, error.strerror, str(path)) from None


def write_rows(folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write ``metrics.json``, one object per run: what makes a folder one of results."""
    write_whole(folder / MARK, json.dumps(rows, indent=2, ensure_ascii=False) + "\n")


@contextmanager
def result_folder(path: Path, *, force: bool = False, mark: str = MARK) -> Iterator[Path]:
    """
    Make a folder of results: work in a neighbour of it, which then takes its place.

    Parameters
    ----------
    path : Path
        Where the results shall be.
    force : bool
        Replace results that are there already. Anything else is never replaced.
    mark : str
        The file by which such results are known.

    Yields
    ------
    Path
        The folder to work in, `<path>.partial-<process>`. If the work fails, or is interrupted, it
        is removed, unless there are recordings in it: those may be all that is left of a long run.

    Raises
    ------
    ResultFolderError
        Before any work is done, if `path` may not be written to.
    """
    path = path.resolve()  # of a link, the folder it leads to is replaced, not the link
    _clear_up(path.resolve())
    _check(path, force, mark)
    with interrupts.undone(), ExitStack() as holding:
        new = [folder for folder in path.parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = _new_folder(path, "partial")
        holding.enter_context(held(partial))
        try:
            yield partial
            _check(path, force, mark)  # the work took its time: the folder may have appeared since
        except BaseException:
            with interrupts.finished():
                if _has_recordings(partial):
                    click.echo(f"what was recorded until then is kept in {partial}", err=True)
                else:
                    shutil.rmtree(partial, ignore_errors=True)
                    with contextlib.suppress(OSError):  # not empty: somebody else's, too
                        for folder in new:
                            folder.rmdir()
            raise
        with interrupts.finished():
            if path.exists():
                # Two renames, so that there is never a folder with something of both.
                replaced = _new_folder(path, "replaced")
                holding.enter_context(held(path))
                path.rename(replaced)
                partial.rename(path)
                shutil.rmtree(replaced)
            else:
                partial.rename(path)


def _clear_up(path: Path) -> None:
    """Remove what runs that were killed have left beside their results; what may count stays."""
    for folder in left_over(path.parent, f"{glob.escape(path.name)}.replaced-*"):
        if path.exists():
            shutil.rmtree(folder, ignore_errors=True)
        else:  # it was killed between two renames
            folder.rename(path)
    for folder in left_over(path.parent, f"{glob.escape(path.name)}.partial-*"):
        if _has_recordings(folder):
            click.echo(f"a run that was killed has left recordings in {folder}", err=True)
        else:
            shutil.rmtree(folder, ignore_errors=True)


def _has_recordings(folder: Path) -> bool:
    return any(bag.stat().st_size > _EMPTY_BAG for bag in folder.rglob("*.mcap"))


def _new_folder(path: Path, what: str) -> Path:
    """Make `<path>.<what>-<process>`; containers that share a disk may have processes alike."""
    n = 1
    while True:
        number = f"{os.getpid()}-{n}" if n > 1 else f"{os.getpid()}"
        folder = path.with_name(f"{path.name}.{what}-{number}")
        try:
            folder.mkdir()
            return folder
        except FileExistsError:
            n += 1


def _check(path: Path, force: bool, mark: str) -> None:
    if not path.exists():
        return
    if not path.is_dir():
        raise ResultFolderError(f"{path} is a file: choose another folder with --out")
    if path.resolve() == Path.cwd() or path.resolve() in Path.cwd().parents:
        raise ResultFolderError(f"{path} is where you are: choose a folder below it with --out")
    if not any(path.iterdir()):
        return
    if not (path / mark).is_file():
        raise ResultFolderError(
            f"{path} holds something else than results (it has no {mark}): "
            "choose another folder with --out"
        )
    if not force:
        raise ResultFolderError(f"{path} exists: replace it with --force, or choose another --out")
