"""Any file in the place of a scenario, a motor, a flux map: what it says, or an error with a place.

The files are those of `config/`, mutated: bytes, lines, values, whole trees; and what is known to
bring YAML readers down.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fuzz
import numpy as np
import pytest
import yaml

from mfpcc_controller import motor as nominal_motor
from mfpcc_controller.controller import Controller
from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.running import scenario
from pmsm_sim import flux_map, motor
from pmsm_sim.parameters import TABLE as PLANT
from pmsm_sim.plant import Plant
from pwm_node import yaml_files
from pwm_node.parameters import ParameterError
from pwm_node.yaml_files import FileError

READERS: dict[str, tuple[str, Callable[[str], Any]]] = {
    "scenario": ("experiments", scenario.load),
    "motor": ("motors", motor.load),
    "nominal motor": ("motors", nominal_motor.load),
    "flux map": ("flux_maps", flux_map.load),
}

SCALARS = (
    "0", "-1", "1e-3", "1e400", "-.inf", ".nan", "0x" + "f" * 5000, "9" * 5000, "1:30:00", "1e5",
    "2024-99-99", "true", "null", "~", "''", "'\\0'", "!!python/object/apply:os.system ['true']",
    "!!binary aGVsbG8=", "!!float x", "!!int '9'", "&a [*a]", "*nobody", "{<<: {a: 1}}", "? [1]",
    "- - -", "\t", "%TAG", "---\n...", "'" + "x" * 10_000 + "'", "seed_750", "../../etc/passwd",
    "/dev/zero.yaml", "[]", "{}",
)  # fmt: skip

#: Small files that stand for huge or endless ones.
BOMBS = {
    "aliases": "a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\nd: &d [*c, *c]\n",
    "itself": "a: &a [*a]\n",
    "depth": "[" * 100_000,
    "depth of keys": "{a: " * 50_000,
    "indentation": "".join(" " * n + "a:\n" for n in range(1000)),
    "digits": "duration: " + "9" * 900_000,
    "hexadecimal": "duration: 0x" + "f" * 900_000,
    "base 60": "duration: 1" + ":59" * 100_000,
    "one line": "a" * 900_000,
    "keys": "".join(f"k{n}: 1\n" for n in range(5000)),
    "merge": "<<: {a: 1}\n" * 2000,
    "quotes": "'" * 200_001,
    "questions": "? " * 20_000,
    "dashes": "- " * 20_000,
    "tags": "!a " * 20_000,
    "too large": "#" * (yaml_files.MAX_BYTES + 1),
}


def tree(rng: np.random.Generator, depth: int = 0) -> Any:
    """A value of any shape."""
    kind = rng.integers(8 if depth < 4 else 6)
    if kind == 0:
        return fuzz.any_float(rng)
    if kind == 1:
        return fuzz.any_integer(rng) ** int(rng.integers(1, 4))
    if kind == 2:
        return ("", "seed_750", "x" * 300, "a: b", "\n")[rng.integers(5)]
    if kind == 3:
        return bool(rng.integers(2))
    if kind in (4, 5):
        return None
    if kind == 6:
        return [tree(rng, depth + 1) for _ in range(rng.integers(4))]
    return {f"k{n}" if rng.random() < 0.5 else "at": tree(rng, depth + 1) for n in range(3)}


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Every container in a tree with each of its keys."""
    for key in value if isinstance(value, dict) else range(len(value)):
        yield value, key
        if isinstance(value[key], (dict, list)):
            yield from places(value[key])


def mutated(rng: np.random.Generator, text: str) -> bytes:
    """A file like this one, with something wrong in it; sometimes it is still right."""
    kind = rng.integers(5)
    if kind == 0:
        data = bytearray(text.encode())
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        return bytes(data[: rng.integers(len(data))]) if rng.random() < 0.2 else bytes(data)
    if kind == 1:
        lines = text.splitlines(keepends=True)
        one, other = rng.integers(len(lines), size=2)
        lines[one], lines[other] = lines[other], lines[one] * int(rng.integers(3))
        return "".join(lines).encode()
    if kind == 2:
        lines = text.splitlines()
        at = rng.integers(len(lines))
        key, colon, _ = lines[at].partition(":")
        lines[at] = f"{key}{colon or ':'} {SCALARS[rng.integers(len(SCALARS))]}"
        return "\n".join(lines).encode()
    data_tree = copy.deepcopy(yaml.safe_load(text))
    for _ in range(rng.integers(1, 3)):
        spots = list(places(data_tree))
        container, key = spots[rng.integers(len(spots))]
        if kind == 3:
            container[key] = tree(rng)
        elif isinstance(container, dict):
            container[key + "s" if isinstance(key, str) else "s"] = container.pop(key)
        else:
            del container[key:]
    return yaml.safe_dump(data_tree).encode()


@pytest.mark.parametrize("what", READERS)
def test_a_mutated_file_is_read_or_refused(what: str, tmp_path: Path) -> None:
    kind, read = READERS[what]
    originals = [path.read_text() for path in yaml_files.available(kind).values()]
    path = tmp_path / "mutated.yaml"
    for rng in fuzz.cases(20 if what == "flux map" else 80):
        path.write_bytes(mutated(rng, originals[rng.integers(len(originals))]))
        found, refusal = fuzz.outcome(FileError, read, str(path))
        if refusal:
            assert all(line.startswith(str(path)) for line in refusal.splitlines()), refusal
            assert len(refusal) < 20_000
        elif what == "scenario":
            # what was accepted can be run: complete, checked parameters of both nodes, or a reason
            fuzz.outcome(ParameterError, found.node_parameters, "mbpcc", 0)
        elif what == "motor":
            Plant(PLANT.complete({"motor": str(path)}))
        elif what == "nominal motor":
            Controller(CONTROLLER.complete({"motor": str(path)}))


@pytest.mark.parametrize("what", ["scenario", "motor"])
@pytest.mark.parametrize("bomb", BOMBS)
def test_a_bomb_does_not_go_off(bomb: str, what: str, tmp_path: Path) -> None:
    path = tmp_path / "bomb.yaml"
    path.write_text(BOMBS[bomb])
    with pytest.raises(FileError, match=r"bomb\.yaml"):
        READERS[what][1](str(path))
