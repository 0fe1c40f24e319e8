"""A league of past selves: ratings, opponents, whose actions count, and its table."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.base.errors import UsageError
from usarmjx.train.envs.state import AgentGroup
from usarmjx.train.envs.task import Policy
from usarmjx.train.evaluation.league_games import Games, against, league_table
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.league import (
    FIRST_RATING,
    Rivals,
    draw_opponents,
    expected_result,
    standings,
    update_league,
)
from usarmjx.train.learning.train_state import make_networks, make_train_state, policy_params

GROUP = AgentGroup("Player", ("a", "b", "c", "d"), 3, 2)
CONFIG = Config(league=2, hidden_sizes=(5,), critic_hidden_sizes=(5,), num_worlds=4, rollout_length=10)
TEAM = SimpleNamespace(task=SimpleNamespace(rivals=(2, 3)), name="duel")
BY_HAND = Policy(
    initial_carry=lambda worlds: (),
    act=lambda carry, obs, key: (carry, (jnp.full((*obs[0].shape[:2], 2), 0.25),)),
)
BASELINE, IDLE_ONES, ITSELF = 2, 3, 4
"""Numbers of these players where there are two places."""


@pytest.fixture(scope="module")
def train_state():
    return make_train_state(make_networks((GROUP,), 0, CONFIG), CONFIG)


def sums(**results):
    """Games, won and lost of player 0, 1, the baseline, and idle ones."""
    rows = {f"league/{name}/{player}": 0.0 for name in ("games", "won", "lost") for player in range(4)}
    for player, row in results.items():
        rows |= {f"league/{n}/{player[1:]}": x for n, x in zip(("games", "won", "lost"), row, strict=True)}
    return {name: jnp.float32(one) for name, one in rows.items()}


def test_elos_formula():
    """400 points are odds of ten to one; equal players share."""
    assert float(expected_result(jnp.float32(1400), jnp.float32(1000))) == pytest.approx(10 / 11)
    assert float(expected_result(jnp.float32(7), jnp.float32(7))) == 0.5


def test_ratings_move_by_surprise_and_the_baselines_stays(train_state):
    league = train_state.league.replace(since=jnp.array([0, -1]))
    after, stats = update_league(league, sums(p2=(4, 3, 1)), policy_params(train_state), jnp.int32(3), 100)
    assert float(after.rating) == pytest.approx(FIRST_RATING + 32 * (3 - 2) / 4)
    assert stats["league/baseline_won"] == 0.75
    np.testing.assert_array_equal(after.ratings, league.ratings)
    # A draw counts half: two of four points were expected, and two were made.
    after, _ = update_league(league, sums(p0=(4, 1, 1)), policy_params(train_state), jnp.int32(3), 100)
    assert float(after.rating) == float(after.ratings[0]) == FIRST_RATING
    # Goals against nobody are no proof.
    after, stats = update_league(league, sums(p3=(4, 4, 0)), policy_params(train_state), jnp.int32(3), 100)
    assert (float(after.rating), float(stats["league/idle_won"])) == (FIRST_RATING, 1.0)
    assert after.won.tolist() == [0, 0, 0, 4]
    # The past self loses the games that the policy wins.
    after, _ = update_league(league, sums(p0=(2, 2, 0)), policy_params(train_state), jnp.int32(3), 100)
    assert float(after.rating) - FIRST_RATING == FIRST_RATING - float(after.ratings[0]) == 16.0


def test_the_policy_takes_a_free_place_and_then_that_of_the_weakest(train_state):
    params, league = policy_params(train_state), train_state.league
    assert [row.player for row in standings(league)] == ["policy", "baseline", "idle"]
    later = jax.tree.map(lambda one: one + 1.0, params)
    for now in (20, 40):
        league, _ = update_league(league, sums(), later, jnp.int32(now), 20)
    assert sorted(league.since.tolist()) == [20, 40]
    league = league.replace(ratings=jnp.array([1100.0, 900.0]), games=jnp.array([5.0, 6.0, 7.0, 8.0]))
    kept, weak = int(league.since[0]), int(league.since[1])
    league, _ = update_league(league, sums(), params, jnp.int32(60), 20)
    assert league.since.tolist() == [kept, 60]
    assert weak not in league.since
    assert league.games.tolist() == [5.0, 0.0, 7.0, 8.0]
    for one, new, old in zip(*map(jax.tree.leaves, (league.pool, params, later)), strict=True):
        np.testing.assert_array_equal(one[1], new)
        np.testing.assert_array_equal(one[0], old)
    same, _ = update_league(league, sums(), later, jnp.int32(61), 20)
    assert same.since.tolist() == [kept, 60]


def test_opponents_are_drawn_by_their_shares(train_state):
    """4,000 draws: shares within 0.03, which is more than three standard deviations."""
    keys = jax.random.split(jax.random.key(0), 4000)
    mix, league = (0.05, 0.05, 0.2, 0.3, 0.4), train_state.league
    empty = np.bincount(draw_opponents(league, mix, keys), minlength=5) / 4000
    np.testing.assert_allclose(empty, [0, 0, 0.05, 0.05, 0.9], atol=0.03)
    league = league.replace(since=jnp.array([5, 9]), ratings=jnp.array([1200.0, 900.0]))
    shares = np.bincount(draw_opponents(league, mix, keys), minlength=5) / 4000
    np.testing.assert_allclose(shares, [0.3 + 0.2, 0.2, 0.05, 0.05, 0.2], atol=0.03)


def test_rivals_act_by_their_player_and_learn_only_from_games_with_itself(train_state):
    networks = make_networks((GROUP,), 0, CONFIG)
    rivals = Rivals(TEAM, networks.policy, CONFIG, BY_HAND)
    opponent = jnp.array([0, 1, BASELINE, ITSELF, IDLE_ONES])
    match = rivals.match(
        train_state.league, opponent, jnp.zeros(5, bool), jax.random.split(jax.random.key(1), 5)
    )
    np.testing.assert_array_equal(match.opponent, opponent)
    np.testing.assert_array_equal(match.learns, [[1, 1, own, own] for own in (0, 0, 0, 1, 0)])

    # Weights of 0 but for the biases of the outputs: means of 3 and -3, and hardly any deviation.
    def constant(mean):
        flat = jax.tree.map(jnp.zeros_like, policy_params(train_state))
        outputs = jnp.array([mean, mean, -20.0, -20.0])
        weights = jax.tree.map(lambda one: outputs if one.shape == (4,) else one, flat.weights)
        return flat.replace(weights=weights, std=(jnp.ones(3),))

    pool = jax.tree.map(lambda a, b: jnp.stack([a, b]), constant(3.0), constant(-3.0))
    league = train_state.league.replace(pool=pool)
    own = jnp.full((5, 4, 2), 0.5)
    acts = rivals.replace_actions(league, match, jnp.ones((5, 4, 3)), own, jax.random.key(2), jnp.arange(5))
    np.testing.assert_array_equal(acts[:, :2], 0.5)
    np.testing.assert_allclose(acts[0, 2:], 3.0, atol=0.1)
    np.testing.assert_allclose(acts[1, 2:], -3.0, atol=0.1)
    np.testing.assert_allclose(np.tanh(acts[2, 2:]), 0.25, atol=1e-6)
    np.testing.assert_array_equal(acts[3, 2:], 0.5)
    np.testing.assert_array_equal(acts[4, 2:], 0.0)


def test_only_whole_games_against_one_player_are_rated(train_state):
    """Place 1 was taken five iterations of ten steps ago: a game of 60 steps began against another one."""
    rivals = Rivals(TEAM, make_networks((GROUP,), 0, CONFIG).policy, CONFIG, BY_HAND)
    league = train_state.league.replace(since=jnp.array([-1, 5]))
    over, length = jnp.array([True, True, True, False]), jnp.array([50, 60, 60, 20])
    ended = over, length, jnp.array([1.0, 1.0, -1.0, 1.0])
    rows = rivals.results(league, jnp.array([1, 1, BASELINE, 1]), ended, jnp.int32(10))
    found = {name: np.asarray(one).astype(int).tolist() for name, one in rows.items() if np.any(one)}
    assert found == {
        "league/games/1": [1, 0, 0, 0],
        "league/won/1": [1, 0, 0, 0],
        "league/games/2": [0, 0, 1, 0],
        "league/lost/2": [0, 0, 1, 0],
    }


def test_a_league_needs_rivals():
    policy = make_networks((GROUP,), 0, CONFIG).policy
    with pytest.raises(UsageError, match="league is 2, but in maze no agents play against others"):
        Rivals(SimpleNamespace(task=SimpleNamespace(rivals=()), name="maze"), policy, CONFIG, BY_HAND)
    with pytest.raises(UsageError, match="baseline of duel has a memory"):
        Rivals(TEAM, policy, CONFIG, Policy(initial_carry=lambda worlds: jnp.zeros(worlds), act=BY_HAND.act))
    with pytest.raises(UsageError, match="expected five shares"):
        Config(league=2, league_mix=(0.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(UsageError, match="needs network=mlp and gru_size=0"):
        Config(league=2, gru_size=8)


def test_players_of_two_kinds_drive_their_own_robots_and_the_table_names_them(train_state):
    own = make_networks((GROUP,), 0, CONFIG).policy.as_policy(policy_params(train_state))
    both = against(own, BY_HAND, np.array([2, 3]))
    obs = (jnp.ones((2, 4, 3)),)
    _, (actions,) = both.act(both.initial_carry(2), obs, jax.random.key(0))
    np.testing.assert_array_equal(actions[:, 2:], 0.25)
    np.testing.assert_allclose(actions[:, :2], own.act(own.initial_carry(2), obs, None)[1][0][:, :2])
    lines = league_table(standings(train_state.league), {"baseline": Games(8, 5, 1, 0.5)}).splitlines()
    assert lines[0].startswith("| player | rating |")
    assert "| baseline | 1000 | 0 | 0 | 0 | 8 | 5 | 1 | 0.50 |" in lines
