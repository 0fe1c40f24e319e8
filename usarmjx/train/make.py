"""Environments by the name of their task."""

import math
from dataclasses import fields, replace

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.models.build.compose import Physics
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import Task
from usarmjx.train.own_tasks import find_task, full_name


def make_task(name: str, **overrides: object) -> Task:
    """Return a task with some of its fields set otherwise.

    Under other physics an action lasts as long as before, unless `repeat` is set too.

    Args:
        name: Of a registered one, or of one's own: `FILE.py:CLASS`, `MODULE:CLASS`.
        overrides: Fields of the task.

    Raises:
        UnknownNameError: No such task, or a field that it does not have; lists those there are.
        UsageError: An own one that cannot be imported, or physics of which no number of control steps lasts
            as long as an action; says why.
    """
    task = find_task(name)
    known = sorted(field.name for field in fields(task))
    if bad := sorted(set(overrides) - set(known)):
        raise UnknownNameError(f"task {name} has no field {', '.join(bad)}; it has: {', '.join(known)}")
    chosen = replace(task, **overrides)
    if "physics" not in overrides or "repeat" in overrides:
        return chosen
    return replace(chosen, repeat=_steps_per_action(name, task, chosen.physics_settings))


def _steps_per_action(name: str, task: Task, physics: Physics) -> int:
    """Return how many control steps of some physics last as long as an action of a task does."""
    lasts = task.repeat * task.physics_settings.period
    steps = round(lasts / physics.period)
    if not math.isclose(steps * physics.period, lasts, rel_tol=1e-6):
        raise UsageError(
            f"an action of {name} lasts {lasts:g} s, which is no whole number of control steps of "
            f"{physics.period:g} s: set repeat, the control steps of an action, beside physics"
        )
    return steps


def make(
    name: str,
    worlds: int = 1,
    engine: str = "auto",
    seed: int = 0,
    first: int = 0,
    **overrides: object,
) -> Env:
    """Return the environment of a task, as `make("drive-to-goal", worlds=64, engine="c", arena="maze")`.

    Args:
        name: Of the task, case ignored; or of one's own, as `my_task.py:MyTask`.
        worlds: How many.
        engine: `warp`, `jax`, `c`, or `auto`.
        seed: Of all random numbers, unless `reset` is given another.
        first: Number of the first world. World k is the same alone as in a batch.
        overrides: Fields of the task to set otherwise; see `Task` and the task's own.

    Raises:
        UnknownNameError: No such task, or a field that it does not have; lists those there are.
        UsageError: A scene that cannot be built, or not run on this engine.
    """
    return Env(
        make_task(name, **overrides), worlds, name=full_name(name), engine=engine, seed=seed, first=first
    )
