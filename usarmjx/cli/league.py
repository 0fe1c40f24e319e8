"""`usarmjx league`: the past selves of a training, and how the policy plays against them."""

from pathlib import Path
from typing import Annotated

import typer

from usarmjx.base.progress import RateLimitedLog
from usarmjx.cli.common import ErrorExit, SeedOption, announce, ends_on_signals, say
from usarmjx.cli.task_options import PolicyEngineOption


def league(
    run: Annotated[Path, typer.Argument(help="Folder of a run, or of several seeds, with setting league.")],
    games: Annotated[
        int, typer.Option(min=0, help="Games that the last policy plays against each player; 0: none.")
    ] = 0,
    seed: SeedOption = 0,
    engine: PolicyEngineOption = "auto",
) -> None:
    """Show the ratings of a training's past selves, and play against them."""
    with ErrorExit(), ends_on_signals():
        announce(f"reading {run} ...")
        from usarmjx.engines import choose_engine
        from usarmjx.train.evaluation.league_games import (
            league_table,
            load_league,
            play_league,
            runs_in,
        )
        from usarmjx.train.learning.league import standings

        tell = RateLimitedLog(say)
        for one in runs_in(run):
            _, _, found, _, _ = load_league(one)
            played = play_league(one, games, seed, choose_engine(engine, "train"), tell) if games else {}
            typer.echo(f"{one}\n\n{league_table(standings(found), played)}\n")
