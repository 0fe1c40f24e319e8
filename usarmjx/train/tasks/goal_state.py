"""State of teams that choose goals: their memory, what goals depend on, and the gain of a step."""

from typing import Any, NamedTuple

import jax
from flax import struct

from usarmjx.train.mapping.planning import Goals
from usarmjx.train.tasks.goal_features import Mates
from usarmjx.train.tasks.messages import MessageState


class GoalState(struct.PyTreeNode, kw_only=True):
    """Memory of reports and goals.

    Attributes:
        achieved: The task's own: what its score counts.
        reported: News on each robot's map when the base last had all of it (robots,).
        shared: News on each robot's map when it last had a link to each other one (robots, robots).
        goals: Goals of each robot as of the last choice (robots, goals, ...).
        chosen: Which of them it chose (robots,).
        way: Next positions on the way there [m] (robots, WAY_SQUARES, 2).
        looked: Squares that each robot has looked at, if the task wants that (robots, i, j); those from which
            an oracle has looked for victims in vain (victims, i, j); else empty.
        sent: Squares of news on each robot's map when the base last had all of it, if pictures show them; of
            parts of maps, those that it believes the base to have (robots, i, j); else empty.
        picture: Pictures of the robots' maps as of the last choice (robots, LEVELS, WIDTH, WIDTH, channels);
            else empty.
        messaging: Memory of messages, if parts of maps are sent; else empty.
        bytes_sent: Bytes that a robot of the team has sent so far, each receiver counted: mean [bytes] ().
    """

    achieved: Any
    reported: jax.Array
    shared: jax.Array
    goals: Goals
    chosen: jax.Array
    way: jax.Array
    looked: jax.Array | tuple[()] = ()
    sent: jax.Array | tuple[()] = ()
    picture: jax.Array | tuple[()] = ()
    messaging: MessageState | tuple[()] = ()
    bytes_sent: jax.Array | float = 0.0


class KnownMaps(struct.PyTreeNode, kw_only=True):
    """Facts that goals and ways of robots depend on.

    Attributes:
        squares: Their maps (robots, i, j).
        reachable: Squares that robots get to, for an oracle (i, j).
        targets: Squares that are worth the way, for an oracle (i, j); else those that are `pending`
            (robots, i, j).
        pose: Their poses (robots, 3).
        headers: Headers that they received, see `Belief` (robots, robots, HEADER_SIZE).
        age: Age of these [s] (robots, robots).
        mates: The others that are goals (robots, MATES).
        sights: Positions of what an oracle has to look at, if it has to [m] (n, 2); else empty.
    """

    squares: jax.Array
    reachable: jax.Array
    targets: jax.Array
    pose: jax.Array
    headers: jax.Array
    age: jax.Array
    mates: Mates
    sights: jax.Array | tuple[()] = ()


class Progress(NamedTuple):
    """Gain of a step, contacts apart.

    Attributes:
        achieved: The task's own memory after it.
        points: Points of the score ().
        reward: Points that each robot gets, by slot (robots,).
        metrics: The task's own.
    """

    achieved: Any
    points: jax.Array
    reward: jax.Array
    metrics: dict[str, jax.Array]
