"""Proofs of the simulated drive and of its behaviour under faults."""
