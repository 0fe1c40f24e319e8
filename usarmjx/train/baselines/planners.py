"""Planners of teams: robots go to the frontiers of their maps, and home with news for the base.

Robots of the first versions drive the way that they observe. Those of the third versions choose goals:
`reporting_policy` goes home with news, couriers also carry what others know, robots with meetings are at
their base at agreed times, and a chain goes outward while it hears one that is nearer to the base.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.base.errors import UsageError
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import ActionArrays, Carry, ObservationArrays, Policy, Task
from usarmjx.train.mapping.belief import SECTOR_COUNT
from usarmjx.train.mapping.planning import frontier_action
from usarmjx.train.tasks import messages
from usarmjx.train.tasks.goal_features import (
    CONTACT_SCALE,
    FAR_SCALE,
    FIRST_GOAL,
    FIRST_MASK,
    FIRST_MATE,
    GAIN_WORTH,
    GOAL_NUMBERS,
    GOALS,
    HOME_MARGIN,
    HOME_SPEED,
    KEEP_WORTH,
    LENGTH_SCALE,
    LITTLE_NEWS,
    MATE_NUMBERS,
    MATES,
    NEAR_SCALE,
    NEWS_SCALE,
    OBSERVED_MATES,
    TIME_SCALE,
    chosen_goal,
)
from usarmjx.train.tasks.goal_team import HOLD, GoalTeam
from usarmjx.train.tasks.team import PERFECT_RADIO

Chooser = Callable[[jax.Array, float], jax.Array]
"""From observations (..., n) and the side of a map's squares [m] to goals (...,)."""


def goal_planner(env: Env, *, report: bool) -> Policy:
    """Return a planner for an environment of a `GoalTeam`; its carry is empty.

    Args:
        env: The environment.
        report: Whether robots go home with news, or to frontiers only. With wheels they always do.

    Raises:
        UsageError: Another task.
    """
    if _task_of(env).discrete:
        return policy_of_choices(env, partial(chosen_goal, report=report))

    def act(carry: tuple[()], obs: ObservationArrays, key: jax.Array) -> tuple[tuple[()], ActionArrays]:
        del key
        return carry, tuple(frontier_action(seen, env.episode_steps) for seen in obs)

    return Policy(initial_carry=lambda worlds: (), act=act)


def policy_of_choices(env: Env, choose: Chooser) -> Policy:
    """Return the policy that takes the goals that a function chooses; its carry is empty.

    Raises:
        UsageError: Another task, or one whose actions are speeds.
    """
    task = _task_of(env)
    if not task.discrete:
        raise UsageError(f"this planner chooses goals, but actions of {env.name} are {task.actions}")

    def act(carry: tuple[()], obs: ObservationArrays, key: jax.Array) -> tuple[tuple[()], ActionArrays]:
        del key
        return carry, tuple(jnp.eye(GOALS)[choose(seen, task.cell)] for seen in obs)

    goals = Policy(initial_carry=lambda worlds: (), act=act)
    return with_given_messages(task, goals) if task.chooses_messages else goals


def with_given_messages(task: GoalTeam, goals: Policy) -> Policy:
    """Return a policy of goals for robots that choose messages, too: the fixed protocol chooses these.

    Args:
        task: The task.
        goals: The policy, of observations without options, see `messages.without_options`.
    """
    options, floats = task.options, task.message_floats

    def joined(seen: jax.Array, goal: jax.Array) -> jax.Array:
        given = messages.given_option(seen[..., -options:], base_first=task.sends_to_base_first)
        # An action of choices is 1 at the choice and 0 elsewhere.
        both = jnp.concatenate([goal, jnp.eye(options)[given]], -1)
        # Only one of the two is to be chosen now, and silence is an option whenever messages are.
        sends = seen[..., -options, None] > 0.5
        chosen = both * (sends == (np.arange(both.shape[-1]) >= GOALS))
        # The protocol sends no vector: its numbers do not count.
        return jnp.concatenate([chosen, jnp.zeros((*chosen.shape[:-1], floats))], -1) if floats else chosen

    def act(carry: Carry, obs: ObservationArrays, key: jax.Array) -> tuple[Carry, ActionArrays]:
        carry, chosen = goals.act(carry, tuple(messages.without_options(seen, floats) for seen in obs), key)
        return carry, tuple(map(joined, obs, chosen))

    return Policy(goals.initial_carry, act)


def _task_of(env: Env) -> GoalTeam:
    if not isinstance(env.task, GoalTeam):
        raise UsageError(f"this planner chooses goals as explore-v3 has them, not as {env.name} does")
    return env.task


def reporting_policy(env: Env) -> Policy:
    """Return the planner that brings news home; see `goal_planner`."""
    return goal_planner(env, report=True)


def silent_policy(env: Env) -> Policy:
    """Return the planner that only looks for frontiers; see `goal_planner`."""
    return goal_planner(env, report=False)


ORACLE = "oracle"
"""Name of the planner whose robots know the building and hear all."""
KNOWING: Mapping[str, Any] = {"oracle": True, "radio": PERFECT_RADIO, "byte_rate": None, "talk": "all"}
"""Fields of the task under which an oracle plays: no limit of its radio counts for it."""


def knowing(task: Task) -> GoalTeam:
    """Return a task in which robots know the building and hear everyone, however many bytes that takes.

    Raises:
        UsageError: A task whose robots cannot.
    """
    if not isinstance(task, GoalTeam):
        raise UsageError("only tasks whose robots choose goals have an oracle")
    return replace(task, **KNOWING)


def oracle_policy(env: Env) -> Policy:
    """Return the planner of robots that know the building; see `goal_planner`.

    Raises:
        UsageError: Another task, or robots that do not know it, see `knowing`.
    """
    if not _task_of(env).oracle:
        raise UsageError(f"oracle knows the building, which robots of {env.name} do only with oracle=true")
    return reporting_policy(env)


def frontier_policy(env: Env) -> Policy:
    """Return the policy for an environment of a team task; its carry is empty.

    Raises:
        UsageError: The robots do not observe the way that it drives.
    """
    if not getattr(env.task, "advice", True):
        raise UsageError(f"{env.name} with advice=false: its baseline drives the way that this hides")

    def act(carry: tuple[()], obs: ObservationArrays, key: jax.Array) -> tuple[tuple[()], ActionArrays]:
        del key
        return carry, tuple(frontier_action(seen, env.episode_steps) for seen in obs)

    return Policy(initial_carry=lambda worlds: (), act=act)


STOP, SLOW_MARGIN = 0.1, 0.2
"""Power above the cutoff, as observed, at which a robot stops, and up to which it is slow: 2 and 4 dB."""
HOMING_AGE = 2.0 / 60.0
"""Age of the last contact, as observed, from which a robot drives home without looking at powers."""


def relay_policy(env: Env) -> Policy:
    """Return the policy for an environment of `relay-chain-v1`; its carry is empty.

    The robots form a chain in the order of their slots, the base first. Each drives the way that it observes,
    which leads outward, and stops where the signal of the one before it gets weak; so the first ones become
    relays, and the last one goes farthest. If the task's `talk` is none, they do not look at the radio.

    Raises:
        UsageError: See `frontier_policy`.
    """
    robots, greedy = env.scene.num_robots, frontier_policy(env)
    if getattr(env.task, "talk", "all") == "none":
        return greedy

    def act(carry: tuple[()], obs: ObservationArrays, key: jax.Array) -> tuple[tuple[()], ActionArrays]:
        del key
        return carry, tuple(_chained(seen, robots, env.episode_steps) for seen in obs)

    return Policy(initial_carry=lambda worlds: (), act=act)


def _chained(seen: jax.Array, robots: int, steps: int) -> jax.Array:
    action = frontier_action(seen, steps)
    # A robot observes its slot as a share of the team.
    slot = jnp.round(seen[..., 7 + SECTOR_COUNT] * robots).astype(jnp.int32)
    # The last numbers are the powers of all others, and before them the age of the contact.
    powers = seen[..., -(robots - 1) :]
    # Powers are of the other robots in order, so the one before has this slot less 1.
    before = jnp.take_along_axis(powers, slot[..., None] - 1, -1)[..., 0]
    age = seen[..., -robots]
    go = jnp.where(age > HOMING_AGE, 1.0, jnp.clip((before - STOP) / (SLOW_MARGIN - STOP), 0.0, 1.0))
    return action * go[..., None]


STRONG = 0.05
"""Power above the cutoff, as observed, with which a robot goes on: 1 dB."""
LOST = 2.0
"""A robot that has had no contact with the base for so long goes there [s]."""
AHEAD = 0.3
"""A robot that is nearer to the base by so much comes before another one in the chain [m]."""
OUTWARD_WORTH = 3.0
"""Way that a frontier is worth for each square of its distance from the base [squares]."""


def chain_goal(seen: Array, square: float) -> jax.Array:
    """Return the goals of robots that form a chain (...,).

    A robot goes to frontiers far from the base as long as the base, or a robot that is nearer to it, is heard
    well; else it holds its place. Without contact it goes to the base.

    Args:
        seen: Observations (..., n).
        square: Side of a map's squares [m].
    """
    seen = jnp.asarray(seen)
    goals = seen[..., FIRST_GOAL:FIRST_MASK].reshape(*seen.shape[:-1], GOALS, GOAL_NUMBERS)
    away = goals[..., 4] * FAR_SCALE / square
    cost = LENGTH_SCALE * goals[..., 2] - OUTWARD_WORTH * away
    # Frontiers only: the first choices are the base and robots.
    valid = (seen[..., -GOALS:] > 0.5) & (np.arange(GOALS) > MATES)
    cost = jnp.where(valid, cost, jnp.inf)
    outward = jnp.where(valid.any(-1), cost.argmin(-1), HOLD)
    chosen = jnp.where(_heard(seen) > STRONG, outward, HOLD)
    return jnp.where(CONTACT_SCALE * seen[..., 4] > LOST, 0, chosen)


def _heard(seen: jax.Array) -> jax.Array:
    """Return the best signal of the base or a robot that is nearer to it (...,)."""
    mates = _observed_mates(seen)
    base = NEAR_SCALE * seen[..., FIRST_GOAL : FIRST_GOAL + 2]
    gap = jnp.linalg.norm(NEAR_SCALE * mates[..., 1:3] - base[..., None, :], axis=-1)
    before = gap < jnp.linalg.norm(base, axis=-1)[..., None] - AHEAD
    signals = jnp.where((mates[..., 0] > 0.5) & before, mates[..., 6], 0.0)
    return jnp.maximum(signals.max(-1), seen[..., 3])


def chain_policy(env: Env) -> Policy:
    """Return the planner for an environment of `relay-chain-v3`; its carry is empty.

    Raises:
        UsageError: Another task, or one whose actions are speeds.
    """
    return policy_of_choices(env, chain_goal)


MEETINGS = (0.5, 1.0)
"""Shares of an episode after which robots are to be at their base."""
EARLIER, LATER = 10.0, 20.0
"""Time to spare, and time after a meeting, with which a robot that goes to its base goes on [s]."""


def courier_goal(seen: Array, square: float) -> jax.Array:
    """Return the goals of robots as `chosen_goal` reports, but that one carries what others know (...,).

    Args:
        seen: Observations (..., n).
        square: Side of a map's squares [m].
    """
    alone, together = (chosen_goal(seen, square, report=report) for report in (True, False))
    return jnp.where(has_courier(seen), together, alone)


def meeting_goal(seen: Array, square: float) -> jax.Array:
    """Return the goals of robots that keep meetings (...,): the base, or what `chosen_goal` explores.

    Args:
        seen: Observations (..., n).
        square: Side of a map's squares [m].
    """
    seen = jnp.asarray(seen)
    explored = chosen_goal(seen, square, report=False)
    left, seconds, news = seen[..., 0], TIME_SCALE * seen[..., 1], NEWS_SCALE * seen[..., 5]
    home = seen[..., FIRST_GOAL : FIRST_GOAL + GOAL_NUMBERS]
    # The episode's length is not observed, only the time left and its share.
    whole = seconds / jnp.maximum(left, 1e-6)
    until = seconds[..., None] - whole[..., None] * (1.0 - np.array(MEETINGS, np.float32))
    since = jnp.where(until > 0.0, jnp.inf, -until).min(-1)
    until = jnp.where(until > 0.0, until, jnp.inf).min(-1)
    spare = until - LENGTH_SCALE * home[..., 2] * square / HOME_SPEED - HOME_MARGIN
    # On its way a robot does not turn back as it gets on faster than planned, or is late.
    going = (home[..., 9] > 0.5) & ((spare < EARLIER) | (since < LATER))
    due = (spare < 0.0) | going
    return jnp.where(due & (news > LITTLE_NEWS) & ~has_courier(seen), 0, explored)


def assigned_goal(seen: Array, square: float) -> jax.Array:
    """Return the goals of robots that share frontiers out among all that they have heard of (...,).

    The cheapest pair of a robot and a frontier comes first, then that of the others, and so on. A cost is the
    way, of others as the crow flies, less what the unknown squares around the frontier are worth: the greedy
    assignment with information gain of Burgard et al., Coordinated Multi-Robot Exploration, 2005, which each
    robot works out on its own beliefs. For news robots go home as `courier_goal` does.

    Args:
        seen: Observations (..., n).
        square: Side of a map's squares [m].
    """
    seen = jnp.asarray(seen)
    goals = seen[..., FIRST_GOAL:FIRST_MASK].reshape(*seen.shape[:-1], GOALS, GOAL_NUMBERS)
    mates = _observed_mates(seen)
    gap = NEAR_SCALE * (goals[..., None, :, :2] - mates[..., :, None, 1:3])
    ways = jnp.linalg.norm(gap, axis=-1) / square
    mine = LENGTH_SCALE * goals[..., 2] - KEEP_WORTH * goals[..., 9]
    cost = jnp.concatenate([mine[..., None, :], ways], -2) - GAIN_WORTH * goals[..., None, :, 3]
    robots = jnp.concatenate([jnp.ones_like(mates[..., :1, 0]), mates[..., 0]], -1) > 0.5
    frontiers = (seen[..., -GOALS:] > 0.5) & (np.arange(GOALS) > MATES)
    cost = jnp.where(robots[..., None] & frontiers[..., None, :], cost, jnp.inf)
    explored = chosen_goal(seen, square, report=False)
    for _ in range(1 + OBSERVED_MATES):
        best = cost.reshape(*cost.shape[:-2], -1).argmin(-1)
        robot, goal = best // GOALS, best % GOALS
        # Without a pair that is left all costs are infinite: then the nearest frontier stays.
        found = jnp.isfinite(cost.min((-2, -1)))
        explored = jnp.where(found & (robot == 0), goal, explored)
        row, column = (np.arange(size) for size in cost.shape[-2:])
        taken = (row == robot[..., None])[..., None] | (column == goal[..., None])[..., None, :]
        cost = jnp.where(taken, jnp.inf, cost)
    return jnp.where(courier_goal(seen, square) == 0, 0, explored)


def _observed_mates(seen: jax.Array) -> jax.Array:
    """Return the rows of other robots (..., OBSERVED_MATES, MATE_NUMBERS)."""
    rows = seen[..., FIRST_MATE : FIRST_MATE + OBSERVED_MATES * MATE_NUMBERS]
    return rows.reshape(*seen.shape[:-1], OBSERVED_MATES, MATE_NUMBERS)


def has_courier(seen: Array) -> jax.Array:
    """Return whether another robot that is nearer to the base goes there with all that a robot knows (...,).

    Args:
        seen: Observations (..., n).
    """
    seen = jnp.asarray(seen)
    mates = _observed_mates(seen)
    base = NEAR_SCALE * seen[..., FIRST_GOAL : FIRST_GOAL + 2]
    gap = jnp.linalg.norm(NEAR_SCALE * mates[..., 1:3] - base[..., None, :], axis=-1)
    nearer = gap < jnp.linalg.norm(base, axis=-1)[..., None]
    going, knows = mates[..., 8] > 0.5, NEWS_SCALE * mates[..., 9] < LITTLE_NEWS
    return ((mates[..., 0] > 0.5) & going & knows & nearer).any(-1)


def courier_policy(env: Env) -> Policy:
    """Return the planner of couriers for an environment of a `GoalTeam`; its carry is empty.

    Raises:
        UsageError: Another task, or one whose actions are speeds.
    """
    return policy_of_choices(env, courier_goal)


def assignment_policy(env: Env) -> Policy:
    """Return the planner that shares frontiers out for an environment of a `GoalTeam`; its carry is empty.

    Raises:
        UsageError: Another task, or one whose actions are speeds.
    """
    return policy_of_choices(env, assigned_goal)


def rendezvous_policy(env: Env) -> Policy:
    """Return the planner with meetings for an environment of a `GoalTeam`; its carry is empty.

    Raises:
        UsageError: Another task, or one whose actions are speeds.
    """
    return policy_of_choices(env, meeting_goal)
