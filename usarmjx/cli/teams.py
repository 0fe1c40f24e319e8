"""`usarmjx teams`: what scores of a team task mean, and what a policy finds beside others."""

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from usarmjx.base.files import write_beside
from usarmjx.cli.completion import complete_policies, complete_tasks
from usarmjx.cli.policy_options import PolicyEngineOption, SplitOption
from usarmjx.cli.tools import ErrorExit, SeedOption
from usarmjx.cli.waiting import announce, say, tried_on

if TYPE_CHECKING:
    from usarmjx.train.evaluation.yardsticks import TeamResult


def teams(
    task: Annotated[str, typer.Argument(help="A task for a team.", autocompletion=complete_tasks)],
    names: Annotated[
        list[str] | None,
        typer.Argument(
            help="Teams: random, one, baseline, perfect-radio, packaged, or policies as of eval; else "
            "the first five.",
            autocompletion=complete_policies,
        ),
    ] = None,
    worlds: Annotated[
        int | None,
        typer.Option(
            min=1, help="Episodes, each in a building of its own; 24, or one in each arena of a --split."
        ),
    ] = None,
    seed: SeedOption = 0,
    engine: PolicyEngineOption = "auto",
    split: SplitOption = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", "-c", help="A field of the task as key=value; may be repeated."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Draw finds over time, and the ways of world 0's robots, to this PNG file."),
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write the rows to this file.")] = None,
) -> None:
    """Tell what teams get for each part of a score in the same buildings, and how early they find."""
    with ErrorExit():
        announce("building the worlds that teams play in ...", engines=[tried_on(engine)])
        from usarmjx.engines import choose_engine
        from usarmjx.plots.team_plots import TeamWays, plot_teams
        from usarmjx.train.evaluation import yardsticks
        from usarmjx.train.policies.sources import task_settings

        set_by_hand, _ = task_settings(task, {}, settings or [])
        played, seen = yardsticks.team_task(task, **set_by_hand), TeamWays()
        chosen = list(dict.fromkeys(names or yardsticks.usual_teams(task)))
        watch = yardsticks.ignore if out is None else seen
        how = (seed, choose_engine(engine, "train"), chosen, _tell, watch, split)
        rows = yardsticks.measure_teams(task, worlds, *how, **set_by_hand)
        typer.echo(yardsticks.table(played, rows))
        if json is not None:
            _keep(json, {"task": task, "split": split, "engine": how[1], "settings": settings or []}, rows)
        if out is not None:
            plot_teams(task, rows, seen, out)
            typer.echo(f"wrote {out}")


def _tell(row: "TeamResult") -> None:
    """Say what a team got as soon as it is known."""
    say(f"{row.name}: {row.score.value:.1f}")


def _keep(path: Path, setup: dict[str, Any], rows: "tuple[TeamResult, ...]") -> None:
    """Write the rows as JSON, below what they are of."""
    content = [{**vars(row), "reached": row.reached, "score": vars(row.score)} for row in rows]
    with write_beside(path) as fresh:
        fresh.write_text(json_format.dumps({**setup, "rows": content}, indent=1) + "\n", encoding="utf-8")
