"""Teams of `victim-search` that vary: their draws, arrivals, losses and empty batteries."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.train.rooms import begin, room
from usarmjx.base.errors import UsageError
from usarmjx.train.envs.presence import arrival_actions, drawn_team
from usarmjx.train.envs.task import TaskView
from usarmjx.train.tasks.victim_search import VictimSearch

STARTS = ((1.0, 1.0), (2.0, 1.0), (3.0, 1.0), (4.0, 1.0))
TEAM = {"arena": room(STARTS), "wheeled": ("P2AT",) * 3, "tracked": (), "flying": ()}


def test_team_sizes_are_drawn_evenly_from_the_least_to_all():
    """2 to 16 robots in one program: shares of sizes and of robots within 4 deviations of 2000 draws."""
    scene, agents = SimpleNamespace(num_robots=17), np.arange(1, 17)
    keys = jax.random.split(jax.random.key(0), 2000)
    teams = np.asarray(jax.jit(jax.vmap(lambda key: drawn_team(scene, agents, 2, key)))(keys))
    assert teams[:, 0].all(), "the base is always there"
    sizes = np.bincount(teams[:, 1:].sum(1), minlength=17)
    assert sizes[:2].sum() == 0
    share = 1 / 15
    assert np.abs(sizes[2:] / 2000 - share).max() < 4 * np.sqrt(share * (1 - share) / 2000)
    assert np.abs(teams[:, 1:].mean(0) - 9 / 16).max() < 4 * 0.5 / np.sqrt(2000)
    assert np.asarray(drawn_team(scene, agents, 0, keys[0])).all()


def test_arrivals_are_an_interval_apart_rounded_up_to_actions():
    scene = SimpleNamespace(num_robots=4)
    assert arrival_actions(scene, np.array([1, 2, 3]), 0.5, 0.2).tolist() == [0, 0, 3, 5]
    assert arrival_actions(scene, np.array([1, 2, 3]), 0.4, 0.2).tolist() == [0, 0, 2, 4]


def at(view, step):
    """The view some control steps later."""
    return view.replace(world=view.world.replace(step=jnp.int32(step)))


@pytest.fixture(scope="module")
def searched():
    """A task whose robots arrive every 0.4 s and have 1 s of charge, and its view at the start."""
    task = VictimSearch(**TEAM, battery_life=1.0, arrival_interval=0.4)
    scene, world, physics = begin(task)
    return task, TaskView(world=world, physics=physics, readings=(), scene=scene)


def parked(view, slots):
    """The view with the robots of some slots parked."""
    groups = tuple(
        state.replace(active=jnp.asarray(~np.isin(group.slots, slots)))
        for group, state in zip(view.scene.groups, view.world.groups, strict=True)
    )
    return view.replace(world=view.world.replace(groups=groups))


def test_robots_arrive_when_it_is_their_turn_and_only_then(searched):
    task, view = searched
    assert np.asarray(task.team(view.scene, jax.random.key(0))).tolist() == [True, True, False, False]
    waiting = parked(view, [2, 3])
    for action, expected in ((1, [1, 1, 0, 0]), (2, [1, 1, 1, 0]), (3, [1, 1, 0, 0]), (4, [1, 1, 0, 1])):
        presence = task.presence(at(waiting, action * task.repeat), None)
        assert np.asarray(presence.present).astype(int).tolist() == expected, action


def test_a_robot_without_charge_is_there_and_not_alive(searched):
    task, view = searched
    charged = task.presence(at(view, 49), None)
    empty = task.presence(at(view, 50), None)
    assert np.asarray(charged.alive).all()
    assert np.asarray(empty.alive).tolist() == [True, False, False, False]
    assert np.asarray(empty.present).all()
    assert not bool(task._over(at(view, 40), None))
    assert bool(task._over(at(view, 60), None))


def test_losses_are_as_frequent_as_the_rate_says():
    """1 - exp(-rate t) of the robots per action, within 4 deviations."""
    task = VictimSearch(**TEAM, loss_rate=2.0)
    scene, world, physics = begin(task)
    view = TaskView(world=world, physics=physics, readings=(), scene=scene)

    def present(step):
        return task.presence(at(view, step), None).present

    here = np.asarray(jax.jit(jax.vmap(present))(jnp.arange(task.repeat, 2000 * task.repeat, task.repeat)))
    assert here[:, 0].all(), "never the base"
    share = 1 - np.exp(-2.0 * 0.2)
    spread = np.sqrt(share * (1 - share) / here[:, 1:].size)
    assert abs(1 - here[:, 1:].mean() - share) < 4 * spread
    assert np.asarray(present(0)).all()


def test_a_team_is_never_smaller_than_its_least_and_usually_whole():
    with pytest.raises(UsageError, match="least_robots is 4, but the team has 3 robots"):
        VictimSearch(**TEAM, least_robots=4)
    usual = VictimSearch(**TEAM)
    assert usual.team(SimpleNamespace(num_robots=4), jax.random.key(0)) is None
    assert usual.presence(SimpleNamespace(), None) is None
