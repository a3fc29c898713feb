"""The topics of the control loop, as they are recorded."""

from __future__ import annotations

#: Topics of the control loop (relative names) and their types.
LOOP_TOPICS = {
    "phase_feedback": "mfpcc_msgs/msg/PhaseFeedback",
    "duty_command": "mfpcc_msgs/msg/DutyCommand",
    "lut_diagnostics": "mfpcc_msgs/msg/LutDiagnostics",
    "drive_state": "mfpcc_msgs/msg/DriveState",
}
