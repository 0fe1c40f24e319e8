"""`usarmjx eval`: how good a policy is."""

import json as json_format
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from usarmjx.base.files import write_beside
from usarmjx.base.progress import Seldom
from usarmjx.cli.grouping import grouped
from usarmjx.cli.policy_options import PolicyEngineOption, PolicyOptions, SplitOption
from usarmjx.cli.tools import ErrorExit
from usarmjx.cli.waiting import announce, say, tried_on

if TYPE_CHECKING:
    from usarmjx.base.estimates import Estimate


def _told(one: "Estimate", what: str) -> str:
    """Return an estimate in words."""
    known = math.isfinite(one.low)
    interval = f"{one.low:.3f} to {one.high:.3f} by {one.method}" if known else "unknown"
    return f"{what} {one.value:.3f}, 95 % interval {interval}"


@grouped
def evaluate_policy(
    driver: PolicyOptions,
    episodes: Annotated[
        int | None,
        typer.Option(min=1, help="Episodes of each seed, at least; 100, or as many in each generated arena."),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds, from --seed on.")] = 1,
    worlds: Annotated[
        int | None,
        typer.Option(min=1, help="Worlds at once, each with as many episodes; 20, or one for each arena."),
    ] = None,
    engine: PolicyEngineOption = "auto",
    split: SplitOption = None,
    level: Annotated[
        float | None, typer.Option(min=0.0, max=1.0, help="How difficult generated arenas are at most.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option(help="Write the result with every episode to this file.")
    ] = None,
) -> None:
    """Tell a policy's mean final score and the 95 % interval of that mean."""
    with ErrorExit():
        announce("building the worlds that the policy is tried in ...", engines=[tried_on(engine)])
        from usarmjx.engines import choose_engine
        from usarmjx.train.evaluation.evaluate import as_record, evaluate_episodes

        engine, found = choose_engine(engine, "train"), driver.source()
        many, episodes = driver.amount(found, split, worlds, episodes)
        env, policy = driver.env(found, many, engine, split)
        numbers = range(driver.seed, driver.seed + seeds)
        result = evaluate_episodes(env, policy, episodes, numbers, level, Seldom(say))
        count = result.score.count
        bad = sum(run.bad for run in result.episodes)
        over = f"{count} episodes" if seeds == 1 else f"{seeds} seeds, {count} episodes"
        where = f"{found.task}{f' ({split} split)' if split else ''}"
        several = f"; {_told(result.over_seeds, 'interquartile mean of the seeds')}" if seeds > 1 else ""
        typer.echo(
            f"{where}, {found.name}: {_told(result.score, 'score')} ({over}"
            f"{f', {bad} left out: physics failed' if bad else ''}){several}"
        )
        if json is not None:
            what = {"task": found.task, "policy": found.name, "checkpoint": driver.checkpoint}
            setup = {
                "engine": engine,
                "worlds": many,
                "level": level,
                "split": split,
                "settings": driver.set_by_hand,
            }
            with write_beside(json) as fresh:
                fresh.write_text(json_format.dumps({**what, **setup, **as_record(result)}, indent=1) + "\n")
