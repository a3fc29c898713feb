"""Definitions of message types as they are installed, and as recordings store them."""

from __future__ import annotations

import json
import re
from functools import lru_cache
from pathlib import Path

from mfpcc_experiments.bags.errors import BagError

_FIELD = re.compile(r"^\s*([A-Za-z0-9_/]+)(?:\[[^\]]*\])?\s+[A-Za-z]", re.MULTILINE)
_PRIMITIVES = frozenset(
    f"{kind}{bits}" for kind in ("int", "uint", "float") for bits in (8, 16, 32, 64)
) | {"bool", "byte", "char", "string", "wstring"}


def _share(type_name: str, suffix: str) -> Path:
    """Installed file of a message type (``pkg/msg/Name`` or ``pkg/Name``)."""
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    package, name = type_name.split("/")[0], type_name.split("/")[-1]
    try:
        return Path(get_package_share_directory(package)) / "msg" / f"{name}{suffix}"
    except PackageNotFoundError:
        raise BagError(
            f"the message package '{package}' is not on AMENT_PREFIX_PATH: source setup.bash first"
        ) from None


@lru_cache
def message_definition(type_name: str) -> str:
    """
    Definition of a message type with all it contains, as rosbag2 stores it (``ros2msg``).

    Parameters
    ----------
    type_name : str
        E.g. ``mfpcc_msgs/msg/DriveState``.

    Returns
    -------
    str
        The .msg file, followed by those of the types it uses, each after a line of 80 ``=``.
    """
    seen: set[str] = set()

    def text(name: str) -> str:
        path = _share(name, ".msg")
        try:
            result = path.read_text(encoding="utf-8")
        except OSError as error:
            raise BagError(f"message type {name}: {path}: {error.strerror}") from None
        package = name.split("/")[0]
        used = set(_FIELD.findall(result)) - _PRIMITIVES
        for part in sorted(x if "/" in x else f"{package}/{x}" for x in used):
            if part not in seen:
                seen.add(part)
                result += f"\n{'=' * 80}\nMSG: {part}\n{text(part)}"
        return result

    return text(type_name)


@lru_cache
def type_hash(type_name: str) -> str:
    """
    Return the RIHS01 hash of a message type, or an empty text if its package has none installed.

    Parameters
    ----------
    type_name : str
        E.g. ``mfpcc_msgs/msg/DriveState``.
    """
    try:
        description = json.loads(_share(type_name, ".json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return ""
    for entry in description.get("type_hashes", ()):
        if entry.get("type_name") == type_name:
            return str(entry["hash_string"])
    return ""
