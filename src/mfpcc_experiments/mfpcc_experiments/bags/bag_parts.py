"""
Which files make up a bag, and in which order.

``metadata.yaml`` says so, where there is one: rosbag2 names the parts of a split bag there, and
other files in the folder do not belong to it. Without one, all files that look like recordings do.
What a file holds is seen from its first bytes, never from its name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from mfpcc_experiments.bags.errors import BagError
from mfpcc_experiments.bags.metadata import METADATA
from mfpcc_experiments.notes import Note, warning

#: Names of files that may hold a recording, or a part of one.
SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")

_LARGEST_METADATA = 64 << 20  # bytes
_NAMED_MOST = 3  # files that a sentence names


@dataclass
class Parts:
    """
    The files of a bag.

    Attributes
    ----------
    files : list of Path
        In their order.
    notes : list of Note
        What the folder holds besides, or has not.
    message_counts : dict of int, or None
        Messages that ``metadata.yaml`` tells of, by topic; None where it tells nothing.
    custom_data : dict of str
        Free entries of ``metadata.yaml``.
    numbering : list of Note
        Numbers that the names of the parts leave out. Files may have been renamed: it matters only
        where periods are not there.
    """

    files: list[Path]
    notes: list[Note] = field(default_factory=list)
    message_counts: dict[str, int] | None = None
    custom_data: dict[str, str] = field(default_factory=dict)
    numbering: list[Note] = field(default_factory=list)


def parts_of(path: Path) -> Parts:
    """
    Find the files of a bag.

    Parameters
    ----------
    path : Path
        Folder of a bag, or one of its files.

    Raises
    ------
    BagError
        If there is no bag, or a part of it is missing.
    """
    try:
        if path.is_dir():
            return _of_folder(path)
        if path.name == METADATA and path.is_file():
            return _of_folder(path.parent)
        if path.is_file():
            return _of_file(path)
        there = path.exists()
    except OSError as error:
        raise BagError(f"{path}: {error.strerror}") from None
    if there:
        raise BagError(f"{path}: is neither a file nor a folder")
    raise BagError(f"{path}: there is no such file or folder")


def bags_in(path: Path) -> list[Path]:
    """
    Bags in a folder of results, or else what was given: reading it says what it is.

    Parameters
    ----------
    path : Path
        Folder of a bag, a file, or a folder with bags in it.
    """
    try:
        if not path.is_dir() or (path / METADATA).exists() or candidates(path):
            return [path]
        inside = [x for x in sorted(path.iterdir()) if x.is_dir() and not x.name.startswith(".")]
        bags = [x for x in inside if (x / METADATA).exists() or candidates(x)]
    except OSError as error:
        raise BagError(f"{path}: {error.strerror}") from None
    return bags or [path]


def candidates(folder: Path) -> list[Path]:
    """Files that look like recordings, parts of a split bag by number: _2 before _10."""
    files = (
        x
        for x in folder.iterdir()
        if x.name.endswith(SUFFIXES) and not x.name.startswith(".") and x.is_file()
    )
    return sorted(files, key=_by_number)


def _by_number(path: Path) -> tuple[int, str]:
    return (_numbered(path)[1] or 0, path.name)


def _numbered(path: Path) -> tuple[str, int | None]:
    """Name of a bag and number of its part, from the name of a file."""
    stem = path.name
    for suffix in sorted(SUFFIXES, key=len, reverse=True):
        stem = stem.removesuffix(suffix)
    digits = re.search(r"_(\d{1,18})$", stem)
    return (stem[: digits.start()], int(digits[1])) if digits else (stem, None)


def _numbers_left_out(files: list[Path]) -> list[Note]:
    """Whether the numbers of the parts, which begin with 0, leave one out."""
    numbers: dict[str, set[int]] = {}
    for name, number in map(_numbered, files):
        if number is not None:
            numbers.setdefault(name, set()).add(number)
    return [
        warning(
            f"the parts {name}_N are numbered up to {max(there)}, and there are only {len(there)} "
            "of them: a part is missing"
        )
        for name, there in numbers.items()
        if 1 < len(there) <= max(there)
    ]


def _of_file(path: Path) -> Parts:
    """A file of its own, or a part of a bag that was asked for alone."""
    parts = Parts([path])
    listed = _listed(path.parent, _read(path.parent / METADATA))
    if listed is not None and len(listed) > 1 and path.name in {x.name for x in listed}:
        text = f"{path.name} is one of the {len(listed)} parts of a bag; the others are left out"
        parts.notes.append(warning(text))
    return parts


def _of_folder(folder: Path) -> Parts:
    there = candidates(folder)
    metadata = _read(folder / METADATA)
    listed = _listed(folder, metadata)
    if listed is None:
        if not there:
            raise BagError(f"{folder}: no recording here (a bag is a folder with an .mcap file)")
        parts = Parts(_once(there))
        parts.numbering = _numbers_left_out(parts.files)
        if (folder / METADATA).exists():
            text = f"{METADATA} cannot be read; all {len(parts.files)} files in the folder count"
            parts.notes.append(warning(text))
        return parts
    files = [_found(folder, name) for name in listed]
    parts = Parts(files, message_counts=_counts(metadata), custom_data=_custom(metadata))
    parts.numbering = _numbers_left_out(files)
    others = [x.name for x in there if x not in files and not _is_twin(x, files)]
    if others:
        names = ", ".join(others[:_NAMED_MOST]) + (", ..." if len(others) > _NAMED_MOST else "")
        text = f"{names} in the folder is not a part of the bag by its {METADATA}, and is left out"
        parts.notes.append(warning(text))
    return parts


def _read(path: Path) -> Mapping[str, Any] | None:
    """What ``metadata.yaml`` says, or None."""
    try:
        if not path.is_file() or path.stat().st_size > _LARGEST_METADATA:
            return None
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        content = yaml.load(path.read_text(encoding="utf-8"), loader)
        information = content["rosbag2_bagfile_information"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError, yaml.YAMLError):
        return None
    return information if isinstance(information, Mapping) else None


def _listed(folder: Path, metadata: Mapping[str, Any] | None) -> list[Path] | None:
    """Paths of the parts as ``metadata.yaml`` lists them; None where it lists none."""
    if metadata is None:
        return None
    names = metadata.get("relative_file_paths")
    if not isinstance(names, list) or not all(isinstance(name, str) and name for name in names):
        return None
    # rosbag2 wrote the name of the folder before it until version 3, and some tools write whole
    # paths. A bag is its folder: nothing is read that lies elsewhere.
    return list(dict.fromkeys(folder / Path(name).name for name in names)) or None


def _found(folder: Path, listed: Path) -> Path:
    """The file of a listed part: as it is listed, or packed or unpacked since."""
    packed = listed.with_name(listed.name + ".zstd")
    unpacked = listed.with_name(listed.name.removesuffix(".zstd"))
    for path in (listed, unpacked, packed):
        if path.is_file():
            return path
    raise BagError(f"{folder}: '{listed.name}', a part of the bag by its {METADATA}, is missing")


def _is_twin(path: Path, files: list[Path]) -> bool:
    """Whether this is the same part packed or unpacked."""
    plain = {x.name.removesuffix(".zstd") for x in files}
    return path.name.removesuffix(".zstd") in plain


def _once(files: list[Path]) -> list[Path]:
    """Of a part that is there packed and unpacked, the unpacked one."""
    names = {x.name for x in files}
    return [
        x for x in files if not (x.name.endswith(".zstd") and x.name.removesuffix(".zstd") in names)
    ]


def _counts(metadata: Mapping[str, Any] | None) -> dict[str, int] | None:
    """Messages by topic."""
    counts: dict[str, int] = {}
    try:
        for entry in (metadata or {})["topics_with_message_count"]:
            name, count = entry["topic_metadata"]["name"], entry["message_count"]
            counts[name] = counts.get(name, 0) + int(count)
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    return counts


def _custom(metadata: Mapping[str, Any] | None) -> dict[str, str]:
    custom = (metadata or {}).get("custom_data")
    if not isinstance(custom, Mapping):
        return {}
    return {str(key): str(value) for key, value in custom.items()}
