"""From arrays to numbers: windows, metrics, and replay of recorded samples."""
