"""The verbs of the command `mfpcc`, one file each."""
