"""How good a policy is: the scores of whole episodes, their mean and how sure that is."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np
from scipy import stats

from usarmjx.base.errors import UsageError
from usarmjx.sim.batch import select_worlds
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.policy import Policy

CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True)
class Episodes:
    """Whole episodes of one seed, those whose physics went wrong left out.

    Attributes:
        seed: Of the environment.
        scores: Their final scores (episodes,).
        lengths: Their steps (episodes,).
        worlds: Where they took place (episodes,).
        episode_index: How many episodes there had been in that world before (episodes,).
        bad: How many were left out.
    """

    seed: int
    scores: np.ndarray
    lengths: np.ndarray
    worlds: np.ndarray
    episode_index: np.ndarray
    bad: int


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A mean and where the true one lies with a probability of 95 % (Student's t)."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """What came of an evaluation.

    Attributes:
        score: Mean score: over the seeds' means if there are several, else over the episodes.
        episodes: The episodes of each seed.
        seed_scores: Of each seed, over its episodes.
    """

    score: Interval
    episodes: tuple[Episodes, ...]
    seed_scores: tuple[Interval, ...]


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
    half = float(stats.sem(values) * stats.t.ppf((1 + CONFIDENCE) / 2, values.size - 1))
    return Interval(mean=mean, low=mean - half, high=mean + half)


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
        episodes: How many at least: rounded up to a multiple of the worlds.
        seed: Of the environment and of the policy's random numbers.
        level: How difficult generated arenas are at most, from 0 to 1; None: any.
        tell: Is told after each step how far it is.

    Raises:
        UsageError: No episodes asked for.
    """
    if episodes < 1:
        raise UsageError(f"{episodes} episodes, expected at least 1")
    each = -(-episodes // env.worlds)
    act, begin = jax.jit(policy.act), policy.initial_carry(env.worlds)
    state = env.reset(seed) if level is None else env.reset(seed, level)
    carry, key = begin, jax.random.key(seed)
    ended, length, step, bad = np.zeros(env.worlds, int), np.zeros(env.worlds, int), 0, 0
    rows: list[tuple[Any, ...]] = []  # of each episode: score, length, world, index
    while (ended < each).any():
        carry, actions = act(carry, state.obs, jax.random.fold_in(key, step))
        state = env.step(state, actions)
        step, length = step + 1, length + 1
        tell(f"seed {seed}: {np.minimum(ended, each).sum()} of {each * env.worlds} episodes, step {step}")
        done = np.asarray(state.done)
        if not done.any():
            continue
        carry = jax.tree.map(partial(select_worlds, state.done), begin, carry)
        counts, wrong = done & (ended < each), np.asarray(state.bad)
        here = np.flatnonzero(counts & ~wrong)
        rows += zip(np.asarray(state.final_score)[here], length[here], here, ended[here], strict=True)
        bad += int((counts & wrong).sum())
        ended, length = ended + done, np.where(done, 0, length)
    scores, lengths, worlds, index = np.array(rows, float).reshape(-1, 4).T
    counts = {"lengths": lengths, "worlds": worlds, "episode_index": index}
    return Episodes(seed=seed, scores=scores, bad=bad, **{k: v.astype(int) for k, v in counts.items()})


def evaluate_episodes(
    env: Env,
    policy: Policy,
    episodes: int = 100,
    seeds: Sequence[int] = (0,),
    level: float | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Evaluation:
    """Return what a policy scores in so many episodes of each seed; see `run_episodes`.

    Raises:
        UsageError: No seeds or episodes, or none of a seed's ended well.
    """
    if not seeds:
        raise UsageError("an evaluation needs at least one seed")
    runs = tuple(run_episodes(env, policy, episodes, seed, level, tell) for seed in seeds)
    rows = tuple(interval(run.scores) for run in runs)
    score = rows[0] if len(rows) == 1 else interval(np.array([row.mean for row in rows]))
    return Evaluation(score=score, episodes=runs, seed_scores=rows)


def as_record(found: Evaluation) -> dict[str, Any]:
    """Return an evaluation as JSON can hold it: an interval that nothing is known of has no `low` and `high`.

    `episodes` has a row for each: with the same seed, worlds and engine, the same episode comes again.
    """
    seeds = zip(found.episodes, found.seed_scores, strict=True)
    return {
        "score": _plain(found.score),
        "seeds": [{"seed": run.seed, "bad": run.bad, **_plain(row)} for run, row in seeds],
        "episodes": [row for run in found.episodes for row in _rows(run)],
    }


def _rows(run: Episodes) -> list[dict[str, Any]]:
    columns = {"world": run.worlds, "episode": run.episode_index, "score": run.scores, "steps": run.lengths}
    values = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [{"seed": run.seed, **dict(zip(columns, row, strict=True))} for row in values]


def _plain(one: Interval) -> dict[str, float | None]:
    return {name: value if np.isfinite(value) else None for name, value in vars(one).items()}
