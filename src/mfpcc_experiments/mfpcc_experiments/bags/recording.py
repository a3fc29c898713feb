"""
Reading recordings into arrays.

A recording is read piece by piece (`storage`), and only arrays are kept (`columns`): 600,000
periods with all topics take about 5 s of processor time and 1.3 GiB. Which of the messages belong
together, and in which order, their times and period numbers say (`completeness`), never their place
in a file.

A bag need not be ours: any bag with `phase_feedback` and `duty_command` of these message types can
be measured, e.g. one recorded with ``ros2 bag record`` on a real drive (MCAP or sqlite3).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.bags import status, stored
from mfpcc_experiments.bags.bag_parts import Parts, parts_of
from mfpcc_experiments.bags.columns import column, layout_of
from mfpcc_experiments.bags.completeness import select
from mfpcc_experiments.bags.disk.mcap_file import Topic
from mfpcc_experiments.bags.disk.storage import Batch, Counts, Entry, contents
from mfpcc_experiments.bags.errors import BagError
from mfpcc_experiments.bags.layouts import TAKEN_AS_ON, Layout
from mfpcc_experiments.bags.provenance import CONFIG_RECORD, SUMMARY_RECORD
from mfpcc_experiments.bags.status import Status, StatusError
from mfpcc_experiments.bags.topics import LOOP_TOPICS
from mfpcc_experiments.notes import Note, info, warning
from pwm_node import stamps

Progress = Callable[[float], None]
_NEEDED = ("phase_feedback", "duty_command")
_LONGEST_STEP = 1 << 32  # periods
_PERIOD_TOLERANCE = 0.01  # of the PWM period: what clocks may differ


@dataclass
class Recording:
    """
    One recording as arrays; one row per message.

    Attributes
    ----------
    path : Path
        Where it was read from.
    config : dict
        The run's configuration, empty for a bag of others.
    summary : dict
        What the run left behind at its end.
    feedback, command, lut, state : ndarray, structured
        The fields of fixed size of `PhaseFeedback`, `DutyCommand`, `LutDiagnostics` and
        `DriveState`, with rising period numbers. `lut` and `state` may be empty or decimated.
    scheme : ndarray of str, shape (len(lut),)
        Who controlled the current.
    i_abc_oversampled : ndarray, shape (len(state), oversampling, 3), or None
        True phase currents within each period (A).
    legs_oversampled : ndarray of uint8, shape (len(state), oversampling), or None
        Leg states at the same instants.
    T_s : float
        PWM period (s).
    n_p : int or None
        Pole pairs, None where neither stored nor to be told from the topics.
    lost_periods : int
        Periods of which a message is missing.
    statuses : list of Status
        What the nodes said of themselves, where ``drive_status`` was recorded.
    notes : list of Note
        What is not as it should be with the file.
    """

    path: Path
    config: dict[str, Any]
    summary: dict[str, Any]
    feedback: NDArray[Any]
    command: NDArray[Any]
    lut: NDArray[Any]
    state: NDArray[Any]
    scheme: NDArray[np.str_]
    i_abc_oversampled: NDArray[np.float64] | None
    legs_oversampled: NDArray[np.uint8] | None
    T_s: float = 0.0
    n_p: int | None = None
    lost_periods: int = 0
    statuses: list[Status] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)

    @property
    def oversampling(self) -> int:
        """Points per period of the oversampled waveforms, 0 without them."""
        return 0 if self.i_abc_oversampled is None else self.i_abc_oversampled.shape[1]

    @property
    def window_s(self) -> tuple[float, float] | None:
        """Evaluation window stored with the run (s)."""
        window = self.config.get("window_s")
        return None if window is None else (float(window[0]), float(window[1]))


def read(
    path: Path, *, namespace: str | None = None, progress: Progress | None = None
) -> Recording:
    """
    Read a recording.

    Parameters
    ----------
    path : Path
        Folder of a bag, or one of its files.
    namespace : str, optional
        Which axis, where a bag holds several (``/axis1``).
    progress : callable, optional
        Told the share that is done, 0 to 1.

    Returns
    -------
    Recording
        Its `notes` say what is missing or odd.

    Raises
    ------
    BagError
        If it cannot be used; the text says why and what to do.
    """
    path = Path(path)
    parts = parts_of(path)
    collector = _Collector(path, namespace, parts)
    sizes = [file.stat().st_size for file in parts.files]
    total, done = sum(sizes) or 1, 0
    for file, size in zip(parts.files, sizes, strict=True):

        def tell(share: float, done: int = done, size: int = size) -> None:
            if progress is not None:
                progress((done + share * size) / total)

        for content in contents(file, collector.is_wanted, tell):
            collector.take(content, file)
        done += size
    recording = collector.recording()
    if progress is not None:
        progress(1.0)
    return recording


class _Collector:
    """Gathers the messages of the loop's topics, and makes a `Recording` of them."""

    def __init__(self, path: Path, namespace: str | None, parts: Parts) -> None:
        self.path = path
        self.config: dict[str, Any] = {}
        self.summary: dict[str, Any] = {}
        self._parts = parts
        self._notes = list(parts.notes)
        self._counts: dict[str, int] = {}
        self._namespace = None if namespace is None else "/" + namespace.strip("/")
        self._namespaces: set[str] = set()
        self._others: set[str] = set()
        self._layouts: dict[Topic, Layout | None] = {}
        self._statuses: list[Status] = []
        self._columns = {name: column(name, path) for name in LOOP_TOPICS}

    def is_wanted(self, topic: Topic) -> bool:
        """Whether these messages are: those of the loop, of one axis."""
        if topic not in self._layouts:
            self._layouts[topic] = self._judge(topic)
        return self._layouts[topic] is not None or self._is_status(topic)

    def _is_status(self, topic: Topic) -> bool:
        namespace, _, name = topic.name.rpartition("/")
        return (name, topic.type_name, topic.encoding) == (
            status.TOPIC,
            status.TYPE,
            "cdr",
        ) and self._namespace in (None, namespace or "/")

    def _judge(self, topic: Topic) -> Layout | None:
        namespace, _, name = topic.name.rpartition("/")
        if name not in LOOP_TOPICS:
            self._others.add(topic.name)
            return None
        self._namespaces.add(namespace or "/")
        if self._namespace not in (None, namespace or "/"):
            return None
        found = layout_of(topic, LOOP_TOPICS[name], self.path)
        on = tuple(name for name in found.missing if name in TAKEN_AS_ON)
        for fields, text in (
            (found.missing, "was recorded before it had {}; these take their defaults"),
            (
                on,
                "does not say {}, which is taken as on: whether the motor was driven is not known",
            ),
            (found.unknown, "was recorded with {}, unknown to this version and left out"),
        ):
            if fields:
                names = ", ".join(fields)
                self._notes.append(warning(f"topic {topic.name} {text.format(names)}"))
        return found

    def take(self, content: Batch | Entry | Counts, file: Path) -> None:
        """Take what `contents` found."""
        match content:
            case Batch(topic, messages, log_time) if self._layouts[topic] is None:
                for data, at in zip(messages, log_time.tolist(), strict=True):
                    try:
                        self._statuses.append(status.parse(data, at))
                    except StatusError as error:
                        text = f"a message of topic {topic.name} cannot be read: {error}"
                        self._notes.append(warning(text))
            case Batch(topic, messages, log_time):
                layout = self._layouts[topic]
                assert layout is not None
                name = topic.name.rpartition("/")[2]
                self._columns[name].add(layout, messages, log_time)
            case Entry(name, value) if name == CONFIG_RECORD and isinstance(value, dict):
                if self.config and value != self.config:
                    raise BagError(
                        f"{self.path}: {file.name} holds another configuration than the part "
                        "before it: these are parts of different recordings"
                    )
                self.config = value
            case Entry(name, value) if name == SUMMARY_RECORD and isinstance(value, dict):
                self.summary = value
            case Counts(found, stated):
                for name, count in found.items():
                    self._counts[name] = self._counts.get(name, 0) + count
                if stated is not None and stated != sum(found.values()):
                    text = (
                        f"{file.name} holds {sum(found.values())} messages, not the {stated} that"
                    )
                    self._notes.append(warning(f"{text} its own summary tells of"))

    def recording(self) -> Recording:
        if self._namespace is None and len(self._namespaces) > 1:
            names = ", ".join(sorted(self._namespaces))
            raise BagError(
                f"{self.path}: holds several axes: {names}; choose one with --namespace, such as "
                f"--namespace {min(self._namespaces)}"
            )
        self._check_there()
        self._check_counts()
        self.config, notes = stored.configuration(self.config)
        self.summary, more = stored.summary(self.summary)
        self._notes += [*notes, *more]
        if not self.config:
            self._notes.append(self._unconfigured())
        decimation = _decimation(self.config, self.summary)
        self._notes += [
            warning(f"topic {name} has no messages, though its run was configured to record it")
            for name, step in decimation.items()
            if step <= self._columns["phase_feedback"].count and not self._columns[name].count
        ]
        chosen = select(
            self._columns, self.path, decimation=decimation, joined_late=not self.config
        )
        if chosen.lost_periods or chosen.period["phase_feedback"][0] > 0:
            self._notes += self._parts.numbering
        rows = {name: column.take(chosen.rows[name]) for name, column in self._columns.items()}
        lut, scheme = rows["lut_diagnostics"]
        state, waves = rows["drive_state"]
        recording = Recording(
            path=self.path,
            config=self.config,
            summary=self.summary,
            feedback=rows["phase_feedback"][0],
            command=rows["duty_command"][0],
            lut=lut,
            state=state,
            scheme=scheme,
            i_abc_oversampled=None if waves is None else waves[0],
            legs_oversampled=None if waves is None else waves[1],
            lost_periods=chosen.lost_periods,
            statuses=[
                said
                for said in sorted(self._statuses, key=lambda said: said.log_time)
                if chosen.span is None or chosen.span[0] < said.log_time < chosen.span[1]
            ],
            notes=[*self._notes, *chosen.notes],
        )
        if recording.statuses:
            recording.summary.setdefault("faults", status.latched(recording.statuses))
        _complete(recording)
        return recording

    def _check_there(self) -> None:
        """Refuse a recording that lacks what every figure needs."""
        if self._namespace is not None and self._namespace not in self._namespaces:
            names = ", ".join(sorted(self._namespaces)) or "none"
            raise BagError(f"{self.path}: has no axis {self._namespace}; there are: {names}")
        missing = [name for name in _NEEDED if not self._columns[name].count]
        if missing:
            others = sorted(self._others)[:8]
            there = f"; there are: {', '.join(others)}" if others else "; it holds no messages"
            raise BagError(
                f"{self.path}: no messages of topic {' and '.join(missing)}"
                + (there if not any(c.count for c in self._columns.values()) else "")
            )

    def _unconfigured(self) -> Note:
        text = "no configuration of a run is stored in it; without a window all of it is evaluated"
        if "experiment" in self._parts.custom_data:
            run = stored.shown(self._parts.custom_data["experiment"])
            return warning(
                f"{text}, though it was a run of {run}; a copy in another format lost it"
            )
        return info(text)

    def _check_counts(self) -> None:
        """Hold what was found against what ``metadata.yaml`` tells of."""
        stated = self._parts.message_counts
        if stated is None:
            return
        for name in sorted({*stated, *self._counts}):
            count, there = stated.get(name, 0), self._counts.get(name, 0)
            if count != there:
                self._notes.append(
                    warning(
                        f"topic {name} has {there} messages, not the {count} that metadata.yaml "
                        "tells of"
                    )
                )


def _decimation(config: Mapping[str, Any], summary: Mapping[str, Any]) -> dict[str, int]:
    """Periods from one message to the next of the topics where the configuration says so."""
    found: dict[str, int] = {}
    for topic, node, name in (
        ("lut_diagnostics", "mfpcc_controller", "diagnostics_decimation"),
        ("drive_state", "pmsm_sim", "state_decimation"),
    ):
        with suppress(KeyError, TypeError):
            values = config["parameters"][node]
            step = values[name]
            changes = json.dumps([values.get("schedule"), summary.get("parameter_changes")])
            # Of one that was changed on the way the messages tell.
            if isinstance(step, int) and 0 < step <= _LONGEST_STEP and name not in changes:
                found[topic] = step
    return found


def _complete(recording: Recording) -> None:
    """Fill in the period and the pole pairs: stored, or else told from the topics."""
    config, feedback = recording.config, recording.feedback
    recording.T_s = float(config.get("T_s", 0.0))
    by_stamps = _period_of_stamps(feedback, recording.notes)
    if not recording.T_s:
        recording.T_s = by_stamps or 0.0
    elif (
        by_stamps is not None and abs(by_stamps - recording.T_s) > _PERIOD_TOLERANCE * recording.T_s
    ):
        recording.notes.append(
            warning(
                f"the configuration says a PWM period of {recording.T_s * 1e6:g} us, and the time "
                f"stamps say {by_stamps * 1e6:g} us; all times and frequencies are by the "
                "configuration"
            )
        )
    if not 0.0 < recording.T_s < 1.0:
        raise BagError(f"{recording.path}: the PWM period cannot be told from the time stamps")
    recording.n_p = config.get("n_p") or _pole_pairs(recording)


def _period_of_stamps(feedback: NDArray[Any], notes: list[Note]) -> float | None:
    """PWM period by the time stamps (s), None where they do not tell."""
    time, period = stamps.nanoseconds(feedback["stamp"]), feedback["period"].astype(np.int64)
    try:
        mean = 1.0 / stamps.frequency(int(time[0]), int(time[-1]), int(period[-1] - period[0]))
    except ValueError:
        return None
    # A single stamp that is wrong, at the begin or the end, must not make all times wrong.
    # Over half of the recording, so that a coarse clock does not matter.
    half = len(time) // 2
    usual = 1e-9 * float(np.median((time[half:] - time[:-half]) / (period[half:] - period[:-half])))
    if abs(mean - usual) <= _PERIOD_TOLERANCE * usual:
        return mean
    notes.append(
        warning(
            f"the time stamps of phase_feedback are uneven: {usual * 1e6:g} us per period as "
            f"a rule, {mean * 1e6:g} us from the first to the last"
        )
    )
    return usual


def _pole_pairs(recording: Recording) -> int | None:
    """Electrical speed, as the controller estimates it, over the encoder's mechanical speed."""
    feedback, lut = recording.feedback, recording.lut
    if len(feedback) < 10 or len(lut) < 10:
        return None
    seconds = float(int(feedback["period"][-1]) - int(feedback["period"][0])) * recording.T_s
    angle = np.unwrap(feedback["encoder_angle"])
    w_M = float(angle[-1] - angle[0]) / seconds
    ratio = float(np.mean(lut["w_m"])) / w_M if abs(w_M) > 1.0 else 0.0
    n_p = round(ratio) if np.isfinite(ratio) else 0
    return n_p if 1 <= n_p <= 200 and abs(ratio - n_p) < 0.2 else None
