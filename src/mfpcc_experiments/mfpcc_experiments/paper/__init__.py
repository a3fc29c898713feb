"""The figures and statements of the paper beside ours: ``mfpcc reproduce``.

`runs` makes the runs, `statements` has the paper's sentences, `judging` their verdicts over many
seeds, `figures` and `report` show both.
"""

__all__ = ["figures", "judging", "report", "runs", "statements"]
