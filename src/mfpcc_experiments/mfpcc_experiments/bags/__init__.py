"""Recordings on disk and as arrays: writing, reading, checking and repairing bags."""
