"""A team outside a simulator sees and does what the same team does inside."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from usarmjx.base.errors import UsageError
from usarmjx.train.baselines import BASELINES
from usarmjx.train.make import make
from usarmjx.train.tasks import TASKS, Buildings, TeamMind
from usarmjx.train.tasks.goal_features import GOALS
from usarmjx.train.tasks.messages import VECTOR, option
from usarmjx.train.tasks.team_mind import Report

SMALL = Buildings(levels=(0.4,), count=1, size=(5, 4), together=True, spacing=1.2)


def report_of(env, state, letters):
    """Return the report of the robots of world 0."""
    world = jax.device_get(state.batch.worlds)
    base, team = (group.memory.last for group in world.groups)
    poses = np.concatenate([base[0][0], team[0][0]])[:, (0, 1, 5)]
    seconds = float(world.step[0]) * env.scene.physics.period
    return Report(seconds, poses, team[1][0], world.links.power[0], letters)


def delivered(mind, mind_orders, report, cutoff):
    """The messages of all robots, where links hold."""
    robots = len(report.poses)
    heard = (report.power >= cutoff) & mind_orders.receivers
    pairs = ((i, j) for i in range(robots) for j in range(robots) if heard[i, j])
    # As bytes, because that is how they travel.
    return [(j, i, report.seconds, mind.decoded(mind.encoded(mind_orders.letters[i]))) for i, j in pairs]


def speaking(task, choices):
    """Return choices that send vectors to all where they send something, and may."""
    if not task.message_floats:
        return choices
    sends = choices[..., GOALS + 1 : task.choices].any(-1, keepdims=True)
    vector = np.zeros(task.action_size, np.float32)
    vector[GOALS + option(0, VECTOR)] = 1.0
    vector[task.choices :] = np.linspace(-0.9, 0.8, task.message_floats)
    return np.where(sends, vector, choices)


PARTS = {"actions": "goals+message", "byte_rate": 64.0}


@pytest.mark.oracle
@pytest.mark.every_run("maps", "vectors")
@pytest.mark.parametrize("own", [{}, PARTS, {**PARTS, "message_floats": 8}], ids=["maps", "parts", "vectors"])
def test_a_team_outside_observes_and_drives_as_the_environment_does(own):
    env = make("explore-v3", engine="planar", arena=SMALL, count=2, episode_steps=60, **own)
    task, planner = env.task, BASELINES.get("explore-v3")(env)
    mind = TeamMind(task, env.scene.arena.extent)
    state, letters = env.reset(3), []
    for _ in range(24):
        report = report_of(env, state, letters)
        seen = mind.see(report)
        np.testing.assert_allclose(seen, state.obs[0][0], atol=2e-5)
        choices = planner.act((), state.obs, jax.random.key(0))[1][0]
        choices = speaking(task, np.asarray(choices))
        orders = mind.obey(seen, choices[0])
        letters = delivered(mind, orders, report, env.scene.radio.cutoff)
        # Four wheels, two on a side.
        wheels = np.asarray(env.commanded(state, (choices,)).groups[1].command.target[0, :, :4])
        np.testing.assert_allclose(np.sort(np.tile(orders.wheels, 2)), np.sort(wheels), atol=1e-3)
        state = env.step(state, (choices,))
    assert np.asarray(state.obs[0])[0, :, 3].any()  # somebody has a link to the base
    if own.get("message_floats"):
        assert np.asarray(state.memory.extra.messaging.vectors.heard).any()


def test_teams_with_other_sensors_or_actions_are_refused():
    extent = ((0.0, 6.0), (0.0, 4.8))
    with pytest.raises(UsageError, match="here: sensors INS, RangeScanner, VictSensor, actions=goals"):
        TeamMind(TASKS.get("victim-search-v3"), extent)
    with pytest.raises(UsageError, match="actions=wheels"):
        TeamMind(replace(TASKS.get("explore-v3"), actions="wheels"), extent)
