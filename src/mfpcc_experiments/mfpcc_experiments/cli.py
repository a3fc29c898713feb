"""
The command `mfpcc`: one verb, one file of `verbs/`.

A verb is the click command named `command` in its file; putting a file there is all it takes. A
verb imports what it works with inside its function, so that `mfpcc --help` is there at once.

What is said to people goes to stderr as one line, without a traceback. The exit code is 0 for
success, 1 for a failure, 2 for a command line that makes no sense, 3 where the work was done but
the drive did not do what was asked for (`notes`), 130 for Ctrl-C.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import sys
from collections.abc import Sequence
from typing import Any

import click

from mfpcc_experiments import verbs
from pwm_node import interrupts
from pwm_node.errors import ForPeople
from pwm_node.names import unknown

PROGRAM = "mfpcc"

# What is missing when nobody has sourced the workspace.
_FROM_ROS = {"ament_index_python", "mfpcc_msgs", "rclpy", "rpyutils", "rosidl_runtime_py"}


class Verbs(click.Group):
    """The commands that are in `verbs/`."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(module.name for module in pkgutil.iter_modules(verbs.__path__))

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.list_commands(ctx):
            return None
        module = importlib.import_module(f"{verbs.__name__}.{cmd_name}")
        command: click.Command = module.command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in self.list_commands(ctx) and not args[0].startswith("-"):
            raise click.UsageError(unknown("verb", args[0], self.list_commands(ctx)), ctx)
        return super().resolve_command(ctx, args)


def _version(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        from importlib.metadata import version

        click.echo(f"{PROGRAM} {version('mfpcc_experiments')}")
        ctx.exit()


@click.command(
    cls=Verbs,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    no_args_is_help=False,
    invoke_without_command=True,
)
@click.option(
    "--version",
    is_flag=True,
    expose_value=False,
    is_eager=True,
    callback=_version,
    help="Show the version.",
)
@click.pass_context
def cli(ctx: click.Context) -> None:
    """Predictive current control of PMSM drives: run experiments, record and compare them."""
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


def run(args: Sequence[str] | None = None) -> int:
    """
    Run the command and say what went wrong, if anything.

    Parameters
    ----------
    args : sequence of str, optional
        The command line after the program's name.

    Returns
    -------
    int
        The exit code.
    """
    if "_MFPCC_COMPLETE" in os.environ:
        from mfpcc_experiments import completion  # noqa: F401 (tells click of our bash)

    try:
        code: Any = cli.main(
            args=None if args is None else list(args), prog_name=PROGRAM, standalone_mode=False
        )
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else PROGRAM
        return _say(f"{_one_line(error.format_message()).rstrip('.')} (see {where} --help)", code=2)
    except click.ClickException as error:
        return _say(_one_line(error.format_message()), code=1)
    except (KeyboardInterrupt, click.Abort):
        return _say("interrupted", code=interrupts.exit_code() or 130)
    except Exception as error:  # noqa: BLE001 (here is where all of them end)
        interrupted = interrupts.exit_code()
        if interrupted is not None:
            return _say("interrupted", code=interrupted)  # some library made of it what it knows
        explanation = _explanation(error)
        if explanation is not None:
            return _say(explanation, code=1)
        return _say(
            f"unexpected {type(error).__name__}: {_one_line(str(error))} "
            f"(this is a bug: please report it with {_save_traceback()})",
            code=1,
        )
    return code if isinstance(code, int) else 0


def _say(text: str, *, code: int) -> int:
    for line in text.splitlines():
        click.echo(f"{PROGRAM}: {line}", err=True)
    return code


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _explanation(error: Exception) -> str | None:
    """What to tell the user of an error that is no mistake of ours, else None."""
    if isinstance(error, ForPeople):
        return str(error)
    if isinstance(error, RuntimeError) and str(error).startswith("Symlink loop"):
        return f"{str(error)[0].lower()}{str(error)[1:]}"  # of `Path.resolve`, up to Python 3.12
    if isinstance(error, ModuleNotFoundError) and (error.name or "").split(".")[0] in _FROM_ROS:
        return f"there is no Python module '{error.name}' here: 'source setup.bash' first"
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return None


def _save_traceback() -> str:
    """Write the traceback of the current exception to a file and return its path."""
    import tempfile
    import traceback

    with tempfile.NamedTemporaryFile(
        "w", prefix="mfpcc-error-", suffix=".txt", delete=False, encoding="utf-8"
    ) as file:
        file.write(f"{PROGRAM} {' '.join(sys.argv[1:])}\nPython {sys.version}\n\n")
        traceback.print_exc(file=file)
    return file.name
