"""A league: PPO against past selves, rated by Elo, where two teams play each other.

    python examples/marl/league.py --task soccer --engine warp --total-steps 200000000 --out runs/league-0
    usarmjx eval examples/marl/league.py:load@runs/league-0 --task soccer --set opponent=baseline

The first half of the agents learns, the other half is driven by a past self: each world draws one of the
pool for each episode. The pool gets the present policy every `--snapshot-interval` iterations, and loses its
oldest one when it is full.
The reward is the task's: that of soccer is shaped by the way of the ball and the nearest robot's way to it.
Networks and loss are those of ippo.py.

Vinyals et al., "Grandmaster level in StarCraft II using multi-agent reinforcement learning" (2019).
"""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import ippo
import jax
import jax.numpy as jnp
import marl_shared as shared

FIRST_RATING = 1000.0
SPREAD = 400.0
"""Difference in rating at which a policy is expected to win ten times as often as it loses [points]."""


@dataclass(frozen=True, kw_only=True)
class LeagueFlags(ippo.IppoFlags):
    """Flags of the league."""

    task: str = field(default="soccer", metadata={"help": "name of a task for two teams, or of a game"})
    pool: int = field(default=8, metadata={"help": "past selves that are kept"})
    snapshot_interval: int = field(default=20, metadata={"help": "iterations between two past selves"})
    rating_step: float = field(default=16.0, metadata={"help": "points of a rollout of wins (Elo's K)"})


class League(shared.Learner):
    """A learner and its past selves.

    Attributes:
        pool: Weights of these (pool, ...).
        ratings: Their ratings (pool,).
        rating: That of the learner ().
        kept: Number of past selves so far, those that have left too ().
        opponent: Which of them each world plays against (worlds,).
        iteration: Number of the iteration ().
    """

    pool: Any
    ratings: jax.Array
    rating: jax.Array
    kept: jax.Array
    opponent: jax.Array
    iteration: jax.Array


def expected(rating: jax.Array, other: jax.Array) -> jax.Array:
    """Return the expected result of a game, from 0 (lost) to 1 (won)."""
    return 1.0 / (1.0 + 10.0 ** ((other - rating) / SPREAD))


def rated(
    rating: jax.Array, ratings: jax.Array, games: tuple[jax.Array, jax.Array, jax.Array], step: float
) -> tuple[jax.Array, jax.Array]:
    """Return the ratings of learner () and pool (pool,) after games.

    Args:
        rating: The learner's before them.
        ratings: The pool's.
        games: Which places hold a game that ended, its result from 0 to 1, and its opponent (games,) each.
        step: Points of a learner that wins all games where it was expected to lose all.
    """
    ended, result, opponent = games
    surprise = jnp.where(ended, result - expected(rating, ratings[opponent]), 0.0)
    count = jnp.zeros_like(ratings).at[opponent].add(ended)
    gain = jnp.zeros_like(ratings).at[opponent].add(surprise)
    return rating + step * surprise.sum() / jnp.maximum(ended.sum(), 1), ratings - step * gain / jnp.maximum(
        count, 1
    )


def collect(
    team: shared.Team, net: Any, flags: LeagueFlags, league: League
) -> tuple[League, shared.Batch, jax.Array, dict[str, jax.Array]]:
    """Let the learner play against its past selves for a rollout; see `ippo.collect`."""
    half = team.agents // 2
    known = jnp.minimum(league.kept, flags.pool)

    def step(carry: tuple[Any, ...], _: None) -> tuple[Any, Any]:
        state, opponent, key = carry
        key, own, draw = jax.random.split(key, 3)
        obs = team.merge(state.obs)
        mean, log_std, value = net.apply(league.params, obs[:, :half])
        # All past selves look at all worlds, which is cheaper than weights for each world.
        theirs = jax.vmap(net.apply, (0, None))(league.pool, obs[:, half:])
        theirs = [one[opponent, jnp.arange(len(opponent))] for one in theirs[:2]]
        both = [jnp.concatenate(pair, 1) for pair in zip((mean, log_std), theirs, strict=True)]
        action = both[0] + jnp.exp(both[1]) * jax.random.normal(own, both[0].shape)
        after = team.env.step(state, team.split(action))
        cut = net.apply(league.params, team.merge(after.final_obs)[:, :half])[-1]
        reward = flags.reward_scale * team.reward(after)[:, :half]
        reward += flags.gamma * cut * after.truncated[:, None]
        row = shared.Batch(
            obs=obs[:, :half],
            action=action[:, :half],
            log_prob=shared.log_probability(mean, log_std, action[:, :half]),
            value=value,
            reward=reward,
            done=jnp.broadcast_to(after.done[:, None], reward.shape),
        )
        game = after.done & ~after.bad, (jnp.sign(after.final_score) + 1) / 2, opponent
        others = jax.random.randint(draw, opponent.shape, 0, known)
        return (after, jnp.where(after.done, others, opponent), key), (row, shared.episode_sums(after), game)

    start = league.state, league.opponent, league.key
    (state, opponent, key), (batch, sums, games) = jax.lax.scan(step, start, None, flags.rollout_length)
    *_, last = net.apply(league.params, team.merge(state.obs)[:, :half])
    flat = tuple(one.ravel() for one in games)
    rating, ratings = rated(league.rating, league.ratings, flat, flags.rating_step)
    league = league.replace(state=state, opponent=opponent, key=key, rating=rating, ratings=ratings)
    return league, batch, last, jax.tree.map(jnp.sum, sums)


def with_snapshot(flags: LeagueFlags, league: League) -> League:
    """Return the league after an iteration: with the present policy in the pool where that is due."""
    iteration = league.iteration + 1
    due, place = iteration % flags.snapshot_interval == 0, league.kept % flags.pool
    pool = jax.tree.map(
        lambda old, new: old.at[place].set(jnp.where(due, new, old[place])), league.pool, league.params
    )
    ratings = league.ratings.at[place].set(jnp.where(due, league.rating, league.ratings[place]))
    return league.replace(pool=pool, ratings=ratings, kept=league.kept + due, iteration=iteration)


def iterate(
    team: shared.Team, net: Any, flags: LeagueFlags, league: League
) -> tuple[League, dict[str, jax.Array]]:
    """Play for a rollout and learn from it."""
    league, batch, last, sums = collect(team, net, flags, league)
    advantage, target = shared.generalised_advantages(
        batch.reward, batch.value, last, batch.done, flags.gamma, flags.gae_lambda
    )
    rows = jax.tree.map(lambda one: one.reshape(-1, *one.shape[3:]), (batch, advantage, target))

    def minibatch_loss(params: Any, chosen: jax.Array) -> jax.Array:
        return ippo.loss(params, team, net, flags, jax.tree.map(lambda one: one[chosen], rows))

    league, total = shared.update_in_minibatches(
        league,
        shared.clipped_adam(flags),
        minibatch_loss,
        rows[1].shape[0],
        num_epochs=flags.num_epochs,
        num_minibatches=flags.num_minibatches,
    )
    league = with_snapshot(flags, league)
    best = jnp.where(jnp.arange(flags.pool) < league.kept, league.ratings, -jnp.inf).max()
    return league, {**sums, "total": total, "league/rating": league.rating, "league/best_past": best}


def train(flags: LeagueFlags, env: Any = None) -> tuple[League, list[dict[str, Any]]]:
    """Train, and return the last state and the lines of the iterations."""
    team = shared.Team(env or shared.make_env(flags))
    if team.agents % 2:
        raise SystemExit(f"--task: {flags.task} has {team.agents} agents, expected two teams of equal size")
    params = ippo.initial_params(team, flags)
    start = shared.start_learner(team, flags, params, shared.clipped_adam(flags))
    league = League(
        **vars(start),
        pool=jax.tree.map(lambda one: jnp.stack([one] * flags.pool), params),
        ratings=jnp.full(flags.pool, FIRST_RATING),
        rating=jnp.float32(FIRST_RATING),
        kept=jnp.int32(1),
        opponent=jnp.zeros(team.env.worlds, jnp.int32),
        iteration=jnp.int32(0),
    )
    step = jax.jit(partial(iterate, team, ippo.network(team, flags), flags))
    return shared.run(flags, "league", league, step, team.agents // 2)


policy_of = ippo.policy_of


def load(env: Any, folder: str) -> Any:
    """Return the policy of a run's folder, for `usarmjx eval` and `usarmjx suite`."""
    flags = shared.saved_flags(LeagueFlags, folder)
    return policy_of(env, flags, shared.saved_weights(ippo.initial_params(shared.Team(env), flags), folder))


if __name__ == "__main__":
    train(shared.parse(LeagueFlags, "PPO against past selves"))
