"""An evaluation in one call: a policy by its name, and a table with a row for each episode."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from usarmjx.base.errors import UsageError
from usarmjx.base.settings import to_text
from usarmjx.engines import choose_engine
from usarmjx.train.evaluation.evaluate import as_record, evaluate_episodes
from usarmjx.train.policies.sources import PolicySource, baseline, load_policy
from usarmjx.train.task_names import policy_name


def evaluate(  # noqa: PLR0913 - all but the first may be left out
    policy: str | Path | None = None,
    *,
    task: str | None = None,
    checkpoint: str = "best",
    episodes: int | None = None,
    seeds: int = 1,
    seed: int = 0,
    worlds: int | None = None,
    engine: str = "auto",
    split: str | None = None,
    level: float | None = None,
    settings: Mapping[str, object] | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Any:  # noqa: ANN401 - pandas' DataFrame, or rows
    """Play whole episodes of a policy and return a row for each, as `usarmjx eval` plays them.

    Columns: `policy`, `task`, `split` (empty where arenas are not generated), `engine`, `seed`, `world`,
    `episode` (its number in that world), `building` (-1 where all worlds have one arena), `score` and
    `steps`. A data frame has the mean with its 95 % interval, the means of the seeds and the notes in
    `attrs["score"]`, `attrs["seeds"]` and `attrs["notes"]`.

    Args:
        policy: Folder of a run, exported file, or task of a packaged policy; None: the baseline of `task`.
        task: Task, if it is not the one that the policy is for.
        checkpoint: Checkpoint of a run: `best`, `last`, or the number of an iteration.
        episodes: Episodes of each seed, at least; None: 100, or as many in each generated arena.
        seeds: Number of seeds, from `seed` on.
        seed: First seed.
        worlds: Worlds at once; None: 20, or one for each generated arena.
        engine: Physics engine, see `make`.
        split: Split of generated arenas; None: `test`.
        level: Highest level of generated arenas, from 0 to 1; None: all levels alike.
        settings: Fields of the task to set otherwise, by name.
        tell: Receives a line after each step.

    Returns:
        pandas' DataFrame where that is installed, else a list of rows.

    Raises:
        UsageError: Neither a policy nor a task; see `PolicySource.env`.
        UnknownNameError: No such policy, task, split, engine or field; lists those there are.
    """
    source = _source(policy, task, checkpoint)
    pairs = [f"{name}={to_text(value)}" for name, value in (settings or {}).items()]
    split = split or source.usual_split(pairs)
    many, episodes = source.amount(pairs, split, worlds, episodes)
    engine = choose_engine(engine, "train")
    env, driver, notes = source.env(pairs, worlds=many, engine=engine, seed=seed, split=split)
    record = as_record(evaluate_episodes(env, driver, episodes, range(seed, seed + seeds), level, tell))
    name = policy_name(str(policy or source.name))
    same = {"policy": name, "task": source.task, "split": split or "", "engine": engine}
    rows: list[dict[str, Any]] = [{**same, **row} for row in record["episodes"]]
    try:
        import pandas as pd  # pyright: ignore[reportMissingTypeStubs]
    except ImportError:
        return rows
    frame = pd.DataFrame(rows)
    frame.attrs = {"score": record["score"], "seeds": record["seeds"], "notes": notes}
    return frame


def _source(policy: str | Path | None, task: str | None, checkpoint: str) -> PolicySource:
    if policy is None and task is None:
        raise UsageError("name a policy, or a task for its baseline")
    if policy is None:
        return baseline(str(task))
    found = load_policy(str(policy), checkpoint)
    return found if task is None else found.for_task(task)
