"""What is installed, from the ament index. Knows nothing of what runs."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from ament_index_python import (
    PackageNotFoundError,
    get_package_prefix,
    get_packages_with_prefixes,
    get_resource,
    get_resources,
    has_resource,
)


def package_names() -> list[str]:
    """Return the names of all packages, sorted."""
    return sorted(get_packages_with_prefixes())


def package_prefix(package: str) -> Path | None:
    """Return where a package is installed, or None if it is not."""
    try:
        return Path(get_package_prefix(package))
    except (PackageNotFoundError, ValueError):
        return None


def executables(package: str) -> list[Path]:
    """
    Return the executables of a package.

    Raises
    ------
    RuntimeError
        If there is no such package.
    """
    prefix = package_prefix(package)
    if prefix is None:
        raise RuntimeError(f"Package '{package}' not found")
    found = []
    for folder, folders, files in os.walk(prefix / "lib" / package):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        found += [Path(folder, name) for name in sorted(files)]
    return [path for path in found if os.access(path, os.X_OK)]


#: Namespace of an interface type, and how the names of its files end.
INTERFACE_KINDS = {"msg": (".msg", ".idl"), "srv": (".srv", ".idl"), "action": (".action", ".idl")}


def interfaces(
    kinds: Iterable[str] = tuple(INTERFACE_KINDS), package: str | None = None
) -> dict[str, list[str]]:
    """
    Return the interface types there are, e.g. ``{"std_msgs": ["msg/String", ...]}``.

    Parameters
    ----------
    kinds : iterable of str
        Of ``msg``, ``srv`` and ``action``.
    package : str, optional
        Look in this package only.

    Raises
    ------
    RuntimeError
        If there is no such package.
    """
    if package is not None and not has_resource("packages", package):
        raise RuntimeError(f"Unknown package '{package}'")
    result = {}
    for name in sorted(get_resources("rosidl_interfaces")):
        if package not in (None, name):
            continue
        content, _ = get_resource("rosidl_interfaces", name)
        types = {
            path.rsplit(".", 1)[0]
            for path in content.splitlines()
            for kind in kinds
            # Names with an underscore belong to the insides of services and actions.
            if path.startswith(f"{kind}/")
            and "_" not in path
            and path.endswith(INTERFACE_KINDS[kind])
        }
        if types:
            result[name] = sorted(types)
    return result


def interface_file(name: str) -> Path:
    """
    Return the file that defines an interface type.

    Parameters
    ----------
    name : str
        E.g. ``std_msgs/msg/String``.

    Raises
    ------
    RuntimeError
        If the name is not of that form, or there is no such type.
    """
    parts = name.split("/")
    if len(parts) != 3:
        raise RuntimeError(f"Invalid name '{name}'. Expected three parts separated by '/'")
    if not all(parts):
        raise RuntimeError(f"Invalid name '{name}'. Must not contain empty parts")
    if ".." in parts:
        raise RuntimeError(f"Invalid name '{name}'. Must not contain '..'")
    prefix = has_resource("packages", parts[0])
    if not prefix:
        raise RuntimeError(f"Unknown package '{parts[0]}'")
    base = Path(prefix, "share", *parts)
    for path in (base.with_name(f"{base.name}.{parts[1]}"), base.with_name(f"{base.name}.idl")):
        if path.exists():
            return path
    raise RuntimeError(f"Could not find the interface '{path}'")
