"""
A hundred drives to which something happens, at random times relative to the evaluation window.

Label, figures, notes and exit code have to agree with what an oracle finds in the raw messages of
the recording, one by one and without the project's reader.
"""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments import notes
from mfpcc_experiments.bags import BagWriter, recording
from mfpcc_experiments.measuring import happened, metrics
from mfpcc_experiments.running.engine import Engine
from mfpcc_experiments.running.trace import write_trace
from pmsm_sim.parameters import TABLE as PLANT

T_S = 1e-4
DRAWS = 100
PERIODS, FIRST, END = 500, 200, 400
SCHEMES = ("mls_mfpcc", "mbpcc", "neso_mfpcc", "mfpcc")
FALLBACK = "pi_foc"
# A steady state from the first periods on: imposed speed, 100 Hz electrical, current control.
DRIVE = {"motor": "seed_750", "load.kind": "speed", "load.speed_rpm": 1500.0}
EVENTS = (
    "nothing", "fault", "sto_plant", "sto_controller", "fallback", "switch", "switch_back", "gap",
    "black_gap", "disable", "restart",
)  # fmt: skip


def draw(seed: int) -> list[tuple[int, str]]:
    """
    One or two events and their periods.

    Each kind comes before, within and after the window, whatever the draw.
    """
    random = np.random.default_rng(seed)
    when, kind = divmod(seed, len(EVENTS))
    begin, end = ((20, FIRST), (FIRST, END), (END, PERIODS - 10))[when % 3]
    events = [(int(random.integers(begin, end)), EVENTS[kind])]
    if random.integers(3) == 0:
        events.append((int(random.integers(20, PERIODS - 10)), str(random.choice(EVENTS))))
    if any(name == "restart" for _, name in events):
        # only a whole second run is longer than the first for sure
        events = [(at, "nothing" if "gap" in name else name) for at, name in events]
    return sorted(events)


class Script:
    """What is done to a drive, and the recording of it."""

    def __init__(self, seed: int, path: Path) -> None:
        self.random = np.random.default_rng([seed, 1])
        self.path = path
        self.events = draw(seed)
        self.scheme = str(self.random.choice(SCHEMES))
        self.chosen = [(0, self.scheme)]
        self.changes: list[dict] = []
        self.lost: dict[str, range] = {}
        self.state_every = int(self.random.choice([1, 1, 1, 5]))
        self._values = {
            "pmsm_sim": PLANT.complete(
                {**DRIVE, "initial_speed_rpm": 1500.0, "seed": seed, "noise.current_rms": 0.02}
            ),
            "mfpcc_controller": CONTROLLER.complete(
                {
                    "motor": "seed_750",
                    "scheme": self.scheme,
                    "fallback_scheme": FALLBACK,
                    "control_mode": "current",
                    "i_q_ref": 3.0,
                }
            ),
        }
        self.record()

    def record(self) -> None:
        config = {
            "experiment": "mutated", "scheme": self.scheme, "motor": "seed_750", "T_s": T_S,
            "n_p": 4, "R_s": 1.5, "window_s": [FIRST * T_S, END * T_S],
            "parameters": self._values, "motor_file": {"i_max": 12.0, "psi_f": 0.14},
        }  # fmt: skip
        with BagWriter(self.path, config=config) as writer:
            self._writer = writer
            restart = [at for at, name in self.events if name == "restart"]
            if restart:
                self._run([], restart[0])
            engine = self._run([e for e in self.events if e[1] != "restart"], PERIODS)
            self.faults = [
                *happened.latched("pmsm_sim", engine.plant.faults()),
                *happened.latched("mfpcc_controller", engine.controller.faults()),
            ]
            writer.close(
                {
                    "step_time_us": {"median": 1.0, "p99": 2.0},
                    "parameter_changes": self.changes,
                    "faults": self.faults,
                }
            )

    def _run(self, events: list, periods: int) -> Engine:
        engine = Engine(self._values["pmsm_sim"], self._values["mfpcc_controller"])
        todo = list(events)
        while todo or engine.period < periods:
            limit = todo[0][0] if todo else periods
            for trace in engine.run(max(0, limit - engine.period)):
                self._write(trace)
            if todo:
                at, name = todo.pop(0)
                if name == "disable":
                    todo.append((min(at + int(self.random.integers(1, 80)), PERIODS - 1), "enable"))
                    todo.sort()
                getattr(self, f"_{name}")(engine, engine.period)
        return engine

    def _write(self, trace) -> None:
        writer, lost = self._writer, self.lost

        class Sieve:
            def write(self, topic, stamp, data):
                if int.from_bytes(data[12:20], "little") not in lost.get(topic, ()):
                    writer.write(topic, stamp, data)

        write_trace(Sieve(), trace, state_every=self.state_every)

    def _nothing(self, engine, period):
        pass

    def _fault(self, engine, period):
        engine.plant.apply({"fault.overcurrent": 0.1})

    def _sto_plant(self, engine, period):
        engine.plant.stop()

    def _sto_controller(self, engine, period):
        engine.controller.stop()

    def _fallback(self, engine, period):
        engine.controller.overran(99.0)

    def _choose(self, engine, period, name):
        engine.controller.apply({"scheme": name})
        self.chosen.append((period, name))
        self.changes.append(
            {"period": period, "node": "mfpcc_controller", "name": "scheme", "value": name}
        )

    def _switch(self, engine, period):
        self._choose(engine, period, str(self.random.choice([*SCHEMES, FALLBACK])))

    def _switch_back(self, engine, period):
        self._choose(engine, period, self.scheme)

    def _disable(self, engine, period):
        engine.controller.enabled = False

    def _enable(self, engine, period):
        engine.controller.enabled = True

    def _gap(self, engine, period):
        topic = ("phase_feedback", "duty_command", "lut_diagnostics", "drive_state")[
            int(self.random.integers(4))
        ]
        self._drop([topic], period)

    def _black_gap(self, engine, period):
        self._drop(["phase_feedback", "duty_command", "lut_diagnostics", "drive_state"], period)

    def _drop(self, topics, period):
        length = int(self.random.integers(1, 60)) * (5 if "drive_state" in topics else 1)
        for topic in topics:
            self.lost[topic] = range(period, period + length)


class Oracle:
    """What the messages say, read one by one."""

    def __init__(self, script: Script) -> None:
        self.messages: dict[str, dict[int, object]] = {}
        with AnyReader([script.path]) as reader:
            for connection, _, data in reader.messages():
                message = reader.deserialize(data, connection.msgtype)
                topic = self.messages.setdefault(connection.topic.strip("/"), {})
                topic[message.period] = message  # of a drive that began anew, the second run
        self.feedback = self.messages["phase_feedback"]
        self.command = self.messages["duty_command"]
        self.lut = self.messages["lut_diagnostics"]
        self.state = self.messages["drive_state"]
        self.chosen = script.chosen
        self.state_every = script.state_every
        self.window = range(FIRST, END)

    def chosen_in(self, period: int) -> str:
        return [name for at, name in self.chosen if at <= period][-1]

    def off(self, period: int) -> bool:
        if period in self.state:
            return not self.state[period].gates_on
        enabled = [self.command[k].enable for k in range(period, 0, -1) if k in self.command][:1]
        return enabled == [False] or self.feedback[period].derating == 0.0

    @property
    def offs(self) -> list[int]:
        return [k for k in sorted(self.feedback) if self.off(k)]

    @property
    def label(self) -> str:
        told = [k for k in sorted(self.lut) if k < self.window[0]][-1:]
        # a scheme controls until the messages say that another one does
        told += [k for k in sorted(self.lut) if k in self.window]
        pairs = [(self.chosen_in(k), self.lut[k].scheme) for k in told]
        if self.window[0] in self.lut:
            del pairs[0]
        names: list[str] = []
        for chosen, scheme in (pair for pair, _ in itertools.groupby(pairs)):
            for name in (chosen, scheme):
                if not names or names[-1] != name:
                    names.append(name)
        return " -> ".join(names)

    @property
    def fell_back(self) -> bool:
        return any(m.scheme != self.chosen_in(k) for k, m in self.lut.items())

    def missing(self, topic: str) -> bool:
        every = self.state_every if topic == "drive_state" else 1
        there = self.messages[topic]
        return any(k % every == 0 and k not in there for k in self.window)


def read_back(seed: int, tmp_path: Path):
    script = Script(seed, tmp_path / "bag")
    oracle = Oracle(script)
    return script, oracle, metrics.evaluate(recording.read(script.path))


@pytest.mark.parametrize("seed", range(DRAWS))
def test_a_row_agrees_with_the_messages(seed: int, tmp_path: Path) -> None:
    script, oracle, row = read_back(seed, tmp_path)
    said = "; ".join(note["text"] for note in row["notes"])
    offs, window = oracle.offs, set(oracle.window)
    off_inside = bool(window & set(offs))
    gaps = {t for t in oracle.messages if oracle.missing(t)}

    # The label is what controlled.
    assert row["scheme"] == oracle.label, (script.events, said)

    # The notes say what happened, and when.
    assert ("gates off from" in said) == bool(offs), said
    if offs:
        assert f"gates off from {offs[0] * T_S:.3f} s" in said
    assert ("took over" in said) == oracle.fell_back, said
    for topic in oracle.messages:
        assert (f"are missing in {topic}" in said or f"is missing in {topic}" in said) == (
            topic in gaps
        ), said
    if any(name == "restart" for _, name in script.events):
        assert "the period number goes back" in said

    if offs:  # of what came with it, or after it, nothing went on
        assert "went on" not in said

    # The exit code is that of the truth.
    failed = off_inside or oracle.fell_back or bool(gaps) or bool(script.faults)
    assert notes.exit_code([row]) == (notes.NOT_AS_ASKED if failed else 0), said

    # No figure of what was not so.
    schemes = {m.scheme for k, m in oracle.lut.items() if k in window}
    currents = [*row["ripple_pp"].values(), *row["thd_percent"].values()]
    lut = [*row["lut_error_max"].values(), *row["lut_error_rms"].values()]
    if off_inside or "phase_feedback" in gaps or len(schemes) > 1:
        assert set(currents) == {None} and not row["steady"], said
        assert row["scatter"]["parts"] == 0
    if off_inside or "lut_diagnostics" in gaps or "phase_feedback" in gaps or len(schemes) > 1:
        assert set(lut) == {None}
    if off_inside:
        assert row["copper_loss_w"] is None and row["i_d_mean"] is None
    if offs or oracle.fell_back or len({m.scheme for m in oracle.lut.values()}) > 1:
        assert row["step_time_us"] == {"median": None, "p99": None}

    # What is given is true.
    if "drive_state" not in gaps:
        speeds = [m.speed for k, m in oracle.state.items() if k in window]
        assert row["speed_rpm_mean"] == pytest.approx(np.mean(speeds) * 30 / math.pi)
    if "duty_command" in gaps:
        assert row["switching_frequency_hz"] is None
    elif "phase_feedback" not in gaps:
        cycles = [
            sum(0.0 < duty < 1.0 for duty in oracle.command[k].duty)
            for k in oracle.window
            if not oracle.off(k)
        ]
        inside = sum(cycles) / (3 * (END - FIRST) * T_S)
        # besides the pulses inside of periods, edges between two of them
        assert inside <= row["switching_frequency_hz"] <= inside + 0.5 / T_S
        if all(oracle.off(k) for k in oracle.window):
            assert row["switching_frequency_hz"] == 0.0
    quiet = not any(FIRST - 150 <= at < END for at, _ in script.events)
    if quiet and not off_inside and not gaps and script.scheme != "mfpcc":
        assert row["steady"] and None not in (row["thd_percent"]["control"], *lut), said
        i_d = [m.i_dq[0] for k, m in oracle.lut.items() if k in window]
        assert row["ripple_pp"]["d"] == pytest.approx(max(i_d) - min(i_d))


def test_the_draw_has_every_event_before_within_and_after_the_window() -> None:
    drawn = [event for seed in range(DRAWS) for event in draw(seed)]
    seen = {(name, (at >= FIRST) + (at >= END)) for at, name in drawn}
    assert seen >= {(name, when) for name in EVENTS for when in range(3)}
