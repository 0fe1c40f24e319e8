"""The algorithms of examples/marl learn games whose best score is known: a few updates each.

Scores are those of exploring actions, so they stay a little below those of the policy.
"""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import usarmjx
from tests.scripts import EXAMPLES, load
from tests.train.choice_toys import CHOICES, ChoiceToy, WhisperToy
from usarmjx.base.errors import UsageError
from usarmjx.train.evaluation.evaluate import play_episodes
from usarmjx.train.learning.metrics import read_lines
from usarmjx.train.policies.sources import load_policy, own_policy
from usarmjx.train.tasks import Buildings

FOLDER = EXAMPLES / "marl"
SHARED, GAMES = load("marl/marl_shared"), load("marl/marl_games")


class ChoiceGame(ChoiceToy):
    """`ChoiceToy` with two agents."""

    agents = 2


class VectorGame(WhisperToy):
    """`WhisperToy`: two agents send each other what to choose."""

    agents = 2


class DeafGame(VectorGame):
    """Vectors do not arrive."""

    def __init__(self, *args):
        super().__init__(*args, deaf=True)


load("marl/ippo")  # which attention.py imports
WORLDS, LENGTH = 64, 8
ALL = {**GAMES.GAMES, "choices": ChoiceGame, "vectors": VectorGame, "deaf": DeafGame}


def flags_of(module):
    """Class of the flags of an algorithm."""
    kinds = (one for one in vars(module).values() if isinstance(one, type))
    return next(one for one in kinds if one.__name__.endswith("Flags"))


def learn(name, game, iterations=14, **more):
    """Train on a game; return the module, the flags, the last weights and the lines."""
    module, env = load(f"marl/{name}"), ALL[game](WORLDS)
    kind = flags_of(module)
    steps = WORLDS * LENGTH * env.agents * iterations
    usual = {"num_worlds": WORLDS, "rollout_length": LENGTH, "hidden": 16, "learning_rate": 1e-2}
    flags = kind(**{**usual, "task": game, "total_steps": steps, **more})
    state, lines = module.train(flags, env)
    return module, flags, state.params, lines


def score(module, flags, params, env):
    """Return the score of a policy's own actions, without exploration."""
    found = play_episodes(env, _jitted(module.policy_of(env, flags, params)), env.worlds)
    return found.scores.mean()


def _jitted(policy):
    return type(policy)(policy.initial_carry, jax.jit(policy.act))


@pytest.mark.every_run("ippo")
@pytest.mark.parametrize(
    ("name", "game", "best", "more"),
    [
        pytest.param("ippo", "match", 1.0, {}, id="ippo"),
        pytest.param("mappo", "match", 1.0, {}, id="mappo"),
        pytest.param("ippo_rnn", "recall", 1.0, {"iterations": 20}, id="ippo-rnn"),
        pytest.param("pqn_vdn", "match", 1.0, {"levels": 11, "iterations": 20}, id="pqn-vdn"),
        pytest.param(
            "fast_td3",
            "match",
            1.0,
            {"buffer_steps": 64, "batch_size": 256, "gamma": 0.5, "iterations": 20},
            id="fast-td3",
        ),
    ],
)
def test_an_algorithm_reaches_the_best_score_of_a_game(name, game, best, more):
    """Blind agents reach 0.36, agents without memory 0.52 in `recall`: 0.9 takes sight and memory."""
    module, flags, params, lines = learn(name, game, **more)
    env = GAMES.GAMES[game](WORLDS)
    assert lines[0]["score"] < 0.6
    assert 0.9 * best < score(module, flags, params, env) <= best + 1e-6


@pytest.mark.parametrize("name", ["ippo", "mappo", "ippo_rnn", "pqn_vdn", "attention"])
def test_agents_learn_to_choose_among_what_is_there(name):
    """Of five numbers the largest that is there; random choices of those there are right in 0.28."""
    more = {"message": 0} if name == "attention" else {}
    module, flags, params, lines = learn(name, "choices", 40, gamma=0.5, learning_rate=2e-2, **more)
    env = ChoiceGame(WORLDS)
    assert lines[0]["score"] < 0.5
    assert score(module, flags, params, env) > 0.85
    state = env.reset(3)
    policy = module.policy_of(env, flags, params)
    _, (action,) = policy.act(policy.initial_carry(WORLDS), state.obs, jax.random.key(0))
    assert (action.sum(-1) == 1.0).all()
    assert (action * state.obs[0][..., -CHOICES:] == action).all()


def test_probabilities_of_choices_are_those_of_a_softmax_over_what_is_there():
    team = SHARED.Team(ChoiceGame(1))
    obs = jnp.zeros((1, 2, team.obs_size)).at[..., -CHOICES:].set(jnp.array([1.0, 1, 0, 0, 1]))
    logits = jnp.log(jnp.array([1.0, 2.0, 9.0, 9.0, 5.0])) * jnp.ones((1, 2, 1))
    chosen = jax.nn.one_hot(jnp.array([[1, 4]]), CHOICES)
    found = team.log_probability(obs, logits, logits, chosen)
    np.testing.assert_allclose(jnp.exp(found), [[2 / 8, 5 / 8]], rtol=1e-5)
    share = np.array([1.0, 2.0, 5.0]) / 8
    entropy = -(share * np.log(share)).sum()
    np.testing.assert_allclose(team.entropy(obs, logits, logits), entropy, rtol=1e-5)
    keys = jax.random.split(jax.random.key(0), 5000)
    drawn = jax.vmap(lambda key: team.draw(key, obs, logits, logits))(keys)
    np.testing.assert_allclose(drawn.mean((0, 1, 2)), [1 / 8, 2 / 8, 0, 0, 5 / 8], atol=0.02)  # 4 sigma


def test_a_league_gets_better_than_its_past_selves():
    """In `duel` a team that does nothing loses to one that knows its targets by 0.64."""
    more = {"snapshot_interval": 4, "pool": 3, "iterations": 60}
    module, flags, params, lines = learn("league", "duel", **more)
    assert lines[0]["league/rating"] == pytest.approx(1000.0, abs=9.0)
    assert lines[-1]["league/rating"] > 1030.0
    idle = jax.tree.map(jnp.zeros_like, params)
    env, net = GAMES.Duel(WORLDS), module.policy_of(GAMES.Duel(WORLDS), flags, params)
    still = module.policy_of(env, flags, idle)

    def act(carry, obs, key):
        mine, theirs = (one.act(carry, obs, key)[1][0] for one in (net, still))
        return carry, (jnp.concatenate([mine[:, :2], theirs[:, 2:]], 1),)

    found = play_episodes(env, _jitted(type(net)(net.initial_carry, act)), env.worlds)
    assert found.scores.mean() > 0.55
    with pytest.raises(SystemExit, match="match has 3 agents, expected two teams of equal size"):
        module.train(module.LeagueFlags(task="match"), GAMES.Game(4))


def test_ratings_are_those_of_elo():
    """400 points are 10 to 1; a win against an equal gains half of the step, and takes as much."""
    league = load("marl/league")
    odds = league.expected(jnp.array([1000.0, 1400.0]), jnp.array(1000.0))
    assert odds.tolist() == pytest.approx([0.5, 10 / 11])
    ratings, won = jnp.array([1000.0, 1400.0]), (jnp.array([True, False]), jnp.ones(2), jnp.array([0, 1]))
    mine, theirs = league.rated(jnp.float32(1000.0), ratings, won, 16.0)
    assert float(mine) == pytest.approx(1008.0)
    assert theirs.tolist() == pytest.approx([992.0, 1400.0])
    both = jnp.ones(2, bool), jnp.array([1.0, 0.5]), jnp.array([0, 1])
    mine, theirs = league.rated(jnp.float32(1000.0), ratings, both, 16.0)
    assert float(mine) == pytest.approx(1000 + 16 * (0.5 + 0.5 - 1 / 11) / 2, rel=1e-6)
    assert theirs.tolist() == pytest.approx([992.0, 1400 - 16 * (0.5 - 1 / 11)], rel=1e-6)


def test_a_game_of_messages_is_solved_with_messages_only_and_by_teams_of_any_size(tmp_path):
    """Without messages two of three agents do at best 0.36, so the team 0.573; with them nearly 1.

    The mailbox is differentiable: nothing else tells the speaker what to say.
    """
    out = str(tmp_path / "run")
    module, flags, params, lines = learn("attention", "whisper", message=2, out=out, iterations=20)
    assert score(module, flags, params, GAMES.Whisper(WORLDS)) > 0.9
    assert score(module, flags, params, GAMES.Whisper(WORLDS, agents=5)) > 0.85
    silent = learn("attention", "whisper", message=0, iterations=20)
    assert score(*silent[:3], GAMES.Whisper(WORLDS)) < (1 + 2 * GAMES.BLIND) / 3 + 0.02
    # The run is one of usarmjx: its lines are read by `curves`, its policy by `eval`, `suite` and `teams`.
    assert [one["agent_steps"] for one in read_lines(tmp_path / "run" / "metrics.jsonl")] == [
        one["agent_steps"] for one in lines
    ]
    assert json.loads((tmp_path / "run" / "run.json").read_text())["flags"]["message"] == 2
    name = f"{FOLDER / 'attention.py'}:load@{tmp_path / 'run'}"
    env = GAMES.Whisper(4)
    played = own_policy(name, env)
    _, (action,) = played.act(played.initial_carry(4), env.reset(0).obs, jax.random.key(0))
    _, (own,) = module.policy_of(env, flags, params).act(None, env.reset(0).obs, jax.random.key(0))
    np.testing.assert_allclose(action, own, atol=1e-6)  # the same weights in another compilation


def test_links_between_agents_are_read_from_the_robots_own_observations():
    """Robot 0 is a base, 1 and 2 are agents: each has two others, and only 1 has a link to 2."""
    layout = load("marl/attention").Layout(start=1, features=4, link=3, slots=(1, 2), robots=3)
    base, mate = [0.1, 0.2, 0.3, 1.0], [0.4, 0.5, 0.6, 1.0]
    far = [0.4, 0.5, 0.6, 0.0]
    obs = jnp.array([[[7.0, *base, *mate, 8.0], [7.0, *base, *far, 8.0]]])
    own, mates, linked = layout.parts(obs)
    assert own[0].tolist() == [[7.0, 8.0]] * 2
    np.testing.assert_allclose(mates[0, 0], [base, mate], atol=1e-6)
    assert linked[0].tolist() == [[False, True], [False, False]]


def test_advantages_are_those_of_the_definition():
    """Three steps, an end after the second, worked out with gamma 0.5 and lambda 0.5."""
    reward, value = jnp.array([1.0, 2.0, 3.0]), jnp.array([0.5, 1.0, 2.0])
    done = jnp.array([False, True, False])
    advantage, target = SHARED.generalised_advantages(reward, value, jnp.float32(4.0), done, 0.5, 0.5)
    # Backwards: 3 + 0.5 x 4 - 2; 2 - 1; 1 + 0.5 x 1 - 0.5 + 0.25 x 1.
    assert advantage.tolist() == [1.25, 1.0, 3.0]
    assert target.tolist() == [1.75, 2.0, 5.0]


def test_returns_of_the_teams_value_are_those_of_the_definition():
    """With lambda 1 the rewards up to the end, with 0 one step and the best value after it."""
    pqn = load("marl/pqn_vdn")
    rows = {"obs": None, "action": None}
    batch = pqn.Batch(
        **rows,
        reward=jnp.array([[1.0], [2.0], [3.0]]),
        done=jnp.array([[False], [False], [True]]),
        best=jnp.array([[10.0], [20.0], [30.0]]),
    )
    last = jnp.array([40.0])
    assert pqn.lambda_returns(batch, last, 0.5, 1.0)[:, 0].tolist() == [1 + 0.5 * (2 + 0.5 * 3), 3.5, 3.0]
    assert pqn.lambda_returns(batch, last, 0.5, 0.0)[:, 0].tolist() == [11.0, 17.0, 3.0]


def test_a_function_needs_a_task_and_a_function(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("def drive(env):\n    return env\n")
    source = load_policy(f"{file}:drive")
    with pytest.raises(
        UsageError, match="is a function, which is for no task by itself: name it, --task TASK"
    ):
        source.check_task()
    with pytest.raises(UsageError, match=r"returned NoneType, expected usarmjx's Policy"):
        source.for_task("explore-v2").policy(None)
    with pytest.raises(UsageError, match=r"mine.py has no function 'no'"):
        load_policy(f"{file}:no")


def test_an_iteration_is_compiled_once():
    """Arrays of an engine are bound to a device, those of a network are not; results of both are bound."""
    bound, free = jax.device_put(jnp.ones(2), jax.devices()[0]), jnp.ones(2)
    start = SHARED.Learner(params=free, optimiser=free, state=bound, key=jax.random.key(0))
    assert (bound.committed, free.committed) == (True, False)
    sums = {"episodes": jnp.ones(()), "score": jnp.ones(())}
    iterate = jax.jit(lambda now: (jax.tree.map(lambda one: one, now), sums))
    flags = SHARED.Flags(num_worlds=1, rollout_length=1, total_steps=3)
    _, lines = SHARED.run(flags, "toy", start, iterate, 1)
    assert len(lines) == 3
    assert iterate._cache_size() == 1


# ---- On a task


@pytest.fixture(scope="module")
def tasks():
    """Teams of two in `explore-v3`, whose robots choose goals or turn their wheels."""
    # The 48 arenas of the task take seconds to generate, and shapes do not depend on their number.
    arena = Buildings(levels=(0.4,), count=2, size=(5, 4), together=True, spacing=1.2)
    small = {"worlds": 2, "engine": "planar", "count": 2, "physics": "coarse", "arena": arena}
    made = {kind: usarmjx.make("explore-v3", actions=kind, **small) for kind in ("goals", "wheels")}
    talking = {"actions": "goals+message", "message_floats": 3}
    return {**made, "vectors": usarmjx.make("explore-v3", **talking, **small)}


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("ippo", "goals"),
        ("mappo", "goals"),
        ("ippo_rnn", "goals"),
        ("pqn_vdn", "goals"),
        ("attention", "goals"),
        ("attention", "vectors"),
        ("ippo_rnn", "vectors"),
        ("fast_td3", "goals"),
        ("pqn_vdn", "wheels"),
        ("fast_td3", "wheels"),
    ],
)
def test_an_iteration_on_a_task_is_traced(name, kind, tasks, monkeypatch):
    """All shapes and types, from the start of the worlds to the next weights; compiling takes minutes."""
    module, env = load(f"marl/{name}"), tasks[kind]
    monkeypatch.setattr(SHARED, "run", lambda flags, word, start, iterate, agents: (start, iterate(start)))
    flags = {"num_worlds": 2, "rollout_length": 4, "total_steps": 16, "hidden": 8, "task": env.name}
    sizes = {"buffer_steps": 8, "batch_size": 4} if name == "fast_td3" else {"num_minibatches": 1}
    sizes |= {"message": 3 * (kind == "vectors")} if name == "attention" else {}
    kinds = flags_of(module)(**flags, **sizes)
    start, (after, sums) = jax.eval_shape(lambda: module.train(kinds, env))
    shapes = [jax.tree.map(lambda one: (one.shape, one.dtype), tree) for tree in (start, after)]
    assert shapes[0] == shapes[1]
    assert sums["episodes"].shape == sums["score"].shape == ()


def test_attention_refuses_observations_that_it_does_not_read(tasks):
    attention = load("marl/attention")
    with pytest.raises(SystemExit, match="does not read what robots of explore-v3 observe"):
        attention.Layout.of(tasks["wheels"])
    with pytest.raises(SystemExit, match="--message 8: agents of explore-v3 send vectors of 0 numbers"):
        attention.train(attention.AttentionFlags(message=8, num_worlds=2), tasks["goals"])


def test_attention_makes_a_task_whose_robots_send_its_messages(monkeypatch):
    """Vectors of the task, of `--message` numbers, where robots choose goals; elsewhere its own mailbox."""
    attention, made = load("marl/attention"), dict[str, object]()
    monkeypatch.setattr(usarmjx, "make", lambda name, **fields: made.update(fields))
    own = {"actions", "message_floats"}
    for task, message, fields in (
        ("explore-v3", 3, {"actions": "goals+message", "message_floats": 3}),
        ("explore-v3", 0, {}),
        ("explore-v2", 3, {}),
    ):
        made.clear()
        attention.make_env(attention.AttentionFlags(task=task, message=message, num_worlds=2))
        assert {name: made[name] for name in own & made.keys()} == fields


def test_mates_that_are_not_there_are_not_attended_to():
    """Robots of `choices` see two others: what the second one's numbers are matters only if it is there."""
    module, env = load("marl/attention"), ALL["choices"](1)
    team = SHARED.Team(env)
    flags = module.AttentionFlags(message=0, hidden=8)
    net, params = module.network(team, flags), module.initial_params(team, flags)
    obs = jax.random.uniform(jax.random.key(0), (1, 2, team.obs_size))

    def seen(there, number):
        return net.apply(params, obs.at[..., 1:5].set(jnp.array([1.0, 0.3, there, number])))[0]

    np.testing.assert_array_equal(seen(0.0, 5.0), seen(0.0, -5.0))
    assert not np.array_equal(seen(1.0, 5.0), seen(1.0, -5.0))


def test_vectors_beside_choices_are_learned_from_rewards():
    """Deaf agents name the other's secret in half of the games; who hears its number, in all."""
    more = {"message": 1, "iterations": 60, "gamma": 0.9, "entropy_coef": 0.01}
    heard = score(*learn("attention", "vectors", **more)[:3], VectorGame(WORLDS))
    deaf = score(*learn("attention", "deaf", **more)[:3], DeafGame(WORLDS))
    assert heard > 0.9
    assert deaf < 0.7


def test_the_density_of_a_vector_counts_where_it_is_sent():
    """The choices are two secrets, silence, and to speak, with which alone the number counts."""
    team = SHARED.Team(VectorGame(1))
    assert (team.choices, team.action_size) == (4, 5)
    obs = jnp.zeros((1, 2, team.obs_size)).at[..., -2:].set(1.0)  # silence or speech
    mean = jnp.array([9.0, 9.0, np.log(1.0), np.log(3.0), 0.2]) * jnp.ones((1, 2, 1))
    log_std = jnp.full((1, 2, 5), np.log(0.5))
    action = jnp.array([[[0, 0, 1, 0, 0.7], [0, 0, 0, 1, 0.7]]])
    density = -0.5 * 1.0**2 - np.log(0.5) - 0.5 * np.log(2 * np.pi)
    found = team.log_probability(obs, mean, log_std, action)
    np.testing.assert_allclose(found, [[np.log(0.25), np.log(0.75) + density]], rtol=1e-5)
    share = np.array([0.25, 0.75])
    entropy = -(share * np.log(share)).sum() + 0.75 * np.log(0.5)
    np.testing.assert_allclose(team.entropy(obs, mean, log_std), entropy, rtol=1e-5)
    keys = jax.random.split(jax.random.key(0), 5000)
    drawn = jax.vmap(lambda key: team.draw(key, obs, mean, log_std))(keys).reshape(-1, 5)
    np.testing.assert_allclose(drawn[:, :4].mean(0), [0, 0, 0.25, 0.75], atol=0.02)  # 4 sigma
    np.testing.assert_allclose([drawn[:, 4].mean(), drawn[:, 4].std()], [0.2, 0.5], atol=0.02)
    best = team.best(obs, mean)
    np.testing.assert_allclose(best[0, 0], [0, 0, 0, 1, 0.2], rtol=1e-6)


def test_values_of_choices_refuse_vectors():
    with pytest.raises(SystemExit, match="values of choices say nothing of the vectors"):
        learn("pqn_vdn", "vectors", 1)
