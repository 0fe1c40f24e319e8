"""Evaluation of a policy: the scores of whole episodes, their mean and how sure that is."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from usarmjx.base import random
from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import Estimate, estimate_groups, estimate_middle
from usarmjx.base.settings import to_text
from usarmjx.engines import choose_engine
from usarmjx.sim.batch import select_worlds
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.presence import carry_of_alive
from usarmjx.train.envs.task import Policy
from usarmjx.train.policies.sources import PolicySource, baseline, load_policy
from usarmjx.train.task_names import policy_name


@dataclass(frozen=True, kw_only=True)
class Episodes:
    """Whole episodes of one seed, those whose physics went wrong left out.

    Attributes:
        seed: Seed of the environment.
        scores: Their final scores (episodes,).
        lengths: Their steps (episodes,).
        worlds: Their arenas (episodes,).
        episode_index: Number of episodes in that world before (episodes,).
        bad: Number left out.
        buildings: Arena of each, by number; if all have one, a number for each
            (episodes,).
        levels: Level of each building (episodes,).
    """

    seed: int
    scores: np.ndarray
    lengths: np.ndarray
    worlds: np.ndarray
    episode_index: np.ndarray
    bad: int
    buildings: np.ndarray | None = None
    levels: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Result of an evaluation.

    Attributes:
        score: Mean score of all episodes; where each is 0 or 1 a share, with Wilson's interval. Episodes in
            one building are drawn together, whatever their seeds.
        episodes: The episodes of each seed.
        seed_scores: Of each seed, over its episodes.
        over_seeds: Interquartile mean of the seeds' means.
    """

    score: Estimate
    episodes: tuple[Episodes, ...]
    seed_scores: tuple[Estimate, ...]
    over_seeds: Estimate


def run_episodes(
    env: Env,
    policy: Policy,
    episodes: int,
    seed: int = 0,
    level: float | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Episodes:
    """Return whole episodes of a policy: as many of each world, so that short ones do not count more often.

    Args:
        env: The environment.
        policy: The policy.
        episodes: Least number, rounded up to a multiple of the worlds.
        seed: Of the environment and of the policy's random numbers.
        level: Greatest difficulty of generated arenas, from 0 to 1; None: of all levels alike.
        tell: Receives after each step how far it is.

    Raises:
        UsageError: No episodes asked for.
    """
    if episodes < 1:
        raise UsageError(f"{episodes} episodes, expected at least 1")
    return play_episodes(env, replace(policy, act=jax.jit(policy.act)), episodes, seed, level, tell)


def play_episodes(
    env: Env,
    policy: Policy,
    episodes: int,
    seed: int = 0,
    level: float | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Episodes:
    """Return the same as `run_episodes`, of a policy that is compiled already."""
    each, act, begin = -(-episodes // env.worlds), policy.act, policy.initial_carry(env.worlds)
    if level is None and not getattr(env, "is_evenly_spread", True):  # environments of one's own need it not
        state = env.reset(seed, mixed=True)  # else few worlds would meet the easy arenas only
    else:
        state = env.reset(seed) if level is None else env.reset(seed, level)
    carry, key = begin, random.key(seed)
    ended, length, step, bad = np.zeros(env.worlds, int), np.zeros(env.worlds, int), 0, 0
    rows: list[tuple[Any, ...]] = []  # of each episode: score, length, world, index, building
    serials = _serials(state)
    while (ended < each).any():
        carry, actions = act(carry, state.obs, jax.random.fold_in(key, step))
        before, state = getattr(state, "alive", None), env.step(state, actions)
        # A robot that joins must not go on with the memory of the one before it in its row.
        carry = carry_of_alive(carry, before, getattr(state, "alive", None))
        step, length = step + 1, length + 1
        tell(f"seed {seed}: {np.minimum(ended, each).sum()} of {each * env.worlds} episodes, step {step}")
        done = np.asarray(state.done)
        # Scores and arenas leave the device only when an episode has ended.
        if not done.any():
            continue
        # New episodes begin without memory, as in training.
        carry = jax.tree.map(partial(select_worlds, state.done), begin, carry)
        # Worlds whose episodes are short play on until the last world has enough; their further ones do not
        # count.
        counts, wrong = done & (ended < each), np.asarray(state.bad)
        here = np.flatnonzero(counts & ~wrong)
        # Negative numbers, each once: without a library every episode is a building of its own.
        where = -1 - np.arange(len(rows), len(rows) + len(here)) if serials is None else serials[here]
        rows += zip(np.asarray(state.final_score)[here], length[here], here, ended[here], where, strict=True)
        serials = _serials(state)  # of the episodes that have begun
        bad += int((counts & wrong).sum())
        ended, length = ended + done, np.where(done, 0, length)
    # The shape for no rows at all: every episode may have failed.
    scores, lengths, worlds, index, places = np.array(rows, float).reshape(-1, 5).T
    counts = {"lengths": lengths, "worlds": worlds, "episode_index": index, "buildings": places}
    found = {name: column.astype(int) for name, column in counts.items()}
    return Episodes(seed=seed, scores=scores, bad=bad, levels=_levels(env, found["buildings"]), **found)


def _serials(state: Any) -> np.ndarray | None:  # noqa: ANN401 - of environments of one's own, too
    """Return the number of the arena of each world (worlds,); None: they have one."""
    worlds = getattr(getattr(state, "batch", None), "worlds", None)
    arenas = getattr(worlds, "arena_state", None)
    return None if arenas is None else np.asarray(arenas.serial)


def _levels(env: Env, buildings: np.ndarray) -> np.ndarray:
    """Return the level of each building (episodes,): a library has those of one level in a row."""
    levels = len(getattr(env, "levels", ()))
    library = env.scene.arenas if levels > 1 else None
    return buildings * 0 if library is None else buildings // max(len(library.arenas) // levels, 1)


def evaluate_episodes(
    env: Env,
    policy: Policy,
    episodes: int = 100,
    seeds: Sequence[int] = (0,),
    level: float | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Evaluation:
    """Return scores of a policy in episodes of each seed; see `run_episodes`.

    Raises:
        UsageError: No seeds or episodes, or none of a seed's ended well.
    """
    if not seeds:
        raise UsageError("an evaluation needs at least one seed")
    runs = tuple(run_episodes(env, policy, episodes, seed, level, tell) for seed in seeds)
    return evaluation_of(runs)


def evaluation_of(runs: Sequence[Episodes]) -> Evaluation:
    """Return what came of episodes, those of each seed by themselves and all together.

    Raises:
        UsageError: None of a seed's ended well.
    """
    strata = [run.scores for run in runs]
    if not all(len(scores) for scores in strata):
        raise UsageError("no episode ended well: nothing to take the mean of")
    means = np.array([scores.mean() for scores in strata])
    return Evaluation(
        score=_score_of(runs),
        episodes=tuple(runs),
        seed_scores=tuple(_score_of([run]) for run in runs),
        over_seeds=estimate_middle(means),
    )


def pooled_score(found: Sequence[Evaluation]) -> Estimate:
    """Return the mean score of all episodes of several policies.

    The interval is of these policies: it holds the doubt about buildings and episodes, not about what further
    trainings would give.
    """
    policies = [number for number, one in enumerate(found) for _ in one.episodes]
    return _score_of([run for one in found for run in one.episodes], policies)


def _score_of(runs: Sequence[Episodes], policies: Sequence[int] | None = None) -> Estimate:
    """Return the mean score of all episodes; those in one building are drawn together.

    Args:
        runs: The episodes.
        policies: Number of the policy of each run (runs,); None: there is one.
    """
    scores = np.concatenate([run.scores for run in runs])
    of_run = [0] * len(runs) if policies is None else policies
    places: list[str] = []
    strata: list[str] = []
    for number, run in enumerate(runs):
        for episode in range(len(run.scores)):
            building = -1 if run.buildings is None else run.buildings[episode]
            # As text, since numbers and pairs must not compare.
            places.append(repr((number, episode) if building < 0 else building))
            strata.append(repr((of_run[number], 0 if run.levels is None else run.levels[episode])))
    return estimate_groups(scores, places, strata, shares=True)


def as_record(found: Evaluation) -> dict[str, Any]:
    """Return an evaluation as JSON can hold it: an interval that nothing is known of has no `low` and `high`.

    `episodes` has a row for each: with the same seed, worlds and engine, the same episode comes again.
    """
    seeds = zip(found.episodes, found.seed_scores, strict=True)
    return {
        "score": _plain(found.score),
        "seeds": [{"seed": run.seed, "bad": run.bad, **_plain(row)} for run, row in seeds],
        "interquartile_mean": _plain(found.over_seeds),
        "episodes": [row for run in found.episodes for row in _rows(run)],
    }


def _rows(run: Episodes) -> list[dict[str, Any]]:
    columns = {"world": run.worlds, "episode": run.episode_index, "score": run.scores, "steps": run.lengths}
    if run.buildings is not None:
        # The negative numbers tell nothing: they only kept episodes apart.
        columns["building"] = np.maximum(run.buildings, -1)
    values = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [{"seed": run.seed, **dict(zip(columns, row, strict=True))} for row in values]


def _plain(one: Estimate) -> dict[str, Any]:
    # JSON has no infinity, which the interval of a single value has.
    low, high = (end if np.isfinite(end) else None for end in (one.low, one.high))
    return {"mean": one.value, "low": low, "high": high, "method": one.method}


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
