"""Experiments with the drive, and the command mfpcc."""
