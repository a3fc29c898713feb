"""YAML files read into pydantic models, with errors for people.

Motors and experiments are YAML files. They are found by name in the share folder of the package
`mfpcc_config`, or by path anywhere.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, TypeVar

import pydantic
import yaml

from pwm_node import names
from pwm_node.errors import ForPeople

MAX_BYTES = 1 << 20
CONFIG_PACKAGE = "mfpcc_config"

_LONGEST_NUMBER = 400  # characters: more than any float has
_MOST_ERRORS = 10

Model = TypeVar("Model", bound=pydantic.BaseModel)


class FileError(ForPeople, ValueError):
    """A file that cannot be read as what it should be; the text says where, what and why."""


class _Loader(yaml.SafeLoader):
    """The safe loader, without YAML's traps for people who write numbers and lists by hand."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        # Nested aliases can make a small file stand for a huge document.
        if self.check_event(yaml.events.AliasEvent):
            event = self.peek_event()
            raise yaml.MarkedYAMLError(
                problem="aliases (*name) are not supported here: write the value out",
                problem_mark=event.start_mark,
            )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        # YAML forbids a key that occurs twice, but PyYAML silently takes the last one.
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                raise yaml.MarkedYAMLError(
                    problem=f"the key {key!r} is not a text", problem_mark=key_node.start_mark
                )
            if key in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"the key '{key}' occurs twice", problem_mark=key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: Any) -> int:
        # 1:30 is 90 to YAML 1.1, and a million digits take minutes.
        if ":" in node.value or len(node.value) > _LONGEST_NUMBER:
            raise yaml.MarkedYAMLError(
                problem=f"{names.shown(node.value)} is no number here", problem_mark=node.start_mark
            )
        return super().construct_yaml_int(node)


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)

# YAML 1.1 takes 1e-3 for a text, since it has no decimal point.
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?[0-9][0-9_]*[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)


def load(path: Path | str, model: type[Model]) -> Model:
    """Read a YAML file into a model.

    Parameters
    ----------
    path : Path
        The file, at most 1 MiB.
    model : type
        The pydantic model of its content.

    Raises
    ------
    FileError
        With the file, the line or key, what is expected and, for a misspelt key, the nearest.
    """
    path = Path(path)
    data = _read(path)
    if data is None:
        raise FileError(f"{path}: the file is empty")
    if not isinstance(data, dict):
        raise FileError(f"{path}: expected 'key: value' lines, found {_describe(data)}")
    try:
        return validated(data, model)
    except FileError as error:
        lines = str(error).splitlines()
        raise FileError("\n".join(f"{path}: {line}" for line in lines)) from None


def validated(data: dict[str, Any], model: type[Model]) -> Model:
    """Make a model of what a file holds, or could hold.

    Parameters
    ----------
    data : dict
        Keys and values.
    model : type
        The pydantic model.

    Raises
    ------
    FileError
        With one line for each key that is wrong.
    """
    try:
        return model.model_validate(data)
    except pydantic.ValidationError as error:
        errors = error.errors(include_url=False)
        lines = [_explain(item, model) for item in errors[:_MOST_ERRORS]]
        if len(errors) > _MOST_ERRORS:
            lines.append(f"and {len(errors) - _MOST_ERRORS} more errors")
        raise FileError("\n".join(lines)) from None


def available(kind: str) -> dict[str, Path]:
    """Return the installed files of a kind (``motors``, ``experiments``) by name."""
    folder = _share() / kind
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find(kind: str, name_or_path: str | Path) -> Path:
    """Find a file by the name it is installed under, or by its path.

    Parameters
    ----------
    kind : str
        ``motors`` or ``experiments``.
    name_or_path : str or Path
        A plain name such as ``seed_750``; anything with a slash or ending in ``.yaml`` is a path.
    """
    text = str(name_or_path)
    if isinstance(name_or_path, Path) or "/" in text or text.endswith((".yaml", ".yml")):
        path = Path(name_or_path).expanduser()
        if path.suffix not in (".yaml", ".yml"):
            raise FileError(f"{path}: is no .yaml file")
        if not path.is_file():
            raise FileError(f"{path}: there is no such file")
        return path
    files = available(kind)
    if text not in files:
        singular = kind.removesuffix("s")
        raise FileError(
            f"{names.unknown(singular, text, files)}. The path of a .yaml file will do as well"
        )
    return files[text]


def _share() -> Path:
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    try:
        return Path(get_package_share_directory(CONFIG_PACKAGE))
    except (PackageNotFoundError, LookupError):
        raise FileError(
            f"the package '{CONFIG_PACKAGE}' is not on the path: build the workspace and "
            "'source setup.bash' first"
        ) from None


def _read(path: Path) -> Any:
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file") from None
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}") from None
    if len(raw) > MAX_BYTES:
        raise FileError(f"{path}: larger than {MAX_BYTES // 1024} KiB, so not a file of this kind")
    try:
        return yaml.load(raw.decode("utf-8"), Loader=_Loader)
    except UnicodeDecodeError:
        raise FileError(f"{path}: not a text file in UTF-8") from None
    except RecursionError:
        raise FileError(f"{path}: nested too deeply") from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f" line {mark.line + 1}:" if mark is not None else ""
        raise FileError(f"{path}:{line} {error.problem or error.context}") from None
    except (yaml.YAMLError, ValueError) as error:
        # ValueError: what looks like a date or a number and is not, 2024-99-99.
        raise FileError(f"{path}: not valid YAML: {str(error).splitlines()[0]}") from None


def _explain(error: Any, model: type[pydantic.BaseModel]) -> str:
    """Turn one item of pydantic's list of errors into a sentence."""
    location = error["loc"]
    key = _key(location)
    if error["type"] == "extra_forbidden":
        known = _fields(model, location[:-1])
        sentence = names.unknown("key", str(location[-1]), known)
        return f"{sentence}" if len(location) == 1 else f"in '{_key(location[:-1])}': {sentence}"
    if error["type"] == "missing":
        return f"the key '{key}' is missing{_expectation(model, location)}"
    message = error["msg"]
    for prefix in ("Value error, ", "Assertion failed, "):
        message = message.removeprefix(prefix)
    if error["type"] in ("value_error", "assertion_error"):
        return f"'{key}': {message}" if key else message
    message = message.replace("Input should be", "should be")
    return f"'{key}' {message}, not {_describe(error['input'])}{_expectation(model, location)}"


def _key(location: tuple[int | str, ...]) -> str:
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _describe(value: Any) -> str:
    if isinstance(value, dict):
        return "a group of keys"
    if isinstance(value, list):
        return "a list"
    if value is None:
        return "nothing"
    return names.shown(value)


def _model_at(
    model: type[pydantic.BaseModel] | None, location: tuple[int | str, ...]
) -> type[pydantic.BaseModel] | None:
    """Follow a location into nested models, as far as plain annotations lead."""
    for part in location:
        if model is None or not isinstance(part, str):
            continue
        field = _field(model, part)
        model = _inner_model(field.annotation) if field is not None else None
    return model


def _inner_model(annotation: Any) -> type[pydantic.BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        return annotation
    for argument in getattr(annotation, "__args__", ()):
        inner = _inner_model(argument)
        if inner is not None:
            return inner
    return None


def _field(model: type[pydantic.BaseModel], key: str) -> pydantic.fields.FieldInfo | None:
    for name, field in model.model_fields.items():
        if key in (name, field.alias):
            return field
    return None


def _fields(model: type[pydantic.BaseModel], location: tuple[int | str, ...]) -> list[str]:
    inner = _model_at(model, location)
    if inner is None:
        return []
    return [field.alias or name for name, field in inner.model_fields.items()]


def _expectation(model: type[pydantic.BaseModel], location: tuple[int | str, ...]) -> str:
    """The field's own description, which says more to people than its type does."""
    inner = _model_at(model, location[:-1])
    field = _field(inner, str(location[-1])) if inner is not None else None
    return f" ({field.description})" if field is not None and field.description else ""
