"""Sweeps: an experiment run many thousand times, with what varies drawn from a file.

`spec` is that file, `space` what a parameter's values come from, `plan` the rows: what varies in
each, and the run that it is. `work` runs one chunk of rows into the bytes of a Parquet file, here
or on any machine; `local` lets this machine's cores do it, `cluster` the workers of Dask. `folder`
is what is on the disk, which is all the state there is. `rows` reads it, and `report` tells what
all rows say.
"""
