"""Bags of the synthetic drive."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from synthetic_drive import CONFIG, Message, messages


@pytest.fixture(scope="session")
def drive_messages() -> Callable[..., Iterator[Message]]:
    """See `messages`."""
    return messages


@pytest.fixture(scope="session")
def write_bag() -> Callable[..., Path]:
    """Writes a bag of the synthetic drive into a folder and returns it."""

    def write(
        path: Path,
        periods: int = 4000,
        *,
        oversampling: int = 0,
        config: dict | None = None,
        source: Iterator[Message] | None = None,
        **options: object,
    ) -> Path:
        from mfpcc_experiments.bags import BagWriter

        if source is None:
            source = messages(periods, oversampling=oversampling)
        content = CONFIG if config is None else config
        with BagWriter(path, config=content, oversampling=oversampling, **options) as bag:
            for message in source:
                bag.write(*message)
            bag.close({"step_time_us": {"median": 3.0, "p99": 9.0}})
        return path

    return write


@pytest.fixture
def no_vectors(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of numbers and words: figures as PNG files alone, at half the cost of all three."""
    from mfpcc_experiments.reporting import figures

    monkeypatch.setattr(figures, "FORMATS", {".png": figures.FORMATS[".png"]})


@pytest.fixture
def make_bag(tmp_path: Path, write_bag: Callable[..., Path]) -> Callable[..., Path]:
    """Writes a bag of the synthetic drive under a name and returns its folder."""

    def make(name: str = "run", *arguments: object, **options: object) -> Path:
        return write_bag(tmp_path / name, *arguments, **options)

    return make
