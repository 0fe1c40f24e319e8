"""League of past selves, in tasks where some agents play against the others.

The rivals stand idle, or are driven by the task's baseline, by the present policy itself, or by a past self:
each world draws one for each episode. Idle ones are no opponents, but from them agents learn to score. Only
in games against itself the rivals learn, too. At intervals the present policy joins the past selves, in place
of the weakest one. Elo's ratings follow from the games of the training; the baseline's stays at
`FIRST_RATING`, and all others are to be read against it.

Vinyals et al., "Grandmaster level in StarCraft II using multi-agent reinforcement learning" (2019).
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax.struct import PyTreeNode

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import Policy, Task
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.networks import LearnedPolicy, PolicyParams, fold_each, sample_actions

FIRST_RATING, SPREAD = 1000.0, 400.0
"""Rating of the baseline; difference at which one is expected to win ten times as often as it loses."""
RATING_STEP = 32.0
"""Points for a rollout of games that are all won where all were expected to be lost (Elo's K)."""
LARGEST_ACTION = 0.999
"""Largest action of a baseline, which is squashed as those of networks are."""
TABLE_FILE = "league.json"
RESULTS = ("games", "won", "lost")


class League(PyTreeNode, kw_only=True):
    """Past selves of a policy, and its results against them.

    Players are numbered: the places of past selves, then the baseline and idle rivals (`rivals` in all), and
    the policy.

    Attributes:
        pool: Policies of the past selves (size, ...).
        since: Iteration after which each joined (size,); -1: the place is free.
        ratings: Their ratings (size,).
        rating: That of the policy ().
        games: Games of the policy against each of them, the baseline, and idle rivals (rivals,).
        won: Those it won (rivals,).
        lost: Those it lost (rivals,).
    """

    pool: PolicyParams
    since: jax.Array
    ratings: jax.Array
    rating: jax.Array
    games: jax.Array
    won: jax.Array
    lost: jax.Array

    @property
    def size(self) -> int:
        """Number of places."""
        return self.since.shape[-1]


class Match(PyTreeNode, kw_only=True):
    """Games of all worlds.

    Attributes:
        opponent: Player that drives the rivals of each world (worlds,).
        learns: Which agents act by the policy that learns (worlds, agents).
    """

    opponent: jax.Array
    learns: jax.Array


def start_league(params: PolicyParams, size: int) -> League:
    """Return a league without past selves; `params` gives the shapes."""
    none = jnp.zeros(size + 2)
    return League(
        # Free places hold copies, too: a compiled update needs shapes that never change.
        pool=jax.tree.map(lambda one: jnp.stack([one] * size), params),
        since=jnp.full(size, -1, jnp.int32),
        ratings=jnp.full(size, FIRST_RATING),
        rating=jnp.float32(FIRST_RATING),
        games=none,
        won=none,
        lost=none,
    )


def expected_result(rating: jax.Array, other: jax.Array) -> jax.Array:
    """Return the expected result of a game, from 0 (lost) to 1 (won)."""
    return 1.0 / (1.0 + 10.0 ** ((other - rating) / SPREAD))


def draw_opponents(league: League, mix: tuple[float, ...], keys: jax.Array) -> jax.Array:
    """Return an opponent for each world (worlds,).

    Args:
        league: The league.
        mix: Shares of games, see `Config.league_mix`.
        keys: Keys of the worlds (worlds,).
    """
    there = league.since >= 0
    baseline, idle, itself = (jnp.int32(league.size + number) for number in range(3))
    # Free places have a rating, too, but no player.
    best = jnp.argmax(jnp.where(there, league.ratings, -jnp.inf))

    def draw(key: jax.Array) -> jax.Array:
        kind, one = jax.random.split(key)
        # Without past selves yet, it plays against itself.
        past = jax.random.categorical(one, jnp.where(there, 0.0, -1e9))
        past_selves = jnp.where(there.any(), jnp.stack([best, past]).astype(jnp.int32), itself)
        players = jnp.concatenate([jnp.stack([idle, baseline, itself]), past_selves])
        # The small number keeps a share of 0 from being the logarithm of 0.
        return players[jax.random.categorical(kind, jnp.log(jnp.asarray(mix) + 1e-12))]

    return jax.vmap(draw)(keys)


class Rivals:
    """Drivers of the rivals in a league.

    Args:
        env: The worlds.
        policy: Shapes of the policies.
        config: Settings.
        baseline: The task's baseline.

    Raises:
        UsageError: The task has no rivals, or its baseline remembers something.
    """

    def __init__(self, env: Env, policy: LearnedPolicy, config: Config, baseline: Policy) -> None:
        task: Task | None = getattr(env, "task", None)
        rows = () if task is None else task.rivals
        if not rows or len(policy.groups) != 1:
            raise UsageError(
                f"league is {config.league}, but in {env.name} no agents play against others: set league=0"
            )
        # Shapes only: the baseline's carry is not computed, and no device is touched.
        if jax.tree.leaves(jax.eval_shape(lambda: baseline.initial_carry(1))):
            raise UsageError(f"league is {config.league}, but the baseline of {env.name} has a memory")
        self.rows = np.array(rows)
        self.team = np.setdiff1d(np.arange(len(policy.groups[0].agents)), self.rows)
        self._policy, self._config, self._baseline = policy, config, baseline

    def match(self, league: League, opponent: jax.Array, is_first: jax.Array, keys: jax.Array) -> Match:
        """Return the games of now: worlds whose episode begins draw an opponent.

        Args:
            league: The league.
            opponent: Opponents so far (worlds,).
            is_first: Which episodes begin (worlds,).
            keys: Keys of the worlds (worlds,).
        """
        drawn = draw_opponents(league, self._config.league_mix, keys)
        # All worlds draw, as shapes are fixed; those amid an episode keep theirs.
        opponent = jnp.where(is_first, drawn, opponent)
        itself = opponent == league.size + 2
        agents = len(self.rows) + len(self.team)
        # Actions of others are not drawn from the policy: their ratio of probabilities means nothing to PPO.
        learns = jnp.ones((len(opponent), agents), bool).at[:, self.rows].set(itself[:, None])
        return Match(opponent=opponent, learns=learns)

    def replace_actions(
        self, league: League, match: Match, obs: jax.Array, raw: jax.Array, key: jax.Array, worlds: jax.Array
    ) -> jax.Array:
        """Return all agents' actions before they are squashed (worlds, agents, action_size).

        Args:
            league: The league.
            match: The games.
            obs: Observations (worlds, agents, obs_size).
            raw: Actions of the policy itself (worlds, agents, action_size).
            key: Key of the step.
            worlds: Numbers of the worlds (worlds,).
        """
        seen, policy = obs[:, self.rows], self._policy
        # Of no numbers: `Config` refuses a league of networks with a memory.
        carry = (jnp.zeros((*seen.shape[:2], 0)),)
        keys = fold_each(key, worlds)

        def sampled(params: PolicyParams) -> jax.Array:
            logits, _ = policy.distribution_params(params, (seen,), carry)
            return sample_actions(policy, logits, keys)[0]

        # All past selves look at all worlds, which costs less than weights for each world.
        past = jax.vmap(sampled)(league.pool)
        # Baseline, idle rivals and the policy itself are beyond the pool; their rows are replaced below.
        place = jnp.minimum(match.opponent, league.size - 1)
        theirs = past[place, jnp.arange(len(place))]
        # Without a carry: the constructor refuses a baseline that has one.
        baseline = self._baseline.act((), (seen,), key)[1][0]
        # The trajectory holds actions before tanh; its inverse is infinite at 1, hence the limit.
        baseline = jnp.arctanh(jnp.clip(baseline, -LARGEST_ACTION, LARGEST_ACTION))
        who = match.opponent[:, None, None]
        chosen = jnp.where(who == league.size, baseline, jnp.where(who == league.size + 1, 0.0, theirs))
        return raw.at[:, self.rows].set(jnp.where(who == league.size + 2, raw[:, self.rows], chosen))

    def results(
        self,
        league: League,
        opponent: jax.Array,
        ended: tuple[jax.Array, jax.Array, jax.Array],
        now: jax.Array,
    ) -> dict[str, jax.Array]:
        """Return games and results against each player (worlds,), by name.

        Args:
            league: The league.
            opponent: The opponents (worlds,).
            ended: Which games ended, after how many steps, and with which score (worlds,) each.
            now: Iteration ().
        """
        over, length, score = ended
        rows: dict[str, jax.Array] = {}
        steps = self._config.rollout_length * self._config.action_repeat
        for player in range(league.size + 2):
            game = over & (opponent == player)
            if player < league.size:  # a place that was taken during the game had two players
                game &= length <= (now - league.since[player]) * steps
            # A score above 0 is a victory of the policy's team, 0 a draw.
            for name, one in zip(RESULTS, (game, game & (score > 0), game & (score < 0)), strict=True):
                rows[f"league/{name}/{player}"] = one
        return rows


def update_league(
    league: League, sums: dict[str, jax.Array], params: PolicyParams, now: jax.Array, interval: int
) -> tuple[League, dict[str, jax.Array]]:
    """Return the league after an iteration, and what is worth knowing.

    Args:
        league: The league.
        sums: Sums of `Rivals.results` of all worlds.
        params: The policy after the iteration.
        now: Number of iterations so far ().
        interval: Iterations between two past selves.
    """
    games, won, lost = (
        jnp.stack([sums[f"league/{name}/{player}"] for player in range(league.size + 2)]) for name in RESULTS
    )
    # NaN without such a game; `metrics.summary` turns it into none.
    idle = won[-1] / games[-1]
    totals = {
        name: getattr(league, name) + one for name, one in zip(RESULTS, (games, won, lost), strict=True)
    }
    games, won, lost = games[:-1], won[:-1], lost[:-1]  # idle rivals are not rated
    # A draw counts half, as in Elo's system.
    points = won + (games - won - lost) / 2
    all_ratings = jnp.concatenate([league.ratings, jnp.full(1, FIRST_RATING)])
    surprise = points - games * expected_result(league.rating, all_ratings)
    # Divided by the number of games: a rollout of thousands moves the rating by at most one K.
    rating = league.rating + RATING_STEP * surprise.sum() / jnp.maximum(games.sum(), 1.0)
    # The baseline's stays: the others are measured by it.
    ratings = league.ratings - RATING_STEP * (surprise / jnp.maximum(games, 1.0))[:-1]
    league = league.replace(rating=rating, ratings=ratings, **totals)
    past = games[:-1].sum()
    stats = {
        "league/rating": rating,
        "league/best_past": jnp.where(league.since >= 0, ratings, -jnp.inf).max(),
        "league/idle_won": idle,
        "league/past": points[:-1].sum() / past,
        "league/baseline_games": games[-1],
        "league/baseline_won": won[-1] / games[-1],
        "league/baseline_lost": lost[-1] / games[-1],
    }
    return _with_policy(league, params, now, now % interval == 0), stats


def _with_policy(league: League, params: PolicyParams, now: jax.Array, due: jax.Array) -> League:
    """Return the league with the policy in a free place, or that of the weakest, where it is due ()."""
    # Minus infinity puts free places before the weakest player.
    place = jnp.argmin(jnp.where(league.since < 0, -jnp.inf, league.ratings))

    def put(old: jax.Array, new: jax.Array | float) -> jax.Array:
        return old.at[place].set(jnp.where(due, new, old[place]))

    return league.replace(
        pool=jax.tree.map(put, league.pool, params),
        since=put(league.since, now),
        ratings=put(league.ratings, league.rating),
        # The results were those of the player that leaves.
        **{name: put(getattr(league, name), 0.0) for name in RESULTS},
    )


class Standing(NamedTuple):
    """Line of a league's table.

    Attributes:
        player: `policy`, `baseline`, `idle`, or `after` and the iteration after which a past self joined.
        rating: Rating [Elo points]; None: it is not rated.
        games: Games of the policy against it.
        won: Those that the policy won.
        lost: Those that it lost.
        place: Its place among the past selves; None: it is none.
    """

    player: str
    rating: float | None
    games: int
    won: int
    lost: int
    place: int | None = None


def standings(league: League) -> list[Standing]:
    """Return a league's table, the strongest first."""
    known: Any = jax.device_get(league)
    results = np.stack([known.games, known.won, known.lost], -1).astype(int).tolist()
    rows = [
        Standing(
            "policy", float(known.rating), int(known.games.sum()), int(known.won.sum()), int(known.lost.sum())
        ),
        Standing("baseline", FIRST_RATING, *results[-2]),
        Standing("idle", None, *results[-1]),
    ]
    for place in np.flatnonzero(known.since >= 0).tolist():
        name = f"after {known.since[place]}"
        rows.append(Standing(name, float(known.ratings[place]), *results[place], place=place))
    # Idle rivals are not rated, and come last.
    return sorted(rows, key=lambda row: -row.rating if row.rating is not None else float("inf"))


def write_standings(folder: Path, iteration: int, league: League) -> None:
    """Write a league's table into the folder of a run.

    Raises:
        WriteError: It cannot be written.
    """
    rows = [dict(zip(Standing._fields, row, strict=True)) for row in standings(league)]
    content: Mapping[str, Any] = {"iteration": iteration, "players": rows}
    with atomic_write(folder / TABLE_FILE) as fresh:
        fresh.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
