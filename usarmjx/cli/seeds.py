"""`usarmjx train --seeds`: several seeds in one program."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from usarmjx.base.errors import UsageError
from usarmjx.base.settings import parse_assignments, read_file
from usarmjx.cli.startup_messages import announce, say, tried_on
from usarmjx.cli.train_plan import TrainOptions, plan_run, recorded_engine, stop_request

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env
    from usarmjx.train.learning.iterations import TrainResult

SET_FILE = "seeds.json"
"""`SET_FILE` of the trainer, whose module imports JAX."""
CURRICULUM = "curriculum"
"""Field of `Config`, whose module imports JAX."""


def trains_seeds(out: Path, count: int | None, resume: bool) -> bool:
    """Return whether several seeds are to be trained: a number of new ones, or those in the folder."""
    return count is not None or (resume and (out / SET_FILE).exists())


def check_alone(views: Mapping[str, bool], processes: int) -> None:
    """Refuse what goes with a single seed only.

    Args:
        views: Whether the run is to be shown, by option.
        processes: Number of processes.

    Raises:
        UsageError: Names it.
    """
    from usarmjx.train.learning.launch import process_info

    if processes > 1 or process_info(os.environ) is not None:
        raise UsageError("several seeds train in one process: leave out --processes, or --seeds")
    if shown := [name for name, wanted in views.items() if wanted]:
        raise UsageError(f"{shown[0]} shows a single seed: leave it out, or --seeds")


def check_curriculum(options: TrainOptions) -> None:
    """Refuse a curriculum, before JAX is imported; other values are refused where they are read.

    Args:
        options: The request.

    Raises:
        UsageError: Seeds that train together have no curriculum; or as `read_file`, `parse_assignments`.
    """
    data = {} if options.config is None else read_file(options.config).mapping()
    typed = parse_assignments(options.pairs, "--set").get(CURRICULUM)
    value = data[CURRICULUM].data if typed is None and CURRICULUM in data else typed
    try:
        share = float(str(value))
    except ValueError:
        return
    if 0 < share <= 1:
        raise UsageError(f"{CURRICULUM} is {share}: seeds that train together have none")


def run_seeds(task: str, options: TrainOptions, count: int | None, quiet: bool) -> None:
    """Train several seeds in this process, and print their scores.

    Args:
        task: Name of the task.
        options: The request; its seed is the first one.
        count: Number of seeds; None: those of the folder.
        quiet: Show no bar.

    Raises:
        UsageError: As `train_seeds`.
    """
    recorded = options.resume and options.engine == "auto"
    engine = tried_on(options.engine)
    if recorded:
        engine = next((recorded_engine(one.parent) for one in options.out.glob("seed-*/config.json")), engine)
    announce(f"building worlds for {task} ...", engines=[engine])
    from usarmjx.train.learning.processes import distributed_run

    with distributed_run():
        from usarmjx.train.learning.run_record import load_seeds, seed_folder
        from usarmjx.train.learning.seed_runs import train_seeds
        from usarmjx.train.make import make

        there = load_seeds(options.out) if options.resume else ()
        known = replace(options, out=seed_folder(options.out, there[0])) if there else options
        plan = plan_run(task, known)
        first = plan.config.seed
        seeds = there if there and count is None else tuple(range(first, first + (count or 1)))

        def worlds_of(count: int, first: int) -> "Env":
            given = {"worlds": count, "engine": plan.origin.engine, "seed": plan.config.seed, "first": first}
            return make(task, **given, **plan.overrides)

        with stop_request() as stop:
            results = train_seeds(
                worlds_of,
                plan.config,
                options.out,
                seeds,
                options.resume,
                origin=plan.origin,
                source=plan.source,
                progress=not quiet,
                stop=stop,
            )
    for result in results:
        typer.echo(result_line(result))
    if results[0].stopped:
        say(f"go on with: usarmjx train {task} --out {options.out} --resume")
        raise typer.Exit(128 + stop.number)


def result_line(result: "TrainResult") -> str:
    """Return the result of a run in a line."""
    score = result.last_metrics.get("score")
    shown = score if score is None else round(score, 3)
    return f"{result.agent_steps:,} agent steps, score {shown}: {result.run}"
