"""What policies score on several engines, as a table."""

import math
from collections.abc import Callable, Iterator, Sequence

from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.base.markdown import table_lines
from usarmjx.train.evaluation.evaluate import Evaluation, evaluate_episodes
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


def sources_of(tasks: Sequence[str]) -> Iterator[tuple[str, PolicySource]]:
    """Yield what plays: of each task its packaged policy, if there is one, and what is written by hand."""
    for task in tasks:
        if task in POLICIES:
            yield f"{task}, packaged policy", find_source(task)
        yield f"{task}, by hand", baseline(task)


def task_gap(
    engines: Sequence[str],
    sources: Iterator[tuple[str, PolicySource]],
    episodes: int,
    seeds: Sequence[int],
    worlds: int,
    tell: Callable[[str], None] = lambda text: None,
) -> Iterator[str]:
    """Return the lines of a table of scores in Markdown, row by row, each with the 95 % interval of its mean.

    Args:
        engines: On which.
        sources: Names and policies.
        episodes: Of each seed, at least.
        seeds: Seeds of the environments.
        worlds: How many at once.
        tell: Is told how far it is.
    """
    rows = ([name, *_cells(name, source, engines, episodes, seeds, worlds, tell)] for name, source in sources)
    return table_lines(("task, policy", *engines), rows)


def _cells(
    name: str,
    source: PolicySource,
    engines: Sequence[str],
    episodes: int,
    seeds: Sequence[int],
    worlds: int,
    tell: Callable[[str], None],
) -> Iterator[str]:
    for engine in engines:
        try:
            env, policy, _ = source.env(worlds=min(worlds, episodes), engine=engine, seed=seeds[0])
        except UnsupportedFeatureError as refused:
            tell(f"{name}: {refused}")
            yield "refused"
        else:
            yield told(evaluate_episodes(env, policy, episodes, seeds, tell=tell))


def told(found: Evaluation) -> str:
    """Return a score with its interval."""
    score = found.score
    if not math.isfinite(score.low):
        return f"{score.value:.3g}"
    return f"{score.value:.3g} ({score.low:.3g} to {score.high:.3g})"
