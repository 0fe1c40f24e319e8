"""`usarmjx eval`: how good a policy is."""

import json as json_format
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.progress import RateLimitedLog
from usarmjx.cli.common import (
    ErrorExit,
    PackagesOption,
    PiecesOption,
    SeedOption,
    TaskRobotOption,
    announce,
    ends_on_signals,
    named,
    say,
    tried_on,
    with_robot,
)
from usarmjx.cli.known_names import (
    GOAL_TEAM_WORDS,
    TEAM_WORDS,
    check_policy,
    complete_policies,
    complete_tasks,
)
from usarmjx.cli.setting_options import with_settings
from usarmjx.cli.task_options import (
    PolicyEngineOption,
    PolicyOptions,
    SplitOption,
    TaskConfigOption,
    TaskPrintOption,
    TaskSetOption,
    print_task,
    task_pairs,
)

if TYPE_CHECKING:
    from usarmjx.base.estimates import Estimate
    from usarmjx.train.evaluation.yardsticks import TeamResult


def teams(
    task: Annotated[
        str,
        typer.Argument(help="A task for a team.", autocompletion=complete_tasks, callback=named("task")),
    ],
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
        typer.Option(min=1, help="Episodes, each in a building of its own; 24, or each of a --split."),
    ] = None,
    seed: SeedOption = 0,
    engine: PolicyEngineOption = "auto",
    split: SplitOption = None,
    settings: TaskSetOption = None,
    config: TaskConfigOption = None,
    print_config: TaskPrintOption = False,
    robot: TaskRobotOption = None,
    packages: PackagesOption = None,
    pieces: PiecesOption = None,
    ablate: Annotated[
        bool,
        typer.Option(
            "--ablate",
            help="Play the packaged or the named teams with advice, goal, map, mates, news or messages taken "
            "away, as far as the task has them, and with a perfect radio.",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Draw finds over time, paths and messages of world 0, to this .png, .pdf, .svg or .eps, or "
            "as a film, .gif."
        ),
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write the rows to this file.")] = None,
) -> None:
    """Compare teams in the same buildings: parts of their scores, and times of their finds."""
    with ErrorExit(), ends_on_signals():
        for name in names or ():
            check_policy(name, (*TEAM_WORDS, *GOAL_TEAM_WORDS))
        pairs = task_pairs(task, with_robot(settings, robot), config)
        if print_config:
            print_task(task, {}, pairs)
            return
        announce("building the worlds that teams play in ...", engines=[tried_on(engine)])
        if ablate:
            if out is not None:
                raise UsageError("--out draws teams without --ablate; --json keeps the results of ablations")
            _ablate(task, names or ["packaged"], worlds, seed, engine, split, pairs, json)
        else:
            _compare(task, names, worlds, seed, engine, split, pairs, out, json)


def _compare(
    task: str,
    names: list[str] | None,
    worlds: int | None,
    seed: int,
    engine: str,
    split: str | None,
    pairs: list[str],
    out: Path | None,
    json: Path | None,
) -> None:
    """Play teams, print the table, write it and draw it."""
    from usarmjx.engines import choose_engine
    from usarmjx.plots.play import TeamWays, plot_teams
    from usarmjx.plots.style import check_figure
    from usarmjx.plots.team_film import FILM, film_teams
    from usarmjx.train.evaluation import yardsticks
    from usarmjx.train.policies.sources import task_settings, usual_split

    film = out is not None and out.suffix.lower() == FILM
    if out is not None and not film:
        check_figure(out)  # before minutes of play
    overrides, _ = task_settings(task, {}, pairs)
    played, seen = yardsticks.team_task(task, **overrides), TeamWays()
    # Each team once, in the order in which they are named.
    chosen = list(dict.fromkeys(names)) if names else None
    watch = yardsticks.ignore if out is None else seen
    how = (seed, choose_engine(engine, "train"), chosen, _tell, watch, split, _warn)
    rows = yardsticks.measure_teams(task, worlds, *how, **overrides)
    typer.echo(yardsticks.table(played, rows))
    if line := yardsticks.shares(rows):
        typer.echo(line)
    if json is not None:
        # The file names the split that was played, also where none was typed.
        split = split or usual_split(task, overrides)
        setup = {"task": task, "split": split, "engine": how[1], "settings": pairs}
        _keep(json, setup, [_plain(row) for row in rows])
    if out is not None:
        (film_teams if film else plot_teams)(task, rows, seen, out)
        typer.echo(f"wrote {out}")


def _ablate(
    task: str,
    names: list[str],
    worlds: int | None,
    seed: int,
    engine: str,
    split: str | None,
    pairs: list[str],
    json: Path | None,
) -> None:
    """Play teams with parts taken away, print the table, and write it to a file."""
    from usarmjx.engines import choose_engine
    from usarmjx.train.evaluation import ablation, yardsticks
    from usarmjx.train.policies.sources import task_settings, usual_split

    overrides, _ = task_settings(task, {}, pairs)
    engine = choose_engine(engine, "train")
    own, played = yardsticks.task_to_play(task, worlds, split, **overrides)
    rows = ablation.ablate(own, task, played, names, seed, engine, lambda row: _tell(row.result))
    typer.echo(ablation.ablation_table(rows))
    if json is not None:
        content = [
            {
                "team": one.team,
                "without": one.without,
                "difference": vars(one.difference),
                **_plain(one.result),
            }
            for one in rows
        ]
        setup = {"task": task, "split": split or usual_split(task, overrides), "settings": pairs}
        _keep(json, {**setup, "engine": engine}, content)


def _plain(row: "TeamResult") -> dict[str, Any]:
    """Return a row as JSON can hold it."""
    # JSON has no NaN.
    by_world = [value if math.isfinite(value) else None for value in row.by_world]
    return {**vars(row), "reached": row.reached, "score": vars(row.score), "by_world": by_world}


def _tell(row: "TeamResult") -> None:
    """Say what a team got as soon as it is known."""
    say(f"{row.name}: {row.score.value:.1f}")


def _warn(note: str) -> None:
    """Say that a policy plays buildings of its training."""
    say(f"warning: {note}")


def _keep(path: Path, setup: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    """Write the setup and the rows of a comparison as JSON."""
    with atomic_write(path) as fresh:
        fresh.write_text(json_format.dumps({**setup, "rows": rows}, indent=1) + "\n", encoding="utf-8")


def _told(one: "Estimate", what: str) -> str:
    """Return an estimate in words."""
    known = math.isfinite(one.low)
    interval = f"{one.low:.3f} to {one.high:.3f} by {one.method}" if known else "unknown"
    return f"{what} {one.value:.3f}, 95 % interval {interval}"


@with_settings
def evaluate_policy(
    driver: PolicyOptions,
    episodes: Annotated[
        int | None,
        typer.Option(min=1, help="Episodes of each seed, at least; 100, or as many in each generated arena."),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Number of seeds, from --seed on.")] = 1,
    worlds: Annotated[
        int | None,
        typer.Option(min=1, help="Worlds at once, each with as many episodes; 20, or one for each arena."),
    ] = None,
    engine: PolicyEngineOption = "auto",
    split: SplitOption = None,
    level: Annotated[
        float | None, typer.Option(min=0.0, max=1.0, help="Highest difficulty of generated arenas.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option(help="Write the result with every episode to this file.")
    ] = None,
) -> None:
    """Report a policy's mean final score with its 95 % interval."""
    with ErrorExit(), ends_on_signals():
        driver.check()
        if driver.print_config:
            driver.print_fields()
            return
        announce("building the worlds that the policy is tried in ...", engines=[tried_on(engine)])
        from usarmjx.engines import choose_engine
        from usarmjx.train.evaluation.evaluate import as_record, evaluate_episodes

        engine, found = choose_engine(engine, "train"), driver.source()
        split = split or found.usual_split(driver.pairs(found))
        many, episodes = driver.amount(found, split, worlds, episodes)
        env, policy = driver.env(found, many, engine, split)
        numbers = range(driver.seed, driver.seed + seeds)
        result = evaluate_episodes(env, policy, episodes, numbers, level, RateLimitedLog(say))
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
                "settings": driver.pairs(found),
            }
            with atomic_write(json) as fresh:
                fresh.write_text(json_format.dumps({**what, **setup, **as_record(result)}, indent=1) + "\n")
