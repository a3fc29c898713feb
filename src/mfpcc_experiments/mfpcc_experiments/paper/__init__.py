"""The figures and statements of the paper beside ours: ``mfpcc reproduce``."""
