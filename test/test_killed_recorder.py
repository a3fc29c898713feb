"""What a recorder that is killed leaves behind: the process itself, and `mfpcc recover`."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from harness import Process, reached, until
from outside import Outside
from synthetic_drive import messages

from mfpcc_experiments.bags import LOOP_TOPICS, recording, recover
from mfpcc_experiments.graph.in_step import InStep

Start = Callable[..., Process]

#: Of the promise (periods of 0.1 ms): a cut lies so little before the last message.
PROMISED = 2000


@pytest.fixture
def outside(domain: int) -> Iterator[Outside]:
    it = Outside()
    yield it
    it.close()


def ends(bag: Path) -> set[int]:
    """The sample to which the last message of each topic belongs, by the messages themselves."""
    found = recording.read(bag)
    assert found.lost_periods == 0, found.notes
    topics = (found.feedback, found.command, found.lut, found.state)
    lasts = [int(rows["period"][-1]) for rows in topics]
    return {lasts[0], lasts[1] - 1, *lasts[2:]}


@pytest.mark.parametrize("at", [1500, 4000])
def test_all_topics_end_at_the_same_period(
    at: int, start: Start, outside: Outside, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    recorder = start("mfpcc_experiments", "record", "--out", str(bag))
    waits = ("--ros-args", "-p", "recorders:=1")
    controller = start("mfpcc_controller", "controller", *waits)
    plant = start("pmsm_sim", "pmsm_sim", *waits)
    until(lambda: reached(bag) > at or recorder.ended, "so much is on disk")
    recorder.kill()
    for process in (plant, controller):
        process.kill()  # they would wait for it
    said = recover.recover(bag)
    (end,) = ends(bag)
    assert f"all topics of the loop end at period {end}" in said
    assert end > at - 2 and "left out" not in said, said


def test_what_was_recorded_is_on_disk_but_for_a_little(start: Start, tmp_path: Path) -> None:
    """A drive ends by itself, so what the recorder has got is known."""
    bag, periods = tmp_path / "bag", 3500
    recorder = start("mfpcc_experiments", "record", "--out", str(bag))
    parameters = ("-p", "recorders:=1", "-p", f"periods:={periods}")
    drive = start("mfpcc_experiments", "drive", "--ros-args", *parameters)
    assert drive.wait() == 0, drive.output
    until(lambda: reached(bag) >= periods - PROMISED, "what the recorder has got is on disk")
    recorder.kill()
    recover.recover(bag)
    (end,) = ends(bag)
    assert periods - PROMISED <= end <= periods


@pytest.mark.parametrize("seed", range(10))
def test_topics_that_come_one_after_the_other_are_written_period_by_period(seed: int) -> None:
    source, rng = list(messages(300)), random.Random(seed)
    written: list[tuple[str, int, bytes]] = []
    in_step = InStep(lambda *message: written.append(message), {})
    queues = [[m for m in source if m[0] == topic] for topic in LOOP_TOPICS]
    while any(queues):
        for queue in queues:
            count = rng.randrange(80)
            for name, at, data in queue[:count]:
                in_step.add(name, int.from_bytes(data[12:20], "little"), at, data)
            del queue[:count]
        in_step.release()
        last = {m[0]: int.from_bytes(m[2][12:20], "little") for m in written}
        if len(last) == 4:
            last["duty_command"] -= 1
            assert len(set(last.values())) == 1
    assert sorted(written) == sorted(source)


def test_a_topic_that_comes_late_is_waited_for() -> None:
    """The commands of 100 ms come before any sample of that time, as they do on a busy machine."""
    written: list[tuple[str, int]] = []
    in_step = InStep(lambda topic, at, _: written.append((topic, at)), {})
    source = [m for m in messages(1100) if m[0] in ("phase_feedback", "duty_command")]

    def take(topic: str, begin: int, end: int) -> None:
        for name, at, data in source:
            if name == topic and begin <= at // 100_000 < end:
                in_step.add(name, int.from_bytes(data[12:20], "little"), at, data)

    take("phase_feedback", 0, 100)
    take("duty_command", 0, 101)
    in_step.release()
    take("duty_command", 101, 1100)
    for _ in range(20):
        in_step.release()
    assert max(at for _, at in written) == 100 * 100_000  # the command for the sample after 99
    take("phase_feedback", 100, 1100)
    in_step.release()
    assert sorted(at for _, at in written[-2:]) == [1098 * 100_000, 1099 * 100_000]
    assert [at for _, at in written] == sorted(at for _, at in written)


def test_a_topic_that_falls_silent_is_not_waited_for() -> None:
    written: list[str] = []
    in_step = InStep(lambda topic, *_: written.append(topic), {})
    for name, at, data in messages(3000):
        if name != "lut_diagnostics" or at < 100 * 100_000:
            in_step.add(name, int.from_bytes(data[12:20], "little"), at, data)
            in_step.release()
    assert written.count("phase_feedback") == 3000


def test_a_drive_that_begins_anew_while_its_messages_wait() -> None:
    written: list[int] = []
    in_step = InStep(lambda topic, at, data: written.append(at), {})
    for _ in range(2):
        for name, at, data in messages(50):
            if name == "phase_feedback":
                in_step.add(name, int.from_bytes(data[12:20], "little"), at, data)
    in_step.release(everything=True)
    assert written == [k * 100_000 for k in range(50)] * 2
