"""Proofs of the simulated drive (`validation`) and of its behaviour under faults (`faults`)."""

__all__ = ["faults", "validation"]
