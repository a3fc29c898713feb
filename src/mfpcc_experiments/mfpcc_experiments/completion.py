"""What the shell offers at a Tab: experiments, schemes, motors.

The verbs and their options click knows itself. The names are looked up when they are asked for, so
that a file or a plug-in that is new is offered at once.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable

import click
from click.shell_completion import BashComplete, CompletionItem, add_completion_class
from click.shell_completion import split_arg_string as split

Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def experiments(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Offer the experiments there are, or else files."""
    from pwm_node import yaml_files

    named = _beginning_with(incomplete, yaml_files.available("experiments"))
    return named or [CompletionItem(incomplete, type="file")]


def schemes(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Offer the schemes there are, those of other packages too."""
    from mfpcc_controller.parameters import TABLE

    return _beginning_with(incomplete, TABLE["scheme"].choices or ())


def maps(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Offer the maps of measured files there are, or else files."""
    from pwm_node import yaml_files

    named = _beginning_with(incomplete, yaml_files.available("maps"))
    return named or [CompletionItem(incomplete, type="file")]


def changes(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Offer the motors, for `--set`."""
    from pwm_node import yaml_files

    return _beginning_with(incomplete, (f"motor={name}" for name in yaml_files.available("motors")))


def names(*there: str) -> Complete:
    """Offer some names."""
    return lambda context, parameter, incomplete: _beginning_with(incomplete, there)


def _beginning_with(incomplete: str, there: Iterable[str]) -> list[CompletionItem]:
    return [CompletionItem(name) for name in there if name.startswith(incomplete)]


class Bash(BashComplete):
    """Bash breaks words at `=`, and here they are put together again."""

    def get_completion_args(self) -> tuple[list[str], str]:
        typed: list[str] = []
        for word in self._words():
            if typed and (word == "=" or typed[-1].endswith("=")):
                typed[-1] += word
            else:
                typed.append(word)
        return typed[1:-1], typed[-1]

    def format_completion(self, item: CompletionItem) -> str:
        _, incomplete = self.get_completion_args()
        before, sign, value = item.value.partition("=")
        if sign and incomplete.startswith(f"{before}=") and self._words()[-1] != incomplete:
            # what stands behind the sign is a word of its own, and is replaced alone
            item = CompletionItem(value, item.type, item.help)
        return super().format_completion(item)

    def _words(self) -> list[str]:
        """Words up to the one that is being typed, as the shell has broken them."""
        words, at = split(os.environ["COMP_WORDS"]), int(os.environ["COMP_CWORD"])
        return [*words[:at], words[at] if at < len(words) else ""]


add_completion_class(Bash)
