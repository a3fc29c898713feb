"""The current-control schemes, one file each.

A scheme is a kernel `step(cfg, mem)`: from the measured current, the committed output `mem.now`
and its own memory it chooses `mem.next` and predicts the current of the next sample into
`mem.i_hat`. What it has of earlier samples counts only while `mem.contiguous` (the sample before
is there, and its output is known) and `mem.kept` (the same scheme was in control then); otherwise
it starts from the committed output, so that a switch between schemes makes no bump.
`show(cfg, mem, diag)` fills its part of the diagnostics, and is called only when they are
published.
"""
