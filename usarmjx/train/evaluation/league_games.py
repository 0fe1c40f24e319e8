"""Games of a run's policy against its league: its past selves, and the baseline of its task."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.tables import markdown_table
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.task import Carry, Policy
from usarmjx.train.evaluation.evaluate import run_episodes
from usarmjx.train.learning.checkpoint import load_train_state
from usarmjx.train.learning.config import load_seeds, seed_folder
from usarmjx.train.learning.league import League, Standing, standings
from usarmjx.train.learning.train_state import Networks, TrainState, policy_params
from usarmjx.train.make import make
from usarmjx.train.policies.sources import task_settings


class Games(NamedTuple):
    """Games of the policy against one player, each of one episode.

    Attributes:
        games: Number of games.
        won: Those that the policy won.
        lost: Those that it lost.
        score: Mean score of the policy.
    """

    games: int
    won: int
    lost: int
    score: float


def _stay(carry: Carry, obs: tuple[jax.Array, ...], key: jax.Array) -> tuple[Carry, tuple[jax.Array, ...]]:
    del key
    return carry, (jnp.zeros((*obs[0].shape[:2], 2)),)


IDLE = Policy(initial_carry=lambda worlds: (), act=_stay)
"""Policy of robots with two wheels that stand."""


def runs_in(folder: Path) -> list[Path]:
    """Return the run of a folder, or those of the seeds that train together there."""
    return [seed_folder(folder, seed) for seed in load_seeds(folder)] or [folder]


def load_league(run: Path) -> tuple[Networks, TrainState, League, str, dict[str, str]]:
    """Return networks, train state, league, task and the task's fields of a run's last checkpoint.

    Raises:
        UsageError: No run, or one without a league.
    """
    networks, train_state, record = load_train_state(run, "last")
    if train_state.league is None:
        raise UsageError(f"{run} has no league: its setting league is 0")
    return networks, train_state, train_state.league, record.task, record.overrides


def against(own: Policy, other: Policy, rivals: np.ndarray) -> Policy:
    """Return the policy of all agents of the only group: one drives the rivals, by index, one the others."""

    def begin(worlds: int) -> Carry:
        return own.initial_carry(worlds), other.initial_carry(worlds)

    def act(carry: Carry, obs: tuple[jax.Array, ...], key: jax.Array) -> tuple[Carry, tuple[jax.Array, ...]]:
        mine, (actions,) = own.act(carry[0], obs, key)
        # Both act for all agents, as their networks have the shapes of the whole group.
        theirs, (others,) = other.act(carry[1], obs, key)
        return (mine, theirs), (actions.at[:, rivals].set(others[:, rivals]),)

    return Policy(initial_carry=begin, act=act)


def play_league(
    run: Path, worlds: int, seed: int, engine: str, tell: Callable[[str], None] = lambda text: None
) -> dict[str, Games]:
    """Return the games of a run's last policy against the players of its league, by their names.

    All take their most probable actions, and each plays in the same worlds.

    Args:
        run: Folder of the run.
        worlds: Games against each.
        seed: Seed of the worlds.
        engine: Engine.
        tell: Receives a line about progress.

    Raises:
        UsageError: See `load_league`.
    """
    networks, train_state, league, task, trained = load_league(run)
    fields, _ = task_settings(task, trained, [])
    env = make(task, worlds=worlds, engine=engine, seed=seed, **fields)
    rivals, own = np.array(env.task.rivals), networks.policy.as_policy(policy_params(train_state))
    found: dict[str, Games] = {}
    for row in standings(league):
        # Against itself its games come out even, whatever it has learned.
        if row.player == "policy":
            continue
        if row.place is not None:
            other = _past_self(networks, league, row.place)
        else:
            other = IDLE if row.player == "idle" else BASELINES.get(env.name)(env)
        scores = run_episodes(env, against(own, other, rivals), worlds, seed, tell=tell).scores
        won, lost = int((scores > 0).sum()), int((scores < 0).sum())
        found[row.player] = Games(len(scores), won, lost, float(np.mean(scores)))
    return found


def _past_self(networks: Networks, league: League, place: int) -> Policy:
    return networks.policy.as_policy(jax.tree.map(lambda one: one[place], league.pool))


def league_table(rows: list[Standing], played: dict[str, Games]) -> str:
    """Return a league as a Markdown table: ratings and games of the training, and games played since."""
    heads = ["player", "rating", "games in training", "won", "lost", *(("played", "won", "lost", "score"))]

    def cells(row: Standing) -> list[str]:
        now = played.get(row.player)
        ours = [str(row.games), str(row.won), str(row.lost)]
        more = [str(now.games), str(now.won), str(now.lost), f"{now.score:.2f}"] if now else [""] * 4
        rating = "" if row.rating is None else f"{row.rating:.0f}"
        return [row.player, rating, *ours, *more]

    # Without games only the columns of the training are filled.
    width = len(heads) if played else 5
    return markdown_table(heads[:width], [cells(row)[:width] for row in rows])
