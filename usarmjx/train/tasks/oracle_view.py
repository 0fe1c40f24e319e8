"""View of an oracle of the goals that robots have, for a teacher that knows the building.

A planner that reads it leads each robot to that of its goals from which the least way is left to what nobody
has found, through walls or not known doors alike, and home with what the base truly does not have.
"""

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.sim.scene import Scene
from usarmjx.train.mapping.maps import FREE, WALL
from usarmjx.train.mapping.planning import WALL_COST
from usarmjx.train.mapping.wavefront import UNREACHABLE, distances, passable
from usarmjx.train.tasks.goal_features import (
    FIRST_GOAL,
    FIRST_MASK,
    GOAL_NUMBERS,
    GOALS,
    LENGTH_SCALE,
    LONGEST_SEEN,
    MATES,
    NEWS_SCALE,
)
from usarmjx.train.tasks.goal_team import GoalTeam
from usarmjx.train.tasks.learned_vectors import joined_vectors, split_vectors
from usarmjx.train.tasks.team import TeamMemory, station_slot

LENGTH, GAIN, NEWS = 2, 3, 10
"""Numbers of a goal that the oracle knows better, and that of a robot's news for its base, in `OWN_NEWS`."""
OWN_NEWS = 5


def oracle_obs(
    task: GoalTeam, scene: Scene, memory: TeamMemory, obs: tuple[jax.Array, ...]
) -> tuple[jax.Array, ...]:
    """Return observations in which frontiers are as long a way as what they lead to, per group.

    Args:
        task: The task.
        scene: Its scene.
        memory: Its memory, of one world.
        obs: The robots' observations, per group (robots, n).
    """
    beyond = jnp.minimum(way_beyond(task, scene, memory), LONGEST_SEEN * LENGTH_SCALE) / LENGTH_SCALE
    # The base and the others are goals themselves: nothing lies beyond them.
    beyond = jnp.where(np.arange(GOALS) >= 1 + MATES, beyond, 0.0)
    news = true_news(task, scene, memory) / NEWS_SCALE
    rows = zip(obs, task.per_group(scene, beyond), task.per_group(scene, news), strict=True)
    return tuple(_known(seen, beyond, news, task.message_floats) for seen, beyond, news in rows)


def _known(seen: jax.Array, beyond: jax.Array, news: jax.Array, floats: int) -> jax.Array:
    if floats:
        # Vectors stand among the numbers of the others, before the goals.
        plain, vectors = split_vectors(seen, floats)
        return joined_vectors(_known(plain, beyond, news, 0), vectors)
    goals = seen[:, FIRST_GOAL:FIRST_MASK].reshape(-1, GOALS, GOAL_NUMBERS)
    # No gain: to one that knows the building, unknown squares are worth nothing of themselves.
    goals = goals.at[..., LENGTH].add(beyond).at[..., GAIN].set(0.0).at[:, 0, NEWS].set(news)
    seen = seen.at[:, OWN_NEWS].set(news)
    return seen.at[:, FIRST_GOAL:FIRST_MASK].set(goals.reshape(len(seen), -1))


def way_beyond(task: GoalTeam, scene: Scene, memory: TeamMemory) -> jax.Array:
    """Return the ways from goals to the nearest square that is worth it [squares] (robots, GOALS)."""
    truth = jnp.where(memory.reachable, FREE, WALL)
    sources = jnp.where(task.unfound(memory), 0.0, UNREACHABLE)
    far = distances(sources, memory.reachable, jnp.where(passable(truth), 0.0, WALL_COST))
    # A frontier may be a square that the middle of a robot does not get to: its neighbours count.
    there = task.arena_grid(scene).index(memory.extra.goals.position)
    near = jnp.stack([there + jnp.array([i, j]) for i in (-1, 0, 1) for j in (-1, 0, 1)], -2)
    near = jnp.clip(near, 0, jnp.array(far.shape) - 1)
    return far[near[..., 0], near[..., 1]].min(-1)


def true_news(task: GoalTeam, scene: Scene, memory: TeamMemory) -> jax.Array:
    """Return how much of a robot's map the base does not have [squares] (robots,)."""
    news = memory.belief.squares == task.news_kind
    return (news & ~news[station_slot(scene)]).sum((1, 2)) * task.news_worth
