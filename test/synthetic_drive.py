"""A synthetic drive: recordings with known contents, without simulator, ROS graph or noise."""

from collections.abc import Iterator

import numpy as np

T_S_NS = 100_000
CONFIG = {
    "experiment": "synthetic",
    "scheme": "mls_mfpcc",
    "motor": "seed_750",
    "engine": "inprocess",
    "seed": 7,
    "T_s": 1e-4,
    "n_p": 4,
    "R_s": 1.5,
    "window_s": [0.1, 0.3],
}

Message = tuple[str, int, bytes]


def messages(
    periods: int, *, oversampling: int = 0, first: int = 0, scheme: str = "mls_mfpcc"
) -> Iterator[Message]:
    """
    The loop's messages of a drive at 750 r/min with i_dq = 0.2 + 3j A.

    Phase a has a fifth harmonic of 2 % of the fundamental; the prediction error is 0.05 A on d and
    -0.1 A on q in every third period.
    """
    from mfpcc_msgs.msg import DriveState, DutyCommand, LutDiagnostics, PhaseFeedback

    from pwm_node.wire import Wire

    feedback, command, lut = Wire(PhaseFeedback), Wire(DutyCommand), Wire(LutDiagnostics)
    state = Wire(DriveState, i_abc_oversampled=3 * oversampling, legs_oversampled=oversampling)
    lut.set_string("scheme", scheme)
    amplitude = abs(0.2 + 3j)
    steps = np.arange(max(1, oversampling)) / max(1, oversampling)
    for k in range(first, first + periods):
        time = k * T_S_NS
        w_M = 2 * np.pi * 12.5
        theta_M = w_M * (k + steps) * 1e-4
        phase = 4 * theta_M[:, None] + np.angle(0.2 + 3j) - 2 * np.pi / 3 * np.arange(3)
        i_abc = amplitude * (np.cos(phase) + 0.02 * np.cos(5 * phase))
        for wire in (feedback, command, lut, state):
            wire.fixed["stamp"]["sec"], wire.fixed["stamp"]["nanosec"] = divmod(time, 10**9)
            wire.fixed["period"] = k
        feedback.fixed["i_a"], feedback.fixed["i_b"], feedback.fixed["i_c"] = i_abc[0]
        feedback.fixed["encoder_angle"] = theta_M[0] % (2 * np.pi)
        feedback.fixed["dc_voltage"] = 311.0
        feedback.fixed["derating"] = 1.0
        command.fixed["period"] = k + 1
        command.fixed["duty"] = (0.4, 0.5, 0.6)
        command.fixed["enable"] = True
        lut.fixed["i_dq"] = (0.2, 3.0)
        lut.fixed["i_dq_ref"] = (0.0, 3.1)
        lut.fixed["prediction_error"] = (0.05, -0.1) if k % 3 == 0 else (0.0, 0.0)
        lut.fixed["w_m"] = 4 * w_M
        state.fixed["i_dq"] = (0.2, 3.0)
        state.fixed["torque"] = 2.5
        state.fixed["angle"] = theta_M[0] % (2 * np.pi)
        state.fixed["speed"] = w_M
        state.fixed["gates_on"] = True
        state.fixed["temperature"] = 20.0
        if oversampling:
            state.tail["i_abc_oversampled"][:] = i_abc.ravel()
            state.tail["legs_oversampled"][:] = k % 8
        yield "phase_feedback", time, feedback.to_bytes()
        yield "lut_diagnostics", time, lut.to_bytes()
        yield "drive_state", time, state.to_bytes()
        yield "duty_command", time + T_S_NS, command.to_bytes()
