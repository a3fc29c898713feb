"""Recorded samples fed to a scheme again: off the graph, open loop.

What a scheme would have predicted and commanded stands beside what was recorded, sample by sample.
There are two ways of feeding, for two questions:

*As recorded* (`verify`): nothing but the samples and the recorded parameters. A controller is a
function of those alone, so the recording's own scheme gives its own commands again, bit for bit;
where it does not, scheme, parameters or software are others than they were. Every recording
thereby is a regression test.

*Told what acted* (`replay`): in open loop a scheme's commands are not what the inverter did. So
before each sample its memory is told the command that was recorded for the period that ended, as
if that had been its own choice. What it predicts then is about the output that really acted, and
the prediction errors of all schemes are comparable: the same samples, the same voltages. Its own
choice stands beside the recorded one, and is forgotten. Ripple and THD cannot be told from an open
loop; nor can the choices of a scheme that integrates (`pi_foc`), which drift.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mfpcc_msgs.msg import DutyCommand, LutDiagnostics
from numpy.typing import NDArray

from mfpcc_controller.controller import Controller, answer
from mfpcc_controller.parameters import TABLE
from mfpcc_controller.vectors import LEGS, set_output
from mfpcc_experiments.bags import Recording
from mfpcc_experiments.measuring import happened
from mfpcc_experiments.measuring.happened import rows_of
from pwm_node import schedule
from pwm_node.compiled import kernel
from pwm_node.errors import ForPeople
from pwm_node.parameters import ParameterError
from pwm_node.wire import fixed_dtype

Progress = Callable[[float], None]

# Samples per call of the compiled loop: bounded memory, and a progress bar that moves.
_CHUNK = 4_000

# Duties that differ by less than this are the same to any inverter (a 32-bit timer at 10 kHz).
_SAME_DUTY = 1e-9

# In open loop a scheme may predict as badly as it likes, and be asked all the same: neither shall
# the controller's protection switch the gates off, nor another scheme take over.
_UNPROTECTED = {
    "fault.react": False,
    "fault.prediction_error": TABLE["fault.prediction_error"].maximum,
}

_COMMAND_FIELDS = ("duty", "vectors", "dwell", "enable")


class ReplayError(ForPeople):
    """A recording that cannot be replayed, or is not reproduced; the text says why."""


@dataclass(frozen=True)
class Replay:
    """
    What a scheme made of recorded samples; one row per sample.

    Attributes
    ----------
    scheme : str
        Who was asked.
    error : ndarray, shape (n, 2)
        Measured minus predicted current, d and q (A); 0 where nothing was predicted.
    duty : ndarray, shape (n, 3)
        Leg duties it commanded for the period after the sample (0..1).
    differs : ndarray of bool, shape (n,)
        Whether its command is another than the recorded one; False where none was recorded.
    fell_back : bool
        Whether it gave no valid output, and the fallback scheme answered from there on.
    """

    scheme: str
    error: NDArray[np.float64]
    duty: NDArray[np.float64]
    differs: NDArray[np.bool_]
    fell_back: bool = False


# --- The loop ------------------------------------------------------------------------------------


@kernel
def _tell(mem, fb, acted, known):
    """Put what acted in the period of this sample in the place of the scheme's own choice."""
    if not known:
        mem.running = False
        return
    if not mem.running or fb.period != mem.period + np.uint64(1):
        # the recording begins, or samples are missing: of the periods before, nothing is known
        mem.running = True
        mem.period = fb.period - np.uint64(1)
        mem.now.on = False
        mem.pll_samples = 0
    out = mem.next
    a, b = np.int64(acted.vectors[0]), np.int64(acted.vectors[1])
    d_a, d_b = acted.dwell[0], acted.dwell[1]
    if out.a != a or out.b != b or out.d_a != d_a or out.d_b != d_b:
        set_output(out, a, b, d_a, d_b)
    out.on = acted.enable


@kernel
def _prepare(cfg, mem, fb, acted, known, enable, tell):
    """Before a sample: what acted, and whether the gates were to be on."""
    if tell:
        _tell(mem, fb, acted, known)
    cfg.enable = enable


@kernel
def _prepare_one(cfg_, mem_, fb_, acted_, known, enable, tell):
    _prepare(cfg_[0], mem_[0], fb_[0], acted_[0], known, enable, tell)


@kernel
def _open_loop(cfg_, mem_, feedback, acted, known, enable, tell, command, lut):
    """Answer as many samples as the arrays have rows."""
    cfg, mem = cfg_[0], mem_[0]
    for k in range(feedback.shape[0]):
        _prepare(cfg, mem, feedback[k], acted[k], known[k], enable[k], tell)
        answer(cfg, mem, feedback[k], command[k], lut[k], True)


def _open_loop_in_python(
    controller: Controller,
    feedback: NDArray[np.void],
    acted: NDArray[np.void],
    known: NDArray[np.bool_],
    enable: NDArray[np.bool_],
    tell: bool,
    command: NDArray[np.void],
    lut: NDArray[np.void],
) -> None:
    """The same, with a plug-in in Python in the controller."""
    for k in range(len(feedback)):
        row = slice(k, k + 1)
        arrays = controller.cfg, controller.mem, feedback[row], acted[row]
        _prepare_one(*arrays, known[k], enable[k], tell)
        controller.step(feedback[row], command[row], lut[row], True)


class Samples:
    """
    What a replay needs of a recording: samples, commands, parameters, changes of parameters.

    Parameters
    ----------
    recording : Recording
        From `recording.read`.
    changes : mapping, optional
        Values that replace recorded parameters (or stand for them, where none are stored).

    Attributes
    ----------
    values : dict
        Parameters of the controller at the begin.
    feedback : ndarray, structured, shape (n,)
        The samples.
    answered : ndarray of bool, shape (n,)
        Whether the command that answered the sample was recorded.
    duty : ndarray, shape (n, 3)
        Its duties (0..1); nothing of meaning where it was not.
    past : History
        What happened when it was recorded.

    Raises
    ------
    ReplayError
        If the recording lacks what a replay needs.
    ParameterError
        If a parameter has no such value.
    """

    def __init__(self, recording: Recording, changes: Mapping[str, Any] | None = None) -> None:
        self.recording = recording
        self.values = _parameters(recording, changes or {})
        self.feedback = recording.feedback
        self.past = happened.history(recording)
        period = self.feedback["period"]
        # The command for period k acted while sample k was taken; the one for k + 1 answers it.
        self._acted_row, self.known = rows_of(recording.command["period"], period)
        self._answer_row, self.answered = rows_of(recording.command["period"], period + 1)
        self.command = _as_the_duties_say(recording)
        # The gates are switched by the life cycle, of which only the commands tell.
        self.enable = np.where(self.answered, self.command["enable"][self._answer_row], True)
        self.duty: NDArray[np.float64] = recording.command["duty"][self._answer_row]

    @property
    def scheme(self) -> str:
        """Who controlled the current at the begin of the recording."""
        return str(self.values["scheme"])

    @property
    def why_not_verifiable(self) -> str:
        """Why the recorded commands need not come out again; empty if they must."""
        recording, first = self.recording, int(self.feedback["period"][0])
        if "parameters" not in recording.config:
            return "no parameters are stored in the recording"
        if first > 0:
            return (
                f"the recording begins with period {first}: what the controller remembered then "
                "is not known"
            )
        if recording.lost_periods:
            return f"{recording.lost_periods} periods are missing in the recording"
        return ""

    def changes(self, values: Mapping[str, Any]) -> list[tuple[int, schedule.Changes]]:
        """Changes of the controller's parameters by period: those that were recorded.

        A run in process records none, since it has only those of its schedule.
        """
        recorded = self.recording.summary.get("parameter_changes")
        if recorded is None:
            return schedule.parse(values["schedule"], TABLE, 1.0 / values["pwm_frequency"], values)
        changes: dict[int, schedule.Changes] = {}
        for change in recorded:
            if change["node"] == "mfpcc_controller":
                of_period = changes.setdefault(change["period"], {})
                of_period |= TABLE.validate({change["name"]: change["value"]})
        return sorted(changes.items())

    def feed(self, scheme: str | None, *, tell: bool, progress: Progress | None = None) -> Replay:
        """
        Feed all samples to a scheme.

        Parameters
        ----------
        scheme : str or None
            Who shall answer throughout; None: whoever did when it was recorded.
        tell : bool
            Tell its memory before each sample what really acted.
        progress : callable, optional
            Told the share that is done, 0 to 1.
        """
        values = {**self.values, **({} if scheme is None else {"scheme": scheme})}
        if tell:
            values |= _UNPROTECTED
        controller = Controller(TABLE.complete(values))
        due = self.changes(values)
        n = len(self.feedback)
        result = Replay(
            scheme=self.scheme if scheme is None else scheme,
            error=np.zeros((n, 2)),
            duty=np.zeros((n, 3)),
            differs=np.zeros(n, np.bool_),
        )
        begin = 0
        while begin < n:
            while due and due[0][0] <= self.feedback["period"][begin]:
                _, changes = due.pop(0)
                if scheme is not None:
                    changes = {name: v for name, v in changes.items() if name != "scheme"}
                controller.apply(changes)
            end = min(n, begin + _CHUNK)
            if due:
                end = min(end, int(np.searchsorted(self.feedback["period"], due[0][0])))
            self._feed_rows(controller, slice(begin, end), tell, result)
            begin = end
            if progress is not None:
                progress(begin / n)
        return replace(result, fell_back=controller.fallen)

    def _feed_rows(self, controller: Controller, rows: slice, tell: bool, into: Replay) -> None:
        feedback = self.feedback[rows]
        command = np.zeros(len(feedback), fixed_dtype(DutyCommand))
        lut = np.zeros(len(feedback), fixed_dtype(LutDiagnostics))
        arguments = (
            feedback,
            self.command[self._acted_row[rows]],
            self.known[rows],
            self.enable[rows],
            tell,
            command,
            lut,
        )
        if controller.compiled:
            _open_loop(controller.cfg, controller.mem, *arguments)
        else:
            _open_loop_in_python(controller, *arguments)
        into.error[rows] = lut["prediction_error"]
        into.duty[rows] = command["duty"]
        recorded = self.recording.command[self._answer_row[rows]]
        into.differs[rows] = self.answered[rows] & _differ(command, recorded)


def _differ(one: NDArray[np.void], other: NDArray[np.void]) -> NDArray[np.bool_]:
    """Rows of two arrays of commands that are not equal bit for bit."""
    differs = np.zeros(len(one), np.bool_)
    for name in _COMMAND_FIELDS:
        unequal = one[name] != other[name]
        differs |= unequal if unequal.ndim == 1 else unequal.any(axis=1)
    return differs


def _parameters(recording: Recording, changes: Mapping[str, Any]) -> dict[str, Any]:
    """The controller's parameters as they were at the begin, with these changes."""
    stored = recording.config.get("parameters", {}).get("mfpcc_controller")
    if not isinstance(stored, dict):
        if "motor" not in changes:
            raise ReplayError(
                f"{recording.path}: no configuration is stored in it; say at least which motor it "
                "is of, with --set motor=NAME"
            )
        stored = {"pwm_frequency": 1.0 / recording.T_s}
    try:
        TABLE.validate(stored)
    except ParameterError as error:
        raise ReplayError(
            f"{recording.path}: its parameters are not those of this version: {error.reason}"
        ) from None
    return TABLE.complete({**stored, **changes})


@np.errstate(all="ignore")  # recorded garbage equals nothing
def _as_the_duties_say(recording: Recording) -> NDArray[np.void]:
    """
    The recorded commands, with vectors and dwell times that make their duties.

    The duties are what an inverter follows; a controller of others may leave the rest empty.
    """
    command = recording.command
    vectors, dwell, duty = command["vectors"].astype(np.int64), command["dwell"], command["duty"]
    if not (np.isfinite(duty).all() and duty.min() >= 0.0 and duty.max() <= 1.0):
        raise ReplayError(f"{recording.path}: it holds duties that are not within 0..1")
    known: NDArray[np.bool_] = np.all(vectors <= 6, axis=1)
    legs = LEGS[np.where(known[:, None], vectors, 0)]
    made = (legs * dwell[:, :, None]).sum(axis=1) + 0.5 * (1.0 - dwell.sum(axis=1))[:, None]
    odd = ~(known & (np.abs(made - duty) <= _SAME_DUTY).all(axis=1))
    if not odd.any():
        return command
    command = command.copy()
    # The longest leg alone makes one active vector, all but the shortest the other one.
    order = np.argsort(duty[odd], axis=1)
    low, middle, high = np.take_along_axis(duty[odd], order, axis=1).T
    single = 1 + 2 * order[:, 2]
    double = (2 * order[:, 0] + 3) % 6 + 1
    first = single % 6 + 1 == double  # of two neighbours the one that comes first
    command["vectors"][odd] = np.where(
        first[:, None], np.stack([single, double], axis=1), np.stack([double, single], axis=1)
    )
    alone, together = high - middle, middle - low
    command["dwell"][odd] = np.where(
        first[:, None], np.stack([alone, together], axis=1), np.stack([together, alone], axis=1)
    )
    return command


# --- Questions -----------------------------------------------------------------------------------


def verify(samples: Samples, progress: Progress | None = None) -> Replay:
    """
    Ask the recording's own scheme again, with its own parameters and nothing but the samples.

    Parameters
    ----------
    samples : Samples
        Of an unchanged configuration.
    progress : callable, optional
        Told the share that is done, 0 to 1.
    """
    return samples.feed(None, tell=False, progress=progress)


def replay(samples: Samples, scheme: str, progress: Progress | None = None) -> Replay:
    """
    Ask a scheme, telling it what acted in each period.

    Parameters
    ----------
    samples : Samples
        The recorded samples.
    scheme : str
        Who shall answer.
    progress : callable, optional
        Told the share that is done, 0 to 1.
    """
    return samples.feed(scheme, tell=True, progress=progress)


def require_same(samples: Samples, own: Replay) -> None:
    """
    Raise unless the recording's own scheme gave the recorded commands.

    Parameters
    ----------
    samples : Samples
        What was fed.
    own : Replay
        From `verify`.

    Raises
    ------
    ReplayError
        With the first period that differs, and both commands.
    """
    rows = np.flatnonzero(own.differs)
    if not len(rows):
        return
    row = int(rows[0])
    largest = float(np.abs(own.duty - samples.duty)[samples.answered].max())
    if largest <= _SAME_DUTY:
        why = (
            f"no duty differs by more than {largest:.1g}, so it is rounding: the mathematical "
            "library of another machine"
        )
    else:
        version = samples.recording.config.get("versions", {}).get("mfpcc_controller", "unknown")
        why = (
            f"the scheme has changed since (recorded with mfpcc_controller {version}), or the run "
            "was interfered with: a parameter set, a stop asked for"
        )
    raise ReplayError(
        f"{samples.recording.path}: {samples.scheme} does not give its recorded commands again: "
        f"{len(rows)} of {int(samples.answered.sum())} differ, first that of period "
        f"{int(samples.feedback['period'][row]) + 1} "
        f"(recorded duties {_duties(samples.duty[row])}, now {_duties(own.duty[row])}); {why}"
    )


def _duties(duty: NDArray[np.float64]) -> str:
    return "[" + ", ".join(f"{d:.12g}" for d in duty) + "]"
