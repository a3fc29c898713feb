from pathlib import Path

import pydantic
import pytest

from pwm_node import yaml_files
from pwm_node.yaml_files import FileError, find, load


class Window(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid")
    start: float
    stop: float = pydantic.Field(description="end of the window in s")


class Motor(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid")
    name: str
    R_s: float = pydantic.Field(gt=0, description="stator resistance in ohm")
    n_p: int = 4
    windows: list[Window] = []

    @pydantic.field_validator("name")
    @classmethod
    def not_blank(cls, value: str) -> str:
        if not value.strip():
            raise ValueError("must not be blank")
        return value


@pytest.fixture
def write(tmp_path):
    def _write(text: str | bytes) -> Path:
        path = tmp_path / "motor.yaml"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return _write


def complaint(path: Path) -> str:
    with pytest.raises(FileError) as caught:
        load(path, Motor)
    text = str(caught.value)
    assert str(path) in text
    return text


def test_reads_a_model(write):
    motor = load(write("name: a\nR_s: 3e-1\nwindows:\n- {start: 0, stop: 1.5}\n"), Motor)
    assert motor.R_s == 0.3 and motor.windows[0].stop == 1.5


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("name: a\n", "the key 'R_s' is missing (stator resistance in ohm)"),
        ("name: a\nR_s: high\n", "'R_s' should be a valid number"),
        ("name: a\nR_s: high\n", "not 'high' (stator resistance in ohm)"),
        ("name: a\nR_s: -1\n", "'R_s' should be greater than 0, not -1"),
        ("name: a\nR_s: 1\nr_s: 2\n", "unknown key 'r_s'; did you mean 'R_s'?"),
        ("name: a\nR_s: 1\nnp: 2\n", "did you mean 'n_p'?"),
        ("name: a\nR_s: 1\nwindows: [{start: 0, stpo: 1}]\n", "did you mean 'stop'?"),
        ("name: a\nR_s: 1\nwindows: [{start: 0}]\n", "'windows[0].stop' is missing"),
        ("name: ' '\nR_s: 1\n", "'name': must not be blank"),
        ("name: a\nname: b\n", "line 2: the key 'name' occurs twice"),
        ("name: [a\n", "line 2"),
        ("a: &x [1]\nb: *x\n", "aliases"),
        ("- 1\n", "found a list"),
        ("", "empty"),
        ("1: 2\n", "not a text"),
        (b"\xff\xfe\x00", "not a text file"),
        ("name: !!python/object/apply:os.system [true]\n", "constructor"),
        ("[" * 5000, "nested too deeply"),
        ("#" * (yaml_files.MAX_BYTES + 1), "larger than"),
    ],
)
def test_errors_are_for_people(write, text, says):
    assert says in complaint(write(text))


def test_a_file_that_is_not_there(tmp_path):
    assert "no such file" in complaint(tmp_path / "motor.yaml")
    assert "cannot be read" in complaint(tmp_path)


def test_finds_by_name_and_by_path(tmp_path, monkeypatch):
    monkeypatch.setattr(yaml_files, "_share", lambda: tmp_path)
    (tmp_path / "motors").mkdir()
    path = tmp_path / "motors" / "seed_750.yaml"
    path.write_text("name: seed_750\n")
    assert find("motors", "seed_750") == path
    assert find("motors", str(path)) == path
    assert list(yaml_files.available("motors")) == ["seed_750"]
    with pytest.raises(FileError, match="unknown motor 'seed750'; did you mean 'seed_750'"):
        find("motors", "seed750")
    with pytest.raises(FileError, match="no such file"):
        find("motors", "./seed_750.yaml")
