"""`mfpcc faults`: inject every fault there is, and see whether the drive survives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from mfpcc_experiments import completion
from mfpcc_experiments.running import ENGINES

if TYPE_CHECKING:
    from mfpcc_experiments.proofs.faults import Verdict


@click.command()
@click.option("--unit", default="", help="Only faults of this unit, such as encoder.")
@click.option(
    "--engine",
    default="inprocess",
    show_default=True,
    metavar="|".join(ENGINES),
    shell_complete=completion.names(*ENGINES),
    help="Real nodes on a real graph, or the same plant and schemes without ROS.",
)
@click.option("--brief", is_flag=True, help="Show only the cases that were not survived.")
@click.option("--no-control", is_flag=True, help="Leave out the negative control.")
@click.option(
    "--needed",
    is_flag=True,
    help="Show each check of the protection with the cases that fail without it.",
)
def command(unit: str, engine: str, brief: bool, no_control: bool, needed: bool) -> int:
    """Inject every fault into the running drive, and judge it by the truth in the plant.

    The exit code is 1 if a case was not survived, or if the negative control (the same faults
    with the protection switched off) shows no damage. With --needed, each check of both nodes is
    taken out of the kernels in turn, and the exit code is 1 if the matrix passes without one.
    """
    if needed:
        if unit or engine != "inprocess":
            raise click.UsageError("--needed takes the whole matrix, in process")
        return _show_needed()
    from mfpcc_experiments.progress import progress_bar
    from mfpcc_experiments.proofs import fault_cases, faults
    from pmsm_sim.parts.injection import UNITS
    from pwm_node.names import unknown

    if unit and unit not in UNITS:
        raise click.UsageError(unknown("unit", unit, UNITS))
    if engine not in ENGINES:
        raise click.UsageError(unknown("engine", engine, ENGINES))
    cases = [case for case in fault_cases.cases() if unit in ("", case.unit)]
    with progress_bar() as begin:
        tell = begin("faults", len(cases))
        verdicts = faults.judge_all(cases, engine=engine, tell=tell)
        if not no_control:
            tell = begin("unprotected", len(cases))
            unprotected = faults.judge_all(cases, engine=engine, react=False, tell=tell)
    _show([verdict for verdict in verdicts if not (brief and verdict.survived)])
    lost = sum(not verdict.survived for verdict in verdicts)
    click.echo(f"{len(verdicts)} cases, {len(verdicts) - lost} survived")
    if no_control:
        return int(lost > 0)
    harmed = [verdict.current for verdict in unprotected if not verdict.current <= faults.DAMAGE]
    most = f", up to {max(harmed):.0f} A" if harmed else ""
    click.echo(
        f"negative control, protection switched off: {len(harmed)} cases beyond "
        f"{faults.DAMAGE:g} A{most}"
    )
    return int(lost > 0 or not (harmed or unit))


def _show_needed() -> int:
    """Print the table of the checks; 1 if one is not needed."""
    from mfpcc_experiments.progress import progress_bar
    from mfpcc_experiments.proofs import needed

    checks = []
    with progress_bar() as begin:
        tell = None
        for found in needed.ask():
            if "fails" in found:
                click.echo(f"not survived with all checks in place: {found['fails']}")
                return 1
            if "done" in found:
                tell = tell or begin("checks", found["of"])
                tell(found["done"])
            else:
                checks.append(found)
    click.echo(f"{'node':<12}{'check':<44}{'needed by':>10}  for example")
    for check in checks:
        cases = check["cases"]
        example = cases[0] if cases else "NOTHING NEEDS IT"
        click.echo(f"{check['node']:<12}{check['check']:<44}{len(cases):>10}  {example}")
    lacking = sum(not check["cases"] for check in checks)
    click.echo(f"{len(checks)} checks, {len(checks) - lacking} of them needed by a case")
    return int(lacking > 0)


def _show(verdicts: Sequence[Verdict]) -> None:
    """Print the table of the cases."""
    click.echo(
        f"{'unit':<14}{'fault':<14}{'operating point':<34}{'off after':>10}{'current':>9}  found"
    )
    for verdict in verdicts:
        case = verdict.case
        after = "-"
        if verdict.tripped_after == verdict.tripped_after:
            after = f"{verdict.tripped_after * 1e3:.1f} ms"
        click.echo(
            f"{case.unit:<14}{case.kind_of_fault:<14}{case.point!s:<34}{after:>10}"
            f"{verdict.current:>7.1f} A  {', '.join(verdict.codes) or '-'}"
        )
        for failure in verdict.failures:
            click.echo(f"    NOT SURVIVED: {failure}")
