"""Teams that differ between worlds, robots that come one after another, and robots that are lost.

Everything follows from the world as it is, so that a task needs no memory of it.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import set_rows
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import powered
from usarmjx.train.envs.presence import Presence, in_use, team_key
from usarmjx.train.envs.task import TaskView

LOSS_KEY = 1
"""Folded into the key of a moment for the draw of losses."""


def drawn_team(scene: Scene, agents: np.ndarray, least: int, key: jax.Array) -> jax.Array:
    """Return which robots a world has in an episode, by slot (robots,).

    Args:
        scene: The scene.
        agents: Slots of the robots that may be missing.
        least: Least number of them; the number is uniform from that to all. 0: always all.
        key: A key of the episode.
    """
    everybody = jnp.ones(scene.num_robots, bool)
    if least == 0:
        return everybody
    size, order = jax.random.split(key)
    number = jax.random.randint(size, (), least, len(agents) + 1)
    place = jax.random.permutation(order, jnp.arange(len(agents)))
    return everybody.at[agents].set(place < number)


def arrival_actions(scene: Scene, agents: np.ndarray, interval: float, period: float) -> np.ndarray:
    """Return the actions after which robots arrive, by slot (robots,): one robot each interval [s]."""
    actions = np.zeros(scene.num_robots, int)
    actions[agents] = np.ceil(np.arange(len(agents)) * interval / period - 1e-6)
    return actions


def remaining_robots(
    view: TaskView, agents: np.ndarray, least: int, arrivals: np.ndarray, repeat: int, loss_rate: float
) -> Presence:
    """Return which robots take part from now on.

    Args:
        view: The world.
        agents: Slots of the robots that may be missing.
        least: See `drawn_team`.
        arrivals: Result of `arrival_actions`.
        repeat: Control steps per action.
        loss_rate: Losses of a robot per second; a lost robot leaves the world.
    """
    scene, world = view.scene, view.world
    action = world.step // repeat
    team = drawn_team(scene, agents, least, team_key(world))
    arrives = team & (arrivals > 0) & (action == arrivals)
    present = in_use(scene, world) | arrives
    if loss_rate > 0:
        share = 1.0 - math.exp(-loss_rate * repeat * scene.physics.period)
        drawn = jax.random.uniform(jax.random.fold_in(view.key, LOSS_KEY), (scene.num_robots,)) < share
        may = jnp.zeros(scene.num_robots, bool).at[agents].set(True) & (action > 0) & ~arrives
        present &= ~(drawn & may)
    awake = [
        (group.slots, powered(scene, world, group, state))
        for group, state in zip(scene.groups, world.groups, strict=True)
    ]
    return Presence(alive=jnp.asarray(set_rows(jnp.zeros(scene.num_robots, bool), *awake)), present=present)
