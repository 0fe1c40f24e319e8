"""Policies without training."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.base import random
from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.cli.task_options import PolicyOptions
from usarmjx.train.policies.sources import UNTRAINED

ENV = SimpleNamespace(groups=(SimpleNamespace(action_size=2), SimpleNamespace(action_size=3)))
OBS = jnp.zeros((5, 4, 7)), jnp.zeros((5, 1, 9))


def test_zero_and_random_act_for_all_robots():
    for name, make in UNTRAINED.items():
        policy = make(ENV)
        carry = policy.initial_carry(5)
        for key in (0, 1):
            carry, actions = policy.act(carry, OBS, random.key(key))
            assert [one.shape for one in actions] == [(5, 4, 2), (5, 1, 3)]
            flat = np.concatenate([np.asarray(one).ravel() for one in actions])
            assert (np.abs(flat) <= 1).all()
            assert (np.ptp(flat) > 1.0) == (name == "random")


def test_agents_are_named_with_a_task_alone():
    source = PolicyOptions(agent="random", task="explore-v1").source()
    assert (source.name, source.task, source.untrained) == ("random", "explore-v1", True)
    with pytest.raises(UnknownNameError, match="known: zero, random"):
        PolicyOptions(agent="greedy", task="explore-v1").source()
    for wrong in (
        PolicyOptions(agent="zero"),
        PolicyOptions(agent="zero", task="explore-v1", baseline="explore-v1"),
    ):
        with pytest.raises(UsageError, match="needs --task NAME"):
            wrong.source()
