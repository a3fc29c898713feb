"""A measured file into a bag: what is missing is said, and what can be judged can be."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mfpcc_msgs.msg import DutyCommand, LutDiagnostics, PhaseFeedback
from numpy.typing import NDArray

import mfpcc_controller.motor
from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.bags import BagError, BagWriter, versions
from mfpcc_experiments.bags.writer import new_folder
from mfpcc_experiments.identifying import delay as delays
from mfpcc_experiments.identifying.steps import steps_of
from mfpcc_experiments.importing.errors import ImportFailedError
from mfpcc_experiments.importing.mapping import Map
from mfpcc_experiments.importing.samples import Rows, Samples, Seen
from mfpcc_experiments.importing.tables import Table, open_table
from mfpcc_experiments.measuring.waveform import space_vector
from mfpcc_experiments.progress import Tell
from pwm_node import interrupts, stamps
from pwm_node.parameters import ParameterError
from pwm_node.wire import HEADER, Wire, fixed_dtype, fixed_size

# Samples that the delay is estimated from.
_FOR_DELAY = 50_000
# Of the currents' amplitude: what their sum may be before it is said.
_UNBALANCE = 0.05
# What is taken over of the configuration that a file of `mfpcc export` holds: all that a replay of
# the controller needs.
_OF_A_RUN = ("experiment", "scheme", "motor", "seed", "T_s", "window_s", "n_p", "R_s", "versions")
# Who made the commands, where the map does not tell.
_UNKNOWN = "measured"


@dataclass
class Imported:
    """
    What came of an import.

    Attributes
    ----------
    samples, commands : int
        Messages in the bag.
    T_s : float
        PWM period (s).
    notes : list of str
        What was found out, what is missing and what is odd, a sentence each.
    """

    samples: int = 0
    commands: int = 0
    T_s: float = 0.0
    notes: list[str] = field(default_factory=list)


def import_file(
    path: Path, chart: Map, out: Path, *, force: bool = False, progress: Tell | None = None
) -> Imported:
    """
    Import a measured file; the bag appears whole or not at all.

    Parameters
    ----------
    path : Path
        The file: CSV, Parquet or MATLAB.
    chart : Map
        What its columns are.
    out : Path
        Folder of the bag.
    force : bool
        Replace a bag that is there.
    progress : callable, optional
        Told the share that is done, 0 to 1.

    Raises
    ------
    ImportFailedError
        If the file makes no sense: where, why, what to do.
    mfpcc_experiments.bags.BagError
        If the bag cannot be written.
    """
    if out.exists() and not force:
        raise BagError(f"{out}: is there already; nothing is overwritten without --force")
    wanted = [c.column for c in chart.columns().values() if c.column is not None]
    table = open_table(path, list(dict.fromkeys(wanted)), table=chart.table)
    result = Imported(notes=list(table.notes))
    config = _configuration(path, chart, table, result)
    samples = Samples(table, chart, config["n_p"], path)
    config["T_s"] = result.T_s = _same(samples.T_s, config.get("T_s"))
    delay = _delay(samples, chart, config["n_p"], result)
    _say_what_is_missing(chart, result)
    config["imported"] = {
        "file": path.name,
        "delay": delay,
        "sampling_lead": chart.sampling_lead,
        "notes": result.notes,
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    with (
        interrupts.undone(),
        tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as beside,
    ):
        bag = Path(beside) / out.name
        seen = Seen()
        scheme = str(config.get("scheme") or _UNKNOWN)
        with BagWriter(bag, config=config) as writer:
            for rows in samples.rows(seen):
                _write(writer, rows, delay, config["n_p"], result, scheme)
                if progress is not None:
                    progress(rows.done)
            if not result.samples or not result.commands:
                what = "sample" if not result.samples else "command"
                raise ImportFailedError(f"{path}: there is no row with a whole {what}")
            _say_what_was_seen(chart, seen, table.unit, result)
            writer.close({"notes": result.notes})
        with interrupts.finished():
            new_folder(out, force=force)
            os.replace(bag, out)
    return result


def _same(T_s: float, stored: Any) -> float:
    """The stored period, where the times say the same but for their rounding."""
    if isinstance(stored, float) and abs(stored / T_s - 1.0) < 1e-6:
        return stored
    return T_s


# --- What is known of the drive -------------------------------------------------------------------


def _configuration(path: Path, chart: Map, table: Table, result: Imported) -> dict[str, Any]:
    """What is stored with the recording."""
    config: dict[str, Any] = {
        "experiment": path.stem[:100],
        "engine": "measured",
        "versions": versions(),
    }
    if isinstance(table.configuration.get("parameters"), dict) and not chart.controller:
        stored = table.configuration
        config = {key: stored[key] for key in _OF_A_RUN if key in stored}
        controller = stored["parameters"].get("mfpcc_controller")
        config |= {"engine": "measured", "parameters": {"mfpcc_controller": controller}}
        result.notes.append("the run's configuration is in the file, and is taken from there")
    motor = chart.motor or config.get("motor")
    pars = None
    if chart.motor is not None:
        pars = mfpcc_controller.motor.load(chart.motor)
        config |= {"motor": chart.motor, "R_s": pars.R_s}
    n_p = chart.pole_pairs or (pars.n_p if pars is not None else config.get("n_p"))
    if n_p is None:
        result.notes.append(
            "neither pole pairs nor a motor are given: angle and speed count as electrical "
            "(pole_pairs: 1)"
        )
        n_p = 1
    config["n_p"] = n_p
    if chart.controller:
        try:
            values = CONTROLLER.validate(
                {**({} if motor is None else {"motor": motor}), **chart.controller}
            )
        except ParameterError as wrong:
            raise ImportFailedError(f"the map's 'controller': {wrong.reason}") from None
        config["parameters"] = {"mfpcc_controller": dict(CONTROLLER.complete(values))}
        config["scheme"] = config["parameters"]["mfpcc_controller"]["scheme"]
    return config


def _delay(samples: Samples, chart: Map, n_p: int, result: Imported) -> int:
    """Periods from a row to the effect of its command, from the map or from the data."""
    if chart.delay is not None:
        return chart.delay
    found = delays.estimate(_begin(samples, n_p))
    if found is None or not found.sure:
        why = "too few samples" if found is None else f"they would say {found}"
        result.notes.append(
            f"the delay from a command to its effect cannot be told from the data ({why}): 1 "
            "period is taken; give 'delay' in the map if it is another"
        )
        return 1
    result.notes.append(
        f"the delay from the row of a command to its effect is, in periods, {found}"
    )
    return found.periods


def _begin(samples: Samples, n_p: int) -> Any:
    """The first samples as steps."""
    pieces: list[Rows] = []
    count = 0
    for rows in samples.rows(Seen()):
        pieces.append(rows)
        count += len(rows.period)
        if count >= _FOR_DELAY:
            break

    def joined(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(rows, name) for rows in pieces])

    there = joined("sampled")
    u_s_ab = space_vector(joined("duty")) * joined("u_dc")
    u_s_ab = np.where(joined("commanded") & joined("enable"), u_s_ab, np.nan)
    return steps_of(
        space_vector(joined("i_abc"))[there],
        (n_p * joined("angle"))[there],
        u_s_ab[there],
        joined("period")[there],
        samples.T_s,
    )


def _say_what_is_missing(chart: Map, result: Imported) -> None:
    """What the file does not hold, and what follows from that."""
    say = result.notes.append
    currents = chart.currents.columns()
    if len(currents) == 2:
        (third,) = {"a", "b", "c"} - set(currents)
        say(f"phase {third} is not measured: its current is minus the sum of the other two")
    if chart.angle is None and chart.electrical_angle is None:
        if chart.speed is None and chart.electrical_speed is None:
            say(
                "no angle: the rotor counts as standing still, with its d axis on phase a; nothing "
                "that takes a turning rotor can be judged"
            )
        else:
            say(
                "no angle: it is integrated from the speed, and where it begins is not known; d "
                "and q are not told apart"
            )
    if chart.voltages is not None:
        say("the duties are made from the voltages: which zero vectors were used is not known")
    if chart.references is None:
        say("no references: how well the current follows them cannot be judged")
    if chart.sampling_lead:
        say(
            f"the currents are sampled {chart.sampling_lead:g} periods before the period begins; "
            "they stand in the recording as they were measured"
        )


def _say_what_was_seen(chart: Map, seen: Seen, unit: str, result: Imported) -> None:
    """What is odd about the rows."""
    result.notes += seen.notes
    if seen.without_sample:
        result.notes.append(
            f"{seen.without_sample} of {seen.rows} rows lack a value, the first is {unit} "
            f"{seen.first_without}: these samples are lost"
        )
    if seen.clipped:
        result.notes.append(
            f"{seen.clipped} voltages are beyond what the DC voltage can give: they are cut off"
        )
    if len(chart.currents.columns()) == 3 and seen.squared > 0.0:
        # Of noise, the sum has three times the square of one of them.
        share = (seen.sum_squared / seen.squared) ** 0.5
        if share > _UNBALANCE:
            rms = (seen.sum_squared / max(1, seen.rows - seen.without_sample)) ** 0.5
            result.notes.append(
                f"the three currents do not sum up to nothing: {rms:.3g} A rms, {share:.0%} of one "
                "of them; gains or offsets of the sensors differ, or a phase is wrong"
            )


# --- Messages -------------------------------------------------------------------------------------


def _write(
    writer: BagWriter, rows: Rows, delay: int, n_p: int, result: Imported, scheme: str
) -> None:
    frequency = 1.0 / result.T_s
    topics: list[tuple[str, Iterator[tuple[int, bytes]]]] = [
        ("phase_feedback", _messages(_feedback(rows, frequency), PhaseFeedback)),
        ("duty_command", _messages(_commands(rows, delay, frequency), DutyCommand)),
    ]
    if rows.i_ref is not None:
        topics.append(("lut_diagnostics", _references(rows, frequency, n_p, scheme)))
    # Period by period, so that chunks of the bag hold whole periods.
    merged = [(time, n, topic, data) for n, (topic, m) in enumerate(topics) for time, data in m]
    merged.sort(key=lambda message: message[:2])
    for time, _, topic, data in merged:
        writer.write(topic, time, data)
        result.samples += topic == "phase_feedback"
        result.commands += topic == "duty_command"


def _stamped(rows: NDArray[np.void], period: NDArray[np.int64], frequency: float) -> None:
    rows["period"] = period
    for k, number in enumerate(period.tolist()):
        rows["stamp"][k] = stamps.begin(number, frequency)


def _feedback(rows: Rows, frequency: float) -> NDArray[np.void]:
    there = rows.sampled
    messages = np.zeros(int(there.sum()), fixed_dtype(PhaseFeedback))
    _stamped(messages, rows.period[there], frequency)
    for n, leg in enumerate("abc"):
        messages[f"i_{leg}"] = rows.i_abc[there, n]
    messages["encoder_angle"] = rows.angle[there]
    messages["dc_voltage"] = rows.u_dc[there]
    messages["derating"] = 1.0
    return messages


def _commands(rows: Rows, delay: int, frequency: float) -> NDArray[np.void]:
    there = rows.commanded & (rows.period + delay >= 0)
    messages = np.zeros(int(there.sum()), fixed_dtype(DutyCommand))
    _stamped(messages, rows.period[there] + delay, frequency)
    messages["duty"] = rows.duty[there]
    messages["enable"] = rows.enable[there]
    if rows.vectors is not None and rows.dwell is not None:
        with np.errstate(invalid="ignore"):
            known = np.isfinite(rows.vectors).all(axis=1) & np.isfinite(rows.dwell).all(axis=1)
        messages["vectors"] = np.where(known[:, None], rows.vectors, 0)[there]
        messages["dwell"] = np.where(known[:, None], rows.dwell, 0.0)[there]
    return messages


def _messages(rows: NDArray[np.void], kind: Any) -> Iterator[tuple[int, bytes]]:
    """Time and serialized message of each row: fixed fields travel as they lie in memory."""
    size, step = fixed_size(kind), rows.dtype.itemsize
    memory = rows.tobytes()
    for k, time in enumerate(stamps.nanoseconds(rows["stamp"]).tolist()):
        yield time, HEADER + memory[k * step : k * step + size]


def _references(rows: Rows, frequency: float, n_p: int, scheme: str) -> Iterator[tuple[int, bytes]]:
    """The references beside the current; what the controller predicted is not known."""
    assert rows.i_ref is not None
    wire = Wire(LutDiagnostics)
    wire.set_string("scheme", scheme)
    for name in ("gradient_re", "gradient_im", "prediction_error", "error_share", "speed_ref"):
        wire.fixed[name] = np.nan
    there = np.flatnonzero(rows.sampled & np.isfinite(rows.i_ref).all(axis=1))
    if not len(there):
        return
    i_dq = space_vector(rows.i_abc[there]) * np.exp(-1j * n_p * rows.angle[there])
    angle = np.unwrap(n_p * rows.angle[there])
    periods = np.diff(rows.period[there])
    w_m = np.diff(angle) / periods * frequency
    w_m = np.append(w_m, w_m[-1:] if len(w_m) else [0.0])
    message = wire.fixed[0]
    for k, row in enumerate(there.tolist()):
        message["stamp"] = stamps.begin(int(rows.period[row]), frequency)
        message["period"] = rows.period[row]
        message["i_dq"] = i_dq[k].real, i_dq[k].imag
        message["i_dq_ref"] = rows.i_ref[row]
        message["w_m"] = w_m[k]
        yield stamps.at(*message["stamp"].tolist()), wire.to_bytes()
