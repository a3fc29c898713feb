"""
A worker process on this machine: jobs come in through a pipe, and their results go back.

It ends when the pipe does, so that none is left behind when whoever hired it is killed.
"""

from __future__ import annotations

import signal
import sys
from multiprocessing.connection import Connection

from pwm_node.errors import ForPeople


def main(descriptor: int) -> None:
    """Do jobs until there are no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C closes the pipe
    with Connection(descriptor) as pipe:
        try:
            while True:
                job = pipe.recv()
                try:
                    pipe.send((job.number, job.run(), ""))
                except ForPeople as error:
                    pipe.send((job.number, None, str(error)))
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return


if __name__ == "__main__":
    main(int(sys.argv[1]))
