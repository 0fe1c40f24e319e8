"""What policies score on several engines, as a table."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeAlias

from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.base.markdown import table_lines
from usarmjx.train.evaluation.evaluate import Evaluation, evaluate_episodes, evaluation_of
from usarmjx.train.learning.record import load_record
from usarmjx.train.policies import POLICIES
from usarmjx.train.policies.sources import PolicySource, baseline, find_source

TASKS_TRIED = (
    "drive-to-goal",
    "wander",
    "explore",
    "relay-chain",
    "convoy",
    "hover-inspect",
    "victim-search",
    "soccer",
    "stairs",
)


Tried: TypeAlias = tuple[str, tuple[PolicySource, ...]]
"""What a row is of: its name, and a policy; or those of several runs that differ by their seeds only."""


def sources_of(named: Sequence[str]) -> Iterator[Tried]:
    """Yield what plays.

    Args:
        named: Tasks, of each of which its packaged policy plays, if there is one, and what is written by
            hand; and folders of runs. Runs of the same task, engine and fields of the task share a row.
    """
    runs: dict[tuple[str, str], list[PolicySource]] = {}
    for name in named:
        if Path(name).is_dir():
            record, found = load_record(Path(name)), find_source(name)
            fields = "".join(f", {key}={text}" for key, text in sorted(record.overrides.items()))
            runs.setdefault((record.task, f"trained on {record.engine}{fields}"), []).append(found)
            continue
        if name in POLICIES:
            yield f"{name}, packaged policy", (find_source(name),)
        yield f"{name}, by hand", (baseline(name),)
    for (task, how), found in runs.items():
        yield f"{task}, {how}{f', {len(found)} runs' if len(found) > 1 else ''}", tuple(found)


def task_gap(
    engines: Sequence[str],
    tried: Iterator[Tried],
    episodes: int,
    seeds: Sequence[int],
    worlds: int,
    split: str | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Iterator[str]:
    """Return the lines of a table of scores in Markdown, row by row, each with the 95 % interval of its mean.

    Args:
        engines: On which.
        tried: Names and policies.
        episodes: Of each seed and policy, at least.
        seeds: Seeds of the environments.
        worlds: How many at once.
        split: Of generated arenas, a name of `SPLITS`; None: the tasks' own.
        tell: Is told how far it is.
    """

    def cell(name: str, sources: Sequence[PolicySource], engine: str) -> str:
        try:
            env, _, _ = sources[0].env(
                worlds=min(worlds, episodes), engine=engine, seed=seeds[0], split=split
            )
        except UnsupportedFeatureError as refused:
            tell(f"{name}: {refused}")
            return "refused"
        return told([evaluate_episodes(env, one.policy(env), episodes, seeds, tell=tell) for one in sources])

    rows = ((name, *(cell(name, sources, engine) for engine in engines)) for name, sources in tried)
    return table_lines(("task, policy", *engines), rows)


def told(found: Sequence[Evaluation]) -> str:
    """Return the score of one policy, or of several together, with its interval; then that of each."""
    score = evaluation_of([run for one in found for run in one.episodes]).score
    each = f": {', '.join(f'{one.score.value:.3g}' for one in found)}" if len(found) > 1 else ""
    if not math.isfinite(score.low):
        return f"{score.value:.3g}{each}"
    return f"{score.value:.3g} ({score.low:.3g} to {score.high:.3g}){each}"
