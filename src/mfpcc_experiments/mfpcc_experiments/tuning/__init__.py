"""Tuning: every scheme's parameters by the same optimiser, and what the best of them are worth.

`scenarios` is the file of it: what may be moved, and the drives. `criteria` are the figures of a
choice on these drives, and a job of a worker. `study` lets the optimiser ask and tells it, `folder`
is what is on the disk. `ranks` compares what was judged, with intervals, and `page` writes it down.
"""
