"""
What a window is fit for: whether it is steady, complete, of one scheme, and of a driven motor.

THD and ripple are figures of a steady state. A window in which speed, load or current change, or
that is too short to tell, has none; nor has one with the gates off, with several schemes in
control, or with samples missing. Whatever is missing, a note says why.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.bags.topics import EVERY_PERIOD
from mfpcc_experiments.measuring.waveform import (
    PARTS_AT_STANDSTILL,
    STANDSTILL,
    Array,
    is_plausible,
    period_means,
    rms,
    turns,
    unwrap,
)
from mfpcc_experiments.measuring.window import Window, speeds, window_rows
from mfpcc_experiments.notes import Note, failure, info
from pwm_node.units import RPM

if TYPE_CHECKING:
    from mfpcc_experiments.bags import Recording
    from mfpcc_experiments.measuring.happened import History

#: Electrical periods that a window must hold: what is steady can be told by comparison only, of one
#: period with another that begins later.
FEWEST_PERIODS = 1.5

#: Deviation of the mean current over one electrical period, over its size, and of the speed, from
#: which on a window holds a transient. The largest seen in a steady state are 0.045 and 0.003
#: (one vector per period, 18 % THD).
TRANSIENT = 0.05

#: Shares of the rms content, which THD and ripple count, that a steady trend may be, and all slow
#: movement together. What passes adds less than 5 % to a THD.
TREND, MOVEMENT = 0.1, 0.2

#: Below this share of the current a change is never slow content: it does not count beside a
#: distortion of 1 %.
NO_CHANGE = 0.001

#: A mean over n samples of white noise moves by 1 / sqrt(n) of it. The noise of a controlled
#: current is not white: the largest movement, trend of a window and excursion of one mean seen in
#: steady states of all schemes are 3.4, 6.1 and 4.5 times that.
MOVEMENT_BY_CHANCE, TREND_BY_CHANCE, EXCURSION_BY_CHANCE = 3.5, 7.0, 5.0

#: Means over so many parts of a window show how it moves.
SLOW_PARTS = 10

#: What is small for a motor: so much of its largest current, speed or torque.
SMALL = 0.01

#: The fewest samples of a part of a window at standstill.
FEWEST_SAMPLES = 20


def can_be_judged(theta: Array) -> bool:
    """
    Whether a window is long enough to tell if it is steady.

    Parameters
    ----------
    theta : ndarray, shape (n,)
        Electrical angle, unwrapped (rad).
    """
    n, turned = len(theta), float(turns(theta)[-1])
    if turned < STANDSTILL:
        return n >= PARTS_AT_STANDSTILL * FEWEST_SAMPLES
    return turned * (1.0 + 1.5 / (n - 1)) >= FEWEST_PERIODS


def is_steady(
    i_dq: NDArray[np.complex128],
    theta: Array,
    *,
    i_max: float = 0.0,
    waveform: NDArray[np.complex128] | None = None,
) -> bool:
    """
    Whether the current stands still over a window; THD and ripple are defined only then.

    Its mean over one electrical period must not leave its place as in a transient; and over the
    window it may move by so little that this is no part of what THD and ripple count: neither as a
    trend, nor in any other slow way. Means over whole electrical periods, of a tenth of the window
    or one, tell that.

    Parameters
    ----------
    i_dq : ndarray, shape (n,), complex
        Current in the rotor frame (A).
    theta : ndarray, shape (n,)
        Electrical angle, unwrapped (rad).
    i_max : float
        Largest current of the motor (A), if known: a hundredth of it is no current.
    waveform : ndarray, complex, optional
        The oversampled current (A), whose content counts then.
    """
    means = period_means(i_dq, theta)
    if not len(means):
        return False
    size = max(abs(complex(np.mean(means))), SMALL * i_max)
    turned = float(turns(theta)[-1])
    each = max(1, int(turned) // SLOW_PARTS)
    slow = period_means(i_dq, theta, each)
    slow = slow - np.mean(slow)
    line = np.linspace(-1.0, 1.0, len(slow))
    trend = abs(complex(line @ slow)) / max(math.sqrt(float(line @ line) * len(slow)), 1.0)
    whole = i_dq if waveform is None else waveform
    content, noise = (rms(np.abs(i - np.mean(i))) for i in (whole, i_dq))
    samples = len(i_dq) / (turned if turned >= STANDSTILL else PARTS_AT_STANDSTILL)
    least = NO_CHANGE * size
    far, slope, moved = (
        factor * noise / math.sqrt(n)
        for factor, n in (
            (EXCURSION_BY_CHANCE, samples),
            (TREND_BY_CHANCE, len(i_dq)),
            (MOVEMENT_BY_CHANCE, samples * each),
        )
    )
    return bool(
        np.max(np.abs(means - np.mean(means))) <= max(TRANSIENT * size, far)
        and trend <= max(least, TREND * content, slope)
        and rms(np.abs(slow)) <= max(least, MOVEMENT * content, moved)
    )


class Need(Enum):
    """What a window, or its run, must offer for a figure; as the reference page prints it."""

    STEADY = "a steady state"
    DRIVEN = "gates on"
    ONE_SCHEME = "one scheme in control"
    THROUGHOUT = "one scheme in the whole run, gates on"
    SPEED = "`drive_state` or `phase_feedback`"
    FEEDBACK = "no gap in `phase_feedback`"
    COMMAND = "no gap in `duty_command`"
    DIAGNOSTICS = "no gap in `lut_diagnostics`"
    STATE = "no gap in `drive_state`"


class Fitness:
    """
    What a window is fit for.

    Parameters
    ----------
    recording : Recording
        What was recorded.
    w : Window
        Its window.
    past : History
        What happened in it.
    first, end : int
        Periods of the window, from and to (not included).

    Attributes
    ----------
    steady : bool or None
        None where it cannot be judged.
    lacks : set of Need
        What it does not offer: a figure that needs one of them is not to be given.
    notes : list of Note
        What keeps figures from being given.
    """

    def __init__(
        self, recording: Recording, w: Window, past: History, first: int, end: int
    ) -> None:
        self.notes: list[Note] = []
        self.lacks: set[Need] = set()
        self._past, self._first, self._end = past, first, end
        self._off = past.is_off_in(first, end)
        schemes = {(reign.scheme, reign.chosen) for reign in past.reigns_in(first, end)}
        self._mixed = len(schemes) > 1
        if self._off:
            self.lacks.add(Need.DRIVEN)
        if self._mixed:
            self.lacks.add(Need.ONE_SCHEME)
        for need, note in missing(recording, first, end):
            self.lacks.add(need)
            if note not in self.notes:
                self.notes.append(note)
        if Need.FEEDBACK in self.lacks and not len(recording.state):
            self.lacks.add(Need.SPEED)
        self.steady = self._judge_steady(recording, w)
        if not self.steady:
            self.lacks.add(Need.STEADY)
        self._judge_topics(recording, w)
        self._judge_step_time(recording)

    def _judge_steady(self, recording: Recording, w: Window) -> bool | None:
        """Whether the window holds a steady state; tells why not."""
        if self._off:
            self.notes.append(info("no figures that need a driven motor: the gates were off"))
            return False
        if Need.FEEDBACK in self.lacks:
            return None
        why = _transients(recording, w, self._past, self._first, self._end)
        if self._mixed:
            why.insert(0, "several schemes controlled")
        if not why and not can_be_judged(w.theta):
            turned = float(turns(w.theta)[-1])
            self.notes.append(
                info(
                    f"whether it is steady cannot be judged: the window holds {turned:.1f} "
                    f"electrical periods, and at least {FEWEST_PERIODS} are needed; no THD and no "
                    "ripple"
                )
            )
            return None
        if why:
            also = ", and no prediction error of either scheme" if self._mixed else ""
            self.notes.append(
                info(
                    f"not steady ({'; '.join(why)}): no THD and no ripple{also}, but the "
                    "deviation from the reference"
                )
            )
        return not why

    def _judge_topics(self, recording: Recording, w: Window) -> None:
        """Say what was not recorded."""
        if not len(recording.lut):
            text = "no lut_diagnostics in the recording: no prediction error, no deviation"
            self.notes.append(info(text))
        if not len(recording.state):
            text = "no drive_state in the recording: no torque, and the speed is the encoder's"
            self.notes.append(info(text))
        elif w.fine_abc is None and self.steady:
            text = "no oversampled waveform in the recording: THD and ripple of the samples only"
            self.notes.append(info(text))

    def _judge_step_time(self, recording: Recording) -> None:
        """The computing time is of the whole run: it is a scheme's if that controlled in all."""
        schemes = {(reign.scheme, reign.chosen) for reign in self._past.reigns}
        if recording.summary.get("step_time_us") and (len(schemes) > 1 or self._past.offs):
            self.lacks.add(Need.THROUGHOUT)
            self.notes.append(
                info("no computing time: one scheme did not control throughout, with the gates on")
            )


def missing(recording: Recording, first: int, end: int) -> list[tuple[Need, Note]]:
    """
    Which topics lack messages of some periods, and what that is called.

    Parameters
    ----------
    recording : Recording
        What was recorded.
    first, end : int
        Periods, from and to (not included).
    """
    expected = (
        ("phase_feedback", recording.feedback, first, Need.FEEDBACK),
        # there is none for period 0
        ("duty_command", recording.command, max(first, 1), Need.COMMAND),
        ("lut_diagnostics", recording.lut, first, Need.DIAGNOSTICS),
        ("drive_state", recording.state, first, Need.STATE),
    )
    found = []
    for topic, rows, begin, need in expected:
        usual = 1 if topic in EVERY_PERIOD else None
        count = _missing(rows["period"], begin, end, usual) if len(rows) else 0
        if count:
            text = (
                f"{count} of the {end - begin} periods of the window "
                f"{'are' if count > 1 else 'is'} missing in {topic}: no figure that needs them"
            )
            found.append((need, failure(text)))
    return found + _unusable(recording, first, end)


# What figures are computed from, and what these need then.
_USED = (
    ("phase_feedback", ("i_a", "i_b", "i_c"), (Need.FEEDBACK,)),
    ("duty_command", ("duty",), (Need.COMMAND,)),
    ("lut_diagnostics", ("i_dq", "i_dq_ref"), (Need.DIAGNOSTICS, Need.FEEDBACK)),
    ("lut_diagnostics", ("prediction_error",), (Need.DIAGNOSTICS,)),
    ("drive_state", ("angle",), (Need.STATE, Need.FEEDBACK)),
    ("drive_state", ("speed",), (Need.STATE, Need.SPEED)),
    ("drive_state", ("torque", "temperature"), (Need.STATE,)),
)
_OF_ENCODER = ("phase_feedback", ("encoder_angle",), (Need.FEEDBACK, Need.SPEED))


def _unusable(recording: Recording, first: int, end: int) -> list[tuple[Need, Note]]:
    """Which messages hold values that are no measurement."""
    rows = {
        "phase_feedback": recording.feedback,
        "duty_command": recording.command,
        "lut_diagnostics": recording.lut,
        "drive_state": recording.state,
    }
    inside = {
        topic: slice(*np.searchsorted(all_["period"], np.array([first, end], dtype=np.uint64)))
        for topic, all_ in rows.items()
    }
    values = [
        (topic, name, needs, rows[topic][name][inside[topic]])
        # the angle is the encoder's where the true one was not recorded with each sample
        for topic, names, needs in (
            *_USED,
            *([_OF_ENCODER] if len(recording.state) < len(recording.feedback) else []),
        )
        for name in names
    ]
    if recording.i_abc_oversampled is not None:
        waveform = recording.i_abc_oversampled[inside["drive_state"]]
        values.append(("drive_state", "i_abc_oversampled", (Need.STATE, Need.FEEDBACK), waveform))
    found = []
    for topic, name, needs, recorded in values:
        if name == "prediction_error" and np.isnan(recorded).all():
            continue  # not known to whoever wrote it: there is none
        count = int(np.count_nonzero(~is_plausible(recorded)))
        if count:
            text = (
                f"{name} of {topic} is no number that a drive can have in {count} of the "
                f"{end - first} periods of the window: no figure that needs it"
            )
            found += [(need, failure(text)) for need in needs]
    return found


def _missing(period: NDArray[np.uint64], first: int, end: int, usual: int | None) -> int:
    """Periods from `first` to before `end` that a topic has no rows for.

    Periods from one row to the `usual` next are known, or told from the rows.
    """
    if usual is None:
        step = np.diff(period.astype(np.int64))
        usual = int(np.median(step)) if len(step) else 1
    begin, stop = np.searchsorted(period, np.array([first, end], dtype=np.uint64))
    inside = period[begin:stop].astype(np.int64)
    if not len(inside):
        return (end - first) // usual * usual if end - first >= usual else 0
    gaps = np.diff(inside)
    count = int(np.sum(gaps[gaps > usual] // usual - 1))
    count += max(0, int(inside[0]) - first) // usual
    count += max(0, end - 1 - int(inside[-1])) // usual
    return count * usual


def _transients(recording: Recording, w: Window, past: History, first: int, end: int) -> list[str]:
    """What changes within a window, in words; nothing in a steady state."""
    T_s, n_p = recording.T_s, recording.n_p or 1
    motor = recording.config.get("motor_file")
    motor = motor if isinstance(motor, dict) else {}
    i_max = float(motor.get("i_max", 0.0))
    w_max = float(motor.get("speed_max_rpm", 0.0)) * RPM
    tau_max = 1.5 * n_p * float(motor.get("psi_f", 0.0)) * i_max
    why = [
        f"{change.name} set to {_shown(change.value)} at {change.period * T_s:.3f} s"
        for change in past.changes
        if first < change.period < end and change.name != "scheme"
    ][:3]
    lut = recording.lut[window_rows(recording.lut["period"], (w.begin, w.end), T_s)]
    if len(lut) and not why:
        why += _reference_changes(lut)
    state = recording.state[window_rows(recording.state["period"], (w.begin, w.end), T_s)]
    if len(state) >= 8 and not why:
        load = state["load_torque"]
        small = SMALL * max(float(np.mean(np.abs(load))), tau_max)
        means = period_means(load, n_p * unwrap(state["angle"]))
        if np.max(np.abs(np.diff(load))) > small or (len(means) and np.ptp(means) > 2 * small):
            why.append(f"the load changes between {load.min():.3g} and {load.max():.3g} N m")
    speed = speeds(recording, w)
    means = period_means(speed, w.theta) / RPM
    if len(means) and not why:
        small = TRANSIENT * max(float(np.mean(np.abs(means))), SMALL * w_max / RPM, 1e-3)
        if np.ptp(means) > small:
            low, high = sorted((float(means[0]), float(means[-1])))
            if high - low <= small:
                low, high = float(means.min()), float(means.max())
            why.append(f"the speed changes between {low:.0f} and {high:.0f} r/min")
    judged = can_be_judged(w.theta)
    if judged and not why and not is_steady(w.i_dq, w.theta, i_max=i_max, waveform=w.fine_dq):
        size = np.abs(period_means(w.i_dq, w.theta))
        why.append(f"the current changes between {size.min():.3g} and {size.max():.3g} A")
    return why


def _reference_changes(lut: NDArray[Any]) -> list[str]:
    """What is asked for from outside, and changes: a speed, or in current control a current."""
    speed_ref = lut["speed_ref"]
    in_speed = np.isfinite(speed_ref)
    if in_speed.any() and not in_speed.all():
        return ["the control mode changes"]
    if in_speed.all():
        if np.ptp(speed_ref) == 0.0:
            return []
        low, high = (v / RPM for v in (speed_ref.min(), speed_ref.max()))
        return [f"the speed reference changes between {low:.0f} and {high:.0f} r/min"]
    spans = np.ptp(lut["i_dq_ref"], axis=0)
    axis = int(np.argmax(spans))
    if spans[axis] == 0.0:
        return []
    ref = lut["i_dq_ref"][:, axis]
    name = "dq"[axis]
    return [f"the reference of i_{name} changes between {ref.min():.3g} and {ref.max():.3g} A"]


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
