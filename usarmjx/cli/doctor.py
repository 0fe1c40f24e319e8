"""`usarmjx doctor`: is everything here that usarmjx needs, and does it run?"""

import gc
import json as json_format
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from usarmjx.cli.listing import JsonFlag
from usarmjx.cli.tools import ErrorExit
from usarmjx.cli.waiting import announce, say

if TYPE_CHECKING:
    from usarmjx.cli.checks import Finding

COLOURS = {"ok": typer.colors.GREEN, "note": typer.colors.YELLOW, "wrong": typer.colors.RED}


def doctor(
    json: JsonFlag = False,
    self_test: Annotated[
        bool, typer.Option(help="Step small worlds and serve a client, too: ten seconds.")
    ] = True,
) -> None:
    """Look at versions, devices, cache, ports, engines, and try small worlds; exit code 1 if one is wrong."""
    with ErrorExit():
        announce("looking at packages, cache, ports and devices ...", quickly=True)
        from usarmjx.cli.checks import CHECKS, run_checks

        found = run_checks(CHECKS)
        if self_test:
            from usarmjx.cli.self_test import SELF_TEST

            for check in SELF_TEST:
                say(f"{(check.__doc__ or '').rstrip('.').lower()} ...")
                found += run_checks([check])
        faults = sum(one.verdict == "wrong" for one in found)
        if json:
            whole = {"ok": not faults, "findings": [asdict(one) for one in found]}
            typer.echo(json_format.dumps(whole, indent=1))
        else:
            show_findings(found)
        # At the end Python would look through all that was imported and compiled: a second or two.
        gc.freeze()
        if faults:
            raise typer.Exit(1)


def show_findings(found: "Sequence[Finding]") -> None:
    """Print a line for each finding, what to do below it, and the sum of it all."""
    width = max(len(one.about) for one in found)
    for one in found:
        verdict = typer.style(f"{one.verdict:5}", fg=COLOURS[one.verdict])
        typer.echo(f"{verdict}  {one.about:{width}}  {one.text}")
        if one.advice:
            typer.echo(f"{'':{width + 9}}-> {one.advice}")
    faults = [one.about for one in found if one.verdict == "wrong"]
    typer.echo(f"wrong: {', '.join(dict.fromkeys(faults))}" if faults else "nothing is wrong")
