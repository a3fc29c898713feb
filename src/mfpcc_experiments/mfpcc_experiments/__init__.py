"""Experiments with the drive: scenario, run, record, replay, metrics, figures and report, and the command mfpcc."""
