"""Errors of imports, in words for people."""

from __future__ import annotations

from mfpcc_experiments.bags.errors import printable
from pwm_node.errors import ForPeople


class ImportFailedError(ForPeople):
    """A measured file that cannot be imported; one line says where, why and what to do."""

    def __init__(self, text: str) -> None:
        super().__init__(printable(text))
