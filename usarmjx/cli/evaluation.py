"""`usarmjx eval`: how good a policy is."""

import json as json_format
import math
from pathlib import Path
from typing import Annotated

import typer

from usarmjx.base.files import write_beside
from usarmjx.base.progress import Seldom
from usarmjx.cli.grouping import grouped
from usarmjx.cli.policy_options import PolicyEngineOption, PolicyOptions
from usarmjx.cli.tools import ErrorExit
from usarmjx.cli.waiting import announce, say


@grouped
def evaluate_policy(
    driver: PolicyOptions,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each seed, at least.")] = 100,
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds, from --seed on.")] = 1,
    worlds: Annotated[int, typer.Option(min=1, help="Worlds at once, each with as many episodes.")] = 20,
    engine: PolicyEngineOption = "auto",
    level: Annotated[
        float | None, typer.Option(min=0.0, max=1.0, help="How difficult generated arenas are at most.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option(help="Write the result with every episode to this file.")
    ] = None,
) -> None:
    """Tell a policy's mean final score and the 95 % interval of that mean."""
    with ErrorExit():
        announce("building the worlds that the policy is tried in ...")
        from usarmjx.train.evaluation.evaluate import as_record, evaluate_episodes

        found, many = driver.source(), min(worlds, episodes)
        env, policy = driver.env(found, many, engine)
        numbers = range(driver.seed, driver.seed + seeds)
        result = evaluate_episodes(env, policy, episodes, numbers, level, Seldom(say))
        score, count = result.score, sum(len(run.scores) for run in result.episodes)
        bad = sum(run.bad for run in result.episodes)
        over = f"{count} episodes" if seeds == 1 else f"{seeds} seeds, {count} episodes"
        interval = f"{score.low:.3f} to {score.high:.3f}" if math.isfinite(score.low) else "unknown"
        typer.echo(
            f"{found.task}, {found.name}: score {score.mean:.3f}, 95 % interval {interval} ({over}"
            f"{f', {bad} left out: physics failed' if bad else ''})"
        )
        if json is not None:
            what = {"task": found.task, "policy": found.name, "checkpoint": driver.checkpoint}
            setup = {"engine": engine, "worlds": many, "level": level, "settings": driver.set_by_hand}
            with write_beside(json) as fresh:
                fresh.write_text(json_format.dumps({**what, **setup, **as_record(result)}, indent=1) + "\n")
