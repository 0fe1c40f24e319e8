"""Observation of robots that choose goals, of one size for all teams, and planners that read it.

The numbers, in the robot's axes (x ahead, y to the left):
- the share of the time that is left, and the time left (1: 100 s); how far the robot has come lately (1:
  0.5 m); whether it has a link to the base, and the time since its news last came there (1: 60 s); news
  on its map that the base may not have (1: 1000 squares), and free squares on it (1: 5000); how many of the
  others it has heard of lately (1: 16);
- the shortest beam of each of 12 sectors of its scanner, from right to left (1: 4 m);
- for each of the 4 nearest others that it has heard of lately: whether there is one; where it said to be and
  where it said to go (x, y each; 1: 12 m); the age of that (1: 40 s), whether there is a link now, the time
  since its news last came to the base (1: 60 s), whether it goes there, and news that the robot has
  seen or heard of since it last had a link to it (1: 1000 squares);
- for each of 19 goals, the base, two others and 16 frontiers: position (x, y; 1: 12 m), length of the way (1:
  100 squares), share of unknown squares around it, distance from the base (1: 30 m), distance of the nearest
  other, and of the nearest goal of others of lower slots (1: 12 m), how many others are nearer to it (1: 4),
  whether the robot has been there, and whether it goes there; what is news to the base, or to that robot (1:
  1000 squares); and the time left after the way there and on to the base at 0.3 m/s (1: 100 s);
- for each goal, whether it is valid.

Robots that choose messages, too, have rows of options behind those of goals, and a mask of these at the end;
see `messages`.

News are counted in free squares; `GoalTeam.news_worth` converts other kinds of news to squares.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.train.mapping.belief import SCANNER_RANGE, SECTOR_COUNT, Belief
from usarmjx.train.mapping.maps import FREE, WALL, MapGrid, points_around, to_robot_frame
from usarmjx.train.mapping.planning import Goals
from usarmjx.train.mapping.wavefront import frontier

MATES, FRONTIERS, OBSERVED_MATES = 2, 16, 4
"""Other robots and frontiers among the goals, and other robots that are observed."""
GOALS = 1 + MATES + FRONTIERS
"""Goals of a robot."""
MATE_AGE = 40.0
"""After so long without a message another robot is no goal any more [s]."""
OWN_NUMBERS, MATE_NUMBERS, GOAL_NUMBERS = 8, 10, 12
FIRST_MATE = OWN_NUMBERS + SECTOR_COUNT
FIRST_GOAL = FIRST_MATE + OBSERVED_MATES * MATE_NUMBERS
FIRST_MASK = FIRST_GOAL + GOALS * GOAL_NUMBERS
OBSERVATION_SIZE = FIRST_MASK + GOALS
TIME_SCALE, CONTACT_SCALE, NEWS_SCALE, KNOWN_SCALE, TEAM_SCALE = 100.0, 60.0, 1000.0, 5000.0, 16.0
NEAR_SCALE, FAR_SCALE, LENGTH_SCALE, LONGEST_SEEN = 12.0, 30.0, 100.0, 5.0
HOME_SPEED, HOME_RADIUS = 0.3, 1.5
"""Speed at which robots plan to be home in time [m/s]; distance from the base of goals that are there [m]."""
NOWHERE = 1e3
"""Distance of robots that a robot has not heard of [m]."""


class Mates(NamedTuple):
    """Other robots that robots have heard of, the nearest first.

    Attributes:
        slot: Their slots (robots, mates).
        valid: Whether there is one (robots, mates).
    """

    slot: jax.Array
    valid: jax.Array


class GoalView(NamedTuple):
    """Further inputs of the judgement of goals.

    Attributes:
        base: Slot of the base.
        time: The time [s] ().
        seconds: Time that is left [s] ().
        untold: News on each robot's map that each other one may not have [squares] (robots, robots).
        mates: The others that are goals (robots, n).
    """

    base: int
    time: Array
    seconds: Array
    untold: jax.Array
    mates: Mates


def heard_of(belief: Belief, base: int, time: Array) -> jax.Array:
    """Return which other robots each robot has heard of lately, the base excepted (robots, robots)."""
    robots = len(belief.pose)
    there = ~np.eye(robots, dtype=bool) & (np.arange(robots) != base)
    return (time - belief.heard_time < MATE_AGE) & there


def first_mates(mates: Mates, count: int) -> Mates:
    """Return the nearest ones of some others."""
    return Mates(mates.slot[:, :count], mates.valid[:, :count])


def nearest_mates(belief: Belief, base: int, time: Array, count: int) -> Mates:
    """Return the nearest of the robots that each robot has heard of lately."""
    robots = len(belief.pose)
    away = jnp.linalg.norm(belief.mate_headers[..., :2] - belief.pose[:, None, :2], axis=-1)
    # Infinite distances sort last in `lax.top_k`, which wants a fixed count while tracing.
    away = jnp.where(heard_of(belief, base, time), away, jnp.inf)
    # Filled up, so that a small team has as many places as the largest observation.
    away = jnp.concatenate([away, jnp.full((robots, count), jnp.inf)], -1)
    # The greatest of the negatives: the nearest first, and of equal ones that of the lower slot.
    gap, slot = jax.lax.top_k(-away, count)
    # Slots of the fill are beyond the team: cut to an existing one, and marked invalid.
    return Mates(jnp.minimum(slot, robots - 1), jnp.isfinite(gap))


def sector_features(belief: Belief) -> jax.Array:
    """Return the shortest beams of sectors, as observed (robots, SECTOR_COUNT)."""
    return jnp.minimum(belief.sector_ranges / SCANNER_RANGE, 1.0)


def mate_features(belief: Belief, mates: Mates, linked: jax.Array, judged: GoalView) -> jax.Array:
    """Return what robots observe of others (robots, mates * MATE_NUMBERS).

    Args:
        belief: Their beliefs.
        mates: The others that they observe (robots, mates).
        linked: Which links there are (robots, robots).
        judged: Further inputs.
    """
    robots, time, untold = len(belief.pose), judged.time, judged.untold
    rows = np.arange(robots)[:, None]
    heads = belief.mate_headers[rows, mates.slot]
    age = (time - belief.heard_time[rows, mates.slot]) / MATE_AGE
    contact = jnp.minimum((time - heads[..., 5]) / CONTACT_SCALE, 1.0)
    home = jnp.linalg.norm(heads[..., 3:5] - belief.pose[judged.base, :2], axis=-1) < HOME_RADIUS
    facts = [
        jnp.ones((*mates.slot.shape, 1)),
        to_robot_frame(belief.pose[:, None], heads[..., :2]) / NEAR_SCALE,
        to_robot_frame(belief.pose[:, None], heads[..., 3:5]) / NEAR_SCALE,
        jnp.stack([age, linked[rows, mates.slot], contact, home, untold[rows, mates.slot] / NEWS_SCALE], -1),
    ]
    seen = jnp.where(mates.valid[..., None], jnp.concatenate(facts, -1), 0.0)
    return seen.reshape(robots, -1)


def goal_features(grid: MapGrid, belief: Belief, goals: Goals, chosen: Array, judged: GoalView) -> jax.Array:
    """Return what robots observe of their goals (robots, GOALS * GOAL_NUMBERS).

    Args:
        grid: The squares.
        belief: Their beliefs.
        goals: Their goals (robots, GOALS, ...).
        chosen: Number of the goal that each goes to (robots,).
        judged: Further inputs of their judgement.
    """
    robots, base = len(belief.pose), judged.base
    known = heard_of(belief, base, judged.time)
    there = to_robot_frame(belief.pose[:, None], goals.position)
    mine = jnp.linalg.norm(there, axis=-1)

    def gaps(places: jax.Array, which: jax.Array) -> jax.Array:
        away = jnp.linalg.norm(goals.position[:, :, None] - places[:, None], axis=-1)
        return jnp.where(which[:, None], away, NOWHERE)

    theirs = gaps(belief.mate_headers[..., :2], known)
    # Only those of lower slots count, or two robots would give way to each other.
    lower = np.arange(robots) < np.arange(robots)[:, None]
    taken = gaps(belief.mate_headers[..., 3:5], known & lower).min(-1)
    square = grid.index(goals.position)
    been = belief.visited[np.arange(robots)[:, None], square[..., 0], square[..., 1]]
    from_base = jnp.linalg.norm(goals.position - belief.pose[base, :2], axis=-1)
    # Ways without an end are cut: an infinite number would spoil the normalisation.
    to_go = (grid.cell * jnp.minimum(goals.length, LONGEST_SEEN * LENGTH_SCALE) + from_base) / HOME_SPEED
    near = judged.mates.slot
    for_mates = judged.untold[np.arange(robots)[:, None], near]
    news = jnp.concatenate(
        [judged.untold[:, base, None], for_mates, jnp.zeros((robots, GOALS - 1 - near.shape[-1]))], -1
    )
    facts = [
        there / NEAR_SCALE,
        jnp.minimum(goals.length / LENGTH_SCALE, LONGEST_SEEN)[..., None],
        goals.gain[..., None],
        (from_base / FAR_SCALE)[..., None],
        jnp.minimum(jnp.stack([theirs.min(-1), taken], -1) / NEAR_SCALE, 1.0),
        ((theirs < mine[..., None]).sum(-1) / 4.0)[..., None],
        been[..., None],
        jnp.eye(GOALS)[chosen][..., None],
        (news / NEWS_SCALE)[..., None],
        ((judged.seconds - to_go) / TIME_SCALE)[..., None],
    ]
    return jnp.where(goals.valid[..., None], jnp.concatenate(facts, -1), 0.0).reshape(robots, -1)


# Planners over these observations.

NEARER_COST, TAKEN_COST, TAKEN_RADIUS, VISITED_COST, TURN_COST = 6.0, 20.0, 3.0, 30.0, 3.0
"""Additions to the way to a frontier: for each other robot that is nearer, where another one goes, where the
robot has been, and right behind it [squares]; radius within which others count as going there [m]."""
GAIN_WORTH, KEEP_WORTH = 10.0, 4.0
"""Way that a frontier is worth where all around is unknown, and where the robot goes already [squares]."""
HOME_MARGIN = 8.0
"""Time to spare with which robots plan to be home [s]."""
LITTLE_NEWS, MUCH_NEWS = 30.0, 900.0
"""News that are not worth a way home, and news that are at any time [squares]."""


def chosen_goal(seen: Array, square: float, *, report: bool) -> jax.Array:
    """Return the goals that a planner chooses (...,).

    It takes the nearest frontier, all costs counted. One that reports goes home with much news, and with any
    when the time that is left is just enough for the way.

    Args:
        seen: Observations (..., OBSERVATION_SIZE), perhaps with a picture before the mask.
        square: Side of a map's squares [m].
        report: Whether it goes home.
    """
    seen = jnp.asarray(seen)
    goals = seen[..., FIRST_GOAL:FIRST_MASK].reshape(*seen.shape[:-1], GOALS, GOAL_NUMBERS)
    valid = seen[..., -GOALS:] > 0.5
    ahead, left = goals[..., 0], goals[..., 1]
    # 0 ahead to 2 behind; a goal right here has no direction.
    turn = 1 - ahead / jnp.maximum(jnp.hypot(ahead, left), 1e-3)
    cost = LENGTH_SCALE * goals[..., 2] - GAIN_WORTH * goals[..., 3] - KEEP_WORTH * goals[..., 9]
    cost += NEARER_COST * 4.0 * goals[..., 7] + VISITED_COST * goals[..., 8] + TURN_COST * turn / 2
    cost += TAKEN_COST * jnp.clip(1 - goals[..., 6] * NEAR_SCALE / TAKEN_RADIUS, 0.0, 1.0)
    is_frontier = np.arange(GOALS) >= 1 + MATES
    cost = jnp.where(valid & is_frontier, cost, jnp.inf)
    # Goal 0 is the base, which is always valid.
    best = jnp.where(jnp.isfinite(cost).any(-1), cost.argmin(-1), 0)
    if not report:
        return best
    news, seconds = NEWS_SCALE * seen[..., 5], TIME_SCALE * seen[..., 1]
    way = LENGTH_SCALE * goals[..., 0, 2] * square
    late = seconds < way / HOME_SPEED + HOME_MARGIN
    # A robot on its way home goes on, or it would turn back when its news shrink to little.
    going = goals[..., 0, 9] > 0.5
    home = (news > MUCH_NEWS) | ((late | going) & (news > LITTLE_NEWS))
    return jnp.where(home, 0, best)


LEVELS, WIDTH = 3, 16
"""Scales of the picture, and points along a side of each."""
CHANNELS = ("explored", "wall", "frontier", "news", "others")
"""Numbers of a point: the shares of its squares that are known to be free, walls, frontiers, and free but
perhaps not on the base's map; and the number of other robots that were heard of there."""
FINEST = 2
"""Squares along a side of a point at the finest scale; at each other scale there are twice as many."""


def squares_of_point(level: int) -> int:
    """Return the number of squares along a side of a point at a scale, from 0."""
    return FINEST * 2**level


def block_means(layers: Array, side: int) -> jax.Array:
    """Return the means of maps (n, i, j) over square blocks (n, blocks, blocks).

    Args:
        layers: The maps; squares beyond their edges count as 0.
        side: Squares along a side of a block.
    """
    rows, columns = layers.shape[1:]
    # `-n % side` is what n lacks to a multiple of the side; the fill counts as unknown.
    missing = ((0, 0), (0, -rows % side), (0, -columns % side))
    whole = jnp.pad(layers.astype(jnp.float32), missing)  # pyright: ignore[reportUnknownMemberType]
    return whole.reshape(len(whole), -1, side, whole.shape[2] // side, side).mean((2, 4))


def layers_of(squares: Array, news: Array) -> jax.Array:
    """Return the layers of a picture (n, i, j), from a map (i, j) and its squares that are news (i, j)."""
    return jnp.stack([squares == FREE, squares == WALL, frontier(squares), news])


def map_pyramid(
    grid: MapGrid, squares: Array, news: Array, pose: Array, others: Array, heard: Array
) -> jax.Array:
    """Return a robot's picture (LEVELS, WIDTH, WIDTH, channels).

    A point shows the block of squares that it lies in, as the whole map is divided into blocks.

    Args:
        grid: The squares.
        squares: Its map (i, j).
        news: Squares that the base may not have (i, j).
        pose: Its pose: x, y [m] and yaw [rad] (3,).
        others: Positions of the others [m] (others, 2).
        heard: Which of them it has heard of lately (others,).
    """
    layers, found = layers_of(squares, news), list[jax.Array]()
    for level in range(LEVELS):
        side = squares_of_point(level)
        spacing = side * grid.cell
        means = block_means(layers, side)
        steps = (points_around(pose, WIDTH, spacing) - np.array(grid.low, np.float32)) / grid.cell
        # Half a square: positions are of middles, and blocks begin at a square's edge.
        block = jnp.floor((steps + 0.5) / side).astype(jnp.int32)
        inside = ((block >= 0) & (block < np.array(means.shape[1:]))).all(-1)
        block = jnp.clip(block, 0, np.array(means.shape[1:]) - 1)
        shown = jnp.where(inside, means[:, block[..., 0], block[..., 1]], 0.0)
        found.append(
            jnp.concatenate([jnp.moveaxis(shown, 0, -1), _seen_others(pose, others, heard, spacing)], -1)
        )
    return jnp.stack(found)


def _seen_others(pose: Array, others: Array, heard: Array, spacing: float) -> jax.Array:
    """Return how many others are at each point (WIDTH, WIDTH, 1)."""
    place = jnp.floor(to_robot_frame(pose, others) / spacing + WIDTH / 2).astype(jnp.int32)
    points = np.arange(WIDTH)
    rows, columns = (place[:, axis, None] == points for axis in range(2))
    counted = rows[:, :, None] & columns[:, None, :] & heard[:, None, None]
    return counted.sum(0)[..., None].astype(jnp.float32)
