"""What passed in the in-process engine, as the messages that the nodes would have published."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from mfpcc_msgs.msg import DriveState, DutyCommand, LutDiagnostics, PhaseFeedback
from numpy.typing import NDArray

from mfpcc_experiments.bags import BagWriter
from mfpcc_experiments.running.engine import Trace
from pwm_node import stamps
from pwm_node.wire import Wire


def write_trace(
    writer: BagWriter, trace: Trace, *, state_every: int = 1, lut_every: int = 1
) -> None:
    """Append a piece of an in-process run to a recording, in the order of the real loop.

    Parameters
    ----------
    writer : BagWriter
        The recording.
    trace : Trace
        What passed.
    state_every, lut_every : int
        Decimation of `drive_state` and `lut_diagnostics`, as of the nodes' parameters; 0: none.
    """
    state = Wire(
        DriveState,
        i_abc_oversampled=trace.i_abc.shape[1],
        legs_oversampled=trace.legs.shape[1],
    )
    waveforms: dict[str, NDArray[Any]] = {
        "i_abc_oversampled": trace.i_abc,
        "legs_oversampled": trace.legs,
    }
    streams = (
        ("phase_feedback", trace.feedback, _serialized(Wire(PhaseFeedback), trace.feedback), 1),
        (
            "drive_state",
            trace.state,
            _serialized(state, trace.state, **waveforms),
            state_every,
        ),
        ("duty_command", trace.command, _serialized(Wire(DutyCommand), trace.command), 1),
        (
            "lut_diagnostics",
            trace.lut,
            _named(trace),
            lut_every,
        ),
    )
    topics = [
        (topic, stamps.nanoseconds(rows["stamp"]).tolist(), messages, every)
        for topic, rows, messages, every in streams
    ]
    for k, period in enumerate(trace.feedback["period"].tolist()):
        for topic, times, messages, every in topics:
            data = next(messages)
            if every and period % every == 0:
                writer.write(topic, times[k], data)


def _serialized(wire: Wire, rows: NDArray[np.void], **tails: NDArray[Any]) -> Iterator[bytes]:
    names = rows.dtype.names or ()
    for k in range(len(rows)):
        for name in names:
            wire.fixed[name][0] = rows[name][k]
        for name, values in tails.items():
            wire.tail[name][:] = values[k]
        yield wire.to_bytes()


def _named(trace: Trace) -> Iterator[bytes]:
    """The diagnostics, with the name of who controlled in each period."""
    borders = np.flatnonzero(np.diff(trace.fallen)) + 1
    for rows in np.split(np.arange(len(trace.lut)), borders):
        wire = Wire(LutDiagnostics)
        wire.set_string("scheme", trace.fallback if trace.fallen[rows[0]] else trace.scheme)
        yield from _serialized(wire, trace.lut[rows])
