"""Proofs of the simulated drive (`validation`, over the drives of `effects`), also under faults."""

__all__ = ["effects", "faults", "validation"]
