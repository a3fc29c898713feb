"""The tables and figures of docs/method.md: ``python -m mfpcc_experiments.method PAGE``."""
