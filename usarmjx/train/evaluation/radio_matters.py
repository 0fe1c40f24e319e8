"""Whether the radio matters in a task: a good policy with its radio, with a perfect one, and with none.

    python -m usarmjx.train.evaluation.radio_matters explore-v1 --worlds 12 --seeds 5 --engine c

With a perfect radio the policy's score must be higher, without messages lower, by 10 % of its score with the
task's own radio, and the 95 % intervals over the seeds must not overlap; and with its own radio at least 20 %
of the pairs of robots must have no link, counted over all steps.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from usarmjx.base import random
from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import CONFIDENCE
from usarmjx.base.files import atomic_write
from usarmjx.base.tables import markdown_table
from usarmjx.engines import choose_engine
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.recipe import TEST, GeneratedArenas
from usarmjx.train.envs.state import EnvState
from usarmjx.train.envs.task import TASKS
from usarmjx.train.make import build_env, make_task
from usarmjx.train.task_names import full_name, newest_name
from usarmjx.train.tasks.team import PERFECT_RADIO, TeamTask

GAIN, UNLINKED = 0.1, 0.2
"""Least gain by a radio, as a share of the score, and least share of pair-steps without a link."""
VARIANTS = ("perfect", "real", "none")


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A mean and where the true one lies with a probability of 95 % (Student's t: there are few seeds)."""

    mean: float
    low: float
    high: float


def interval(values: np.ndarray) -> Interval:
    """Return mean and 95 % interval of independent values (n,); of a single one, nothing is known.

    Raises:
        UsageError: No values.
    """
    values = np.asarray(values, float)
    if not values.size:
        raise UsageError("no episode ended well: nothing to take the mean of")
    mean = float(values.mean())
    if values.size == 1:
        return Interval(mean=mean, low=-np.inf, high=np.inf)
    scipy: Any = stats
    half = float(scipy.sem(values) * scipy.t.ppf((1 + CONFIDENCE) / 2, values.size - 1))
    return Interval(mean=mean, low=mean - half, high=mean + half)


@dataclass(frozen=True, kw_only=True)
class VariantResult:
    """One variant of a task.

    Attributes:
        name: One of `VARIANTS`.
        score: Over the seeds' means.
        seeds: Mean score of each seed.
        metrics: Means of the task's metrics at the ends of the episodes.
    """

    name: str
    score: Interval
    seeds: tuple[float, ...]
    metrics: dict[str, float]


def variants(task: TeamTask) -> dict[str, TeamTask]:
    """Return a task with a perfect radio, with its own, and with messages to nobody but the base."""
    # A score of reports to the base would be 0 without any talk, whatever the mates' radio is worth.
    quiet = replace(task, talk="base" if task.reports else "none")
    return {"perfect": replace(task, radio=PERFECT_RADIO), "real": task, "none": quiet}


def check_levels(arenas: GeneratedArenas, worlds: int) -> None:
    """Check that the worlds have all levels of generated arenas alike.

    Raises:
        UsageError: Worlds that are no multiple of the levels.
    """
    # A level with more worlds than the others would pull the mean score to its own.
    if worlds % len(arenas.levels):
        raise UsageError(f"{worlds} worlds for {len(arenas.levels)} levels of arenas: expected a multiple")


def check_whole(env: Env, state: EnvState) -> None:
    """Check that all episodes last to the end of their time.

    Raises:
        UsageError: Robots come, go or drop out, so that episodes may end early.
    """
    if state.alive is not None:
        raise UsageError(
            f"{env.name}: teams are compared over whole episodes, which end early where robots drop out or "
            "come later: leave these settings out, or use usarmjx eval"
        )


def few_arenas(task: TeamTask, worlds: int) -> TeamTask:
    """Return a task with as many generated arenas of split `test` as worlds, of all levels alike.

    Raises:
        UsageError: Worlds that are no multiple of the levels.
    """
    arena = task.arena
    if not isinstance(arena, GeneratedArenas):
        return task
    check_levels(arena, worlds)
    return replace(task, arena=replace(arena.of_split(TEST), count=worlds // len(arena.levels)))


def run_variant(env: Env, name: str, seed: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the scores of one episode of each world, and the metrics at its end; bad worlds left out.

    Raises:
        UsageError: See `check_whole`.
    """
    policy = BASELINES.get(name)(env)
    act, carry, state = jax.jit(policy.act), policy.initial_carry(env.worlds), env.reset(seed)
    check_whole(env, state)
    good, score, metrics = np.ones(env.worlds, bool), np.zeros(env.worlds), {}
    for step in range(env.episode_steps):
        carry, actions = act(carry, state.obs, jax.random.fold_in(random.key(seed), step))
        state = env.step(state, actions)
        # For good: a bad world starts anew, and the final score it keeps is of an episode that was cut short.
        good &= ~np.asarray(state.bad)
        # Those of the last step stay: there all episodes end, see `check_whole`.
        score = np.asarray(state.final_score)
        metrics = {key: np.asarray(value) for key, value in state.metrics.items()}
    return score[good], {key: value[good] for key, value in metrics.items()}


def measure(
    name: str,
    worlds: int,
    seeds: Sequence[int],
    engine: str = "auto",
    **overrides: object,
) -> tuple[VariantResult, ...]:
    """Return what the task's baseline scores in each variant.

    Args:
        name: Of the task.
        worlds: Episodes of each seed, one in each of as many arenas, which are the same for all seeds.
        seeds: The seeds.
        engine: See `make`.
        overrides: Fields of the task to set otherwise.

    Raises:
        UnknownNameError: No such task, or a field that it does not have.
        UsageError: A task without a radio; worlds that are no multiple of the levels of generated arenas.
    """
    name, team = full_name(name), make_task(name, **overrides)
    rows: list[VariantResult] = []
    if not isinstance(team, TeamTask):
        raise UsageError(f"{name} is no task for a team: its robots have no radio")
    for variant, task in variants(few_arenas(team, worlds)).items():
        env = build_env(task, worlds, name=name, engine=engine)
        runs = [run_variant(env, name, seed) for seed in seeds]
        # Over the seeds' means: episodes of one seed are not independent.
        means = [float(scores.mean()) for scores, _ in runs]
        ends = {key: float(np.mean([m[key].mean() for _, m in runs])) for key in runs[0][1]}
        rows.append(
            VariantResult(name=variant, score=interval(np.array(means)), seeds=tuple(means), metrics=ends)
        )
    return tuple(rows)


def check_results(rows: Sequence[VariantResult]) -> dict[str, bool]:
    """Return what of the check holds: see the module."""
    perfect, real, none = (next(row for row in rows if row.name == name) for name in VARIANTS)
    return {
        # The intervals must be apart, too: a gain of the means alone may be chance.
        "a perfect radio is worth it": perfect.score.mean >= (1 + GAIN) * real.score.mean
        and perfect.score.low > real.score.high,
        "no messages cost it": none.score.mean <= (1 - GAIN) * real.score.mean
        and none.score.high < real.score.low,
        "links are lost": real.metrics["unlinked"] >= UNLINKED,
    }


def table(rows: Sequence[VariantResult]) -> str:
    """Return the rows as a Markdown table."""
    names = list(rows[0].metrics)
    lines = list[Sequence[str]]()
    for row in rows:
        span = f"{row.score.low:.1f} to {row.score.high:.1f}"
        lines.append([row.name, f"{row.score.mean:.1f}", span, *(f"{row.metrics[key]:.2f}" for key in names)])
    return markdown_table(("radio", "score", "95 % interval", *names), lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print the table, and return 0 if the check holds."""
    names = [name for name, task in TASKS if isinstance(task, TeamTask)]
    parser = argparse.ArgumentParser(description="Whether the radio matters in a task.")
    parser.add_argument("task", type=newest_name, choices=names)
    parser.add_argument("--worlds", type=int, default=12, help="episodes of each seed, each in an arena")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--engine", default="auto")
    parser.add_argument("--steps", type=int, help="actions of an episode")
    parser.add_argument("--json", type=Path, help="file to write the rows to")
    options = parser.parse_args(arguments)
    engine = choose_engine(options.engine, "train")
    overrides = {} if options.steps is None else {"episode_steps": options.steps}
    rows = measure(
        options.task,
        options.worlds,
        range(options.seeds),
        engine,
        **overrides,
    )
    holds = check_results(rows)
    print(table(rows))
    print("\n".join(f"{what}: {'yes' if fits else 'no'}" for what, fits in holds.items()))
    if options.json:
        content = {"task": options.task, "rows": [vars(row) | {"score": vars(row.score)} for row in rows]}
        with atomic_write(options.json) as fresh:
            fresh.write_text(json.dumps(content | {"holds": holds}, indent=1), encoding="utf-8")
    return 0 if all(holds.values()) else 1


if __name__ == "__main__":
    raise SystemExit(main())
