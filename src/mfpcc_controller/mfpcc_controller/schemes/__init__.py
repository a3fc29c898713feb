"""The current-control schemes, one file each.

A scheme is a kernel `step(cfg, mem)`: from the measured current, the committed output `mem.now`
and its own memory it chooses `mem.next` and predicts the current of the next sample into
`mem.i_hat`. `show(cfg, mem)` fills the gradients for the diagnostics, and is called only when
they are published.
"""
