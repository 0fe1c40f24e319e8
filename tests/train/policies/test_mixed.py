"""Teams in which each class of robots follows the policy of another run."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from usarmjx.base.errors import UsageError
from usarmjx.sweeps import drivers
from usarmjx.train.envs.presence import carry_of_alive
from usarmjx.train.envs.state import AgentGroup
from usarmjx.train.learning.networks import LearnedPolicy, PolicyParams
from usarmjx.train.policies import sources
from usarmjx.train.policies.sources import PolicySource, load_policy, mixed_policy

WHEELED, FLYING = AgentGroup("P2AT", ("a", "b"), 5, 2), AgentGroup("AirRobot", ("c",), 3, 4)
LARGER = AgentGroup("P2AT", ("a", "b", "c"), 5, 2)


def source(groups, layers, memory, seed):
    """A policy of random weights."""
    policy = LearnedPolicy(groups, layers, memory)
    params = PolicyParams(
        weights=policy.init(jax.random.key(seed)),
        mean=tuple(jnp.full(one.obs_size, 0.1 * seed) for one in groups),
        std=tuple(jnp.ones(one.obs_size) for one in groups),
    )
    return PolicySource(name=f"run{seed}", task="wander", learned=(policy, params))


@pytest.fixture(scope="module")
def parts():
    return {
        "p2at": source((WHEELED, FLYING), (8,), 0, 1),
        "AirRobot": source((FLYING,), (4, 4), 6, 2),
    }


def test_each_class_does_what_its_own_policy_does(parts):
    env = SimpleNamespace(name="team", groups=(LARGER, FLYING))
    mixed, key = mixed_policy(env, parts), jax.random.key(0)
    draw = np.random.default_rng(0)
    obs = tuple(
        jnp.asarray(draw.normal(size=(2, len(g.agents), g.obs_size)), jnp.float32) for g in env.groups
    )
    carry, flier = (
        mixed.initial_carry(2),
        parts["AirRobot"].policy(SimpleNamespace(name="x", groups=(FLYING,))),
    )
    alone = flier.initial_carry(2)
    for _ in range(2):  # its memory goes on
        carry, actions = mixed.act(carry, obs, key)
        alone, expected = flier.act(alone, (obs[1],), key)
        assert_array_equal(actions[1], expected[0])
    policy, params = parts["p2at"].learned
    wheels, _ = policy.act(params, (obs[0][:, :2], obs[1]), policy.initial_carry(2), deterministic=True)
    assert_array_equal(actions[0][:, :2], wheels[0])
    assert actions[0].shape == (2, 3, 2)


def test_classes_without_a_policy_and_policies_that_do_not_fit_are_refused(parts):
    with pytest.raises(UsageError, match="missing or unknown: airrobot"):
        mixed_policy(SimpleNamespace(groups=(WHEELED, FLYING)), {"P2AT": parts["p2at"]})
    other = AgentGroup("P2AT", ("a",), 7, 2)
    with pytest.raises(UsageError, match="run1 is for robots"):
        mixed_policy(SimpleNamespace(groups=(other,)), {"P2AT": parts["p2at"]})


def test_memories_are_reset_for_agents_that_come_and_go(parts):
    env = SimpleNamespace(name="team", groups=(LARGER, FLYING))
    carry = jax.tree.map(jnp.ones_like, mixed_policy(env, parts).initial_carry(2))
    wheels, before, after = jnp.ones((2, 3), bool), jnp.array([[True], [True]]), jnp.array([[True], [False]])
    kept = carry_of_alive(carry, (wheels, before), (wheels, after))
    assert_array_equal(kept[1][0], np.broadcast_to([[[1.0]], [[0.0]]], (2, 1, 6)))
    assert carry_of_alive(carry, None, None) is carry
    drawn = (jnp.ones(2), (carry[0][0],))  # not a part per group
    assert carry_of_alive(drawn, (wheels, before), (wheels, after)) is drawn


def test_buildings_of_the_training_of_each_part_are_named(parts, monkeypatch):
    monkeypatch.setattr(sources, "training_note", lambda name, recipe, played: f"{name} knows {[*played]}")
    mixed = PolicySource(name="both", task="wander", parts=parts)
    assert mixed.training_note(iter(["a"])) == "run1 knows ['a']; run2 knows ['a']"


def test_a_mixture_is_named_class_by_class(monkeypatch, parts):
    known = {"runs/a": parts["p2at"], "runs/b": parts["AirRobot"]}
    monkeypatch.setattr(sources, "load_policy", lambda what, checkpoint="best": known[what])
    found = load_policy("P2AT=runs/a,AirRobot=runs/b")
    assert (found.task, found.learned, {*found.parts}) == ("wander", None, {"P2AT", "AirRobot"})
    assert found.policy(SimpleNamespace(name="team", groups=(WHEELED, FLYING))).initial_carry(2)
    monkeypatch.setattr(drivers, "load_policy", load_policy)
    with pytest.raises(UsageError, match="a cell has one policy for all robots"):
        drivers.find_driver("P2AT=runs/a,AirRobot=runs/b", "wander")
    with pytest.raises(UsageError, match="p2at has two policies in P2AT=runs/a, p2at=runs/b"):
        load_policy("P2AT=runs/a, p2at=runs/b")
    with pytest.raises(UsageError, match="expected CLASS=POLICY"):
        load_policy("P2AT=,AirRobot=runs/b")
