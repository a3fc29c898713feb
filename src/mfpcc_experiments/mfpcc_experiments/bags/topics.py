"""The topics of the control loop, as they are recorded."""

from __future__ import annotations

#: Topics of the control loop (relative names) and their types.
LOOP_TOPICS = {
    "phase_feedback": "mfpcc_msgs/msg/PhaseFeedback",
    "duty_command": "mfpcc_msgs/msg/DutyCommand",
    "lut_diagnostics": "mfpcc_msgs/msg/LutDiagnostics",
    "drive_state": "mfpcc_msgs/msg/DriveState",
}

#: The command that answers a sample is for the period after it.
LEAD = {"duty_command": 1}

#: Never decimated: what is not there was lost.
EVERY_PERIOD = ("phase_feedback", "duty_command")
