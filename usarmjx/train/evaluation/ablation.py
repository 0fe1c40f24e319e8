"""Ablations of a team's policy: its scores without parts of its observations or of its radio.

    usarmjx teams explore-v2 packaged --ablate

A hidden part has the values of its absence: advice is 0, a team mate was never heard and has no link, the map
is unknown. A policy that was not trained so may do worse than one that was: a loss is an upper
bound of what the part is worth.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import Estimate, estimate_groups
from usarmjx.base.tables import markdown_table
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import ActionArrays, Carry, ObservationArrays, Policy
from usarmjx.train.evaluation.yardsticks import TeamResult, find_team, play_team
from usarmjx.train.make import build_env
from usarmjx.train.mapping.belief import SECTOR_COUNT
from usarmjx.train.tasks import goal_features
from usarmjx.train.tasks.goal_features import FIRST_GOAL, FIRST_MASK, FIRST_MATE, GOAL_NUMBERS, GOALS
from usarmjx.train.tasks.goal_team import GoalTeam
from usarmjx.train.tasks.learned_vectors import without_vectors
from usarmjx.train.tasks.messages import with_options, without_options
from usarmjx.train.tasks.team import LOCAL_MAP_WIDTH, PERFECT_RADIO, TeamTask

WAYPOINT, ADVICE, MATE_SIZE = 2, 5, 4
"""Ends of waypoint and advice in a `TeamTask`'s observation, and numbers about each team mate."""
MATES = ADVICE + 1 + SECTOR_COUNT + 2
"""First number about team mates: behind advice, progress, sectors, time left and own number."""
MATE_AGE = 2
"""Number of a team mate that is the age of its news; 1 if it was never heard."""
MAP_SIZE = LOCAL_MAP_WIDTH**2

OWN_NEWS, OWN_HEARD = 5, 7
"""Numbers of a robot that chooses goals: squares that the base may not have, others that it has heard of."""
GOAL_OTHERS, GOAL_NEARER, GOAL_NEWS = slice(5, 7), 7, 10
"""Numbers about a goal: distances of others and of their goals, how many are nearer, and news."""

Hide = Callable[[jax.Array, int], jax.Array]
"""Takes observations (..., obs_size) and the number of other robots, and returns them with a part hidden."""


def nothing_hidden(obs: jax.Array, others: int) -> jax.Array:
    """Return observations as they are."""
    del others
    return obs


def without_advice(obs: jax.Array, others: int) -> jax.Array:
    """Hide the planner's waypoint, goal and length of the way."""
    del others
    return obs.at[..., :ADVICE].set(0.0)


def without_goal(obs: jax.Array, others: int) -> jax.Array:
    """Hide the planner's goal and the length of the way, not its waypoint."""
    del others
    return obs.at[..., WAYPOINT:ADVICE].set(0.0)


def without_mates(obs: jax.Array, others: int) -> jax.Array:
    """Hide all team mates, as if they were never heard."""
    # An age of 1 is what tasks show of a mate that was never heard; 0 would be fresh news.
    silent = jnp.zeros(MATE_SIZE).at[MATE_AGE].set(1.0)
    return obs.at[..., MATES : MATES + others * MATE_SIZE].set(jnp.tile(silent, others))


def without_map(obs: jax.Array, others: int) -> jax.Array:
    """Hide the map around the robot: no walls, all unknown."""
    walls = MATES + others * MATE_SIZE
    hidden = obs.at[..., walls : walls + MAP_SIZE].set(0.0)
    return hidden.at[..., walls + MAP_SIZE : walls + 2 * MAP_SIZE].set(1.0)


def without_other_robots(obs: jax.Array, others: int) -> jax.Array:
    """Hide all others from a robot that chooses goals, as if they were never heard."""
    del others
    goals = obs[..., FIRST_GOAL:FIRST_MASK].reshape(*obs.shape[:-1], GOALS, GOAL_NUMBERS)
    # The mask, too: a choice to follow somebody would tell that there is somebody.
    there = obs[..., -GOALS:].at[..., 1 : 1 + goal_features.MATES].set(0.0)
    goals = goals.at[..., GOAL_OTHERS].set(1.0).at[..., GOAL_NEARER].set(0.0)
    # Goals that are not there stay all 0, as in training.
    goals = jnp.where(there[..., None] > 0.0, goals, 0.0).reshape(*obs.shape[:-1], GOALS * GOAL_NUMBERS)
    hidden = obs.at[..., OWN_HEARD].set(0.0).at[..., FIRST_MATE:FIRST_GOAL].set(0.0)
    return hidden.at[..., FIRST_GOAL:FIRST_MASK].set(goals).at[..., -GOALS:].set(there)


def without_news(obs: jax.Array, others: int) -> jax.Array:
    """Hide from a robot that chooses goals how much the base and the others do not know yet."""
    del others
    # One number of each goal, so a stride over the goals.
    news = slice(FIRST_GOAL + GOAL_NEWS, FIRST_MASK, GOAL_NUMBERS)
    untold = slice(FIRST_MATE + goal_features.MATE_NUMBERS - 1, FIRST_GOAL, goal_features.MATE_NUMBERS)
    return obs.at[..., OWN_NEWS].set(0.0).at[..., untold].set(0.0).at[..., news].set(0.0)


def unchanged_task(task: TeamTask) -> TeamTask:
    """Return a task as it is."""
    return task


def silent_task(task: TeamTask) -> TeamTask:
    """Return a task in which robots send nothing to each other."""
    return replace(task, talk="none")


def base_only_task(task: TeamTask) -> TeamTask:
    """Return a task in which robots talk to their base, not to each other."""
    return replace(task, talk="base")


def perfect_radio_task(task: TeamTask) -> TeamTask:
    """Return a task in which all robots hear each other."""
    return replace(task, radio=PERFECT_RADIO)


Ablations = Mapping[str, tuple[Callable[[TeamTask], TeamTask], Hide]]
"""Ablations by what is taken away: the change of the task, and what is hidden; the last gives."""
ABLATIONS: Ablations = {
    "nothing": (unchanged_task, nothing_hidden),
    "advice": (unchanged_task, without_advice),
    "goal": (unchanged_task, without_goal),
    "map": (unchanged_task, without_map),
    "mates": (unchanged_task, without_mates),
    "messages": (silent_task, nothing_hidden),
    "perfect radio": (perfect_radio_task, nothing_hidden),
}
"""Ablations of robots that are driven by speed and turn."""
GOAL_ABLATIONS: Ablations = {
    "nothing": (unchanged_task, nothing_hidden),
    "mates": (unchanged_task, without_other_robots),
    "news": (unchanged_task, without_news),
    "messages": (base_only_task, nothing_hidden),
    "perfect radio": (perfect_radio_task, nothing_hidden),
}
"""Ablations of robots that choose goals; without `messages` they still report to their base."""


def _beside_options(hide: Hide, floats: int, obs: jax.Array, others: int) -> jax.Array:
    """Hide a part of the observations of robots that choose messages, whose options stay.

    With another robot its vector of some floats is hidden.
    """
    return with_options(hide(without_options(obs, floats), others), obs, floats)


def _without_vectors(floats: int, obs: jax.Array, others: int) -> jax.Array:
    """Hide the vectors that others sent."""
    del others
    return without_vectors(obs, floats)


def ablations_of(task: TeamTask) -> Ablations:
    """Return the ablations of a task's policies.

    Raises:
        UsageError: The task has goals, but its robots do not choose them.
    """
    if not isinstance(task, GoalTeam):
        return ABLATIONS
    if task.chooses_messages:
        floats = task.message_floats
        beside = {
            name: (change, partial(_beside_options, hide, floats))
            for name, (change, hide) in GOAL_ABLATIONS.items()
        }
        vectors: Ablations = {"vectors": (unchanged_task, partial(_without_vectors, floats))}
        return {**beside, **(vectors if floats else {})}
    if not task.discrete:
        raise UsageError(
            f"--ablate takes robots that choose goals: expected actions=goals, not {task.actions}"
        )
    return GOAL_ABLATIONS


def hidden_policy(policy: Policy, hide: Hide, others: int) -> Policy:
    """Return a policy from which a part of the observations is hidden."""

    def act(carry: Carry, obs: ObservationArrays, key: jax.Array) -> tuple[Carry, ActionArrays]:
        return policy.act(carry, tuple(hide(one, others) for one in obs), key)

    return Policy(policy.initial_carry, act)


@dataclass(frozen=True, kw_only=True)
class AblationRow:
    """Result of a team without a part.

    Attributes:
        team: The team.
        without: Part that was taken away, a key of `ablations_of(task)`.
        result: Its result.
        difference: Score less that with nothing taken away, in the same buildings.
    """

    team: str
    without: str
    result: TeamResult
    difference: Estimate


def check_layout(env: Env) -> None:
    """Refuse observations that are laid out otherwise.

    Raises:
        UsageError: They are too short for the parts that ablations hide.
    """
    others = env.scene.num_robots - 1
    least = MATES + others * MATE_SIZE + 2 * MAP_SIZE
    if any(group.obs_size < least for group in env.groups):
        raise UsageError(f"{env.name}: its observations have no parts that --ablate can hide")


def ablate(
    task: TeamTask,
    name: str,
    worlds: int,
    teams: Sequence[str],
    seed: int = 0,
    engine: str = "auto",
    tell: Callable[[AblationRow], None] = lambda row: None,
) -> tuple[AblationRow, ...]:
    """Return results of teams with each part taken away.

    Args:
        task: The task, with one arena for each world.
        name: Name of the task.
        worlds: Episodes.
        teams: Names, see `yardsticks.find_team`.
        seed: Seed of the environments.
        engine: See `make`.
        tell: Receives each row as soon as it is known.

    Raises:
        UnknownNameError: No such team.
        UsageError: Observations or actions without these parts, or a policy that does not fit.
    """
    envs: dict[TeamTask, Env] = {}  # each is compiled once
    rows: list[AblationRow] = []
    ablations = ablations_of(task)
    for team in teams:
        change, driver = find_team(team)
        whole: TeamResult | None = None
        for without, (alter, hide) in ablations.items():
            own = alter(change(task))
            if own not in envs:
                envs[own] = build_env(own, worlds, name=name, engine=engine)
            env = envs[own]
            if ablations is ABLATIONS:
                # Robots that choose goals observe by `goal_features`, whose numbers are used here.
                check_layout(env)
            policy = hidden_policy(driver(env), hide, env.scene.num_robots - 1)
            result = play_team(env, own, policy, f"{team} without {without}", seed)
            # The first ablation takes nothing away: what the others are compared with.
            whole = whole or result
            rows.append(ablation_row(team, without, result, whole))
            tell(rows[-1])
    return tuple(rows)


def ablation_row(team: str, without: str, result: TeamResult, whole: TeamResult) -> AblationRow:
    """Return the row of a result, compared with that of the whole policy in the worlds that both have."""
    # In pairs, building by building: that takes the buildings' differences out of the interval.
    gains = np.array(result.by_world, float) - np.array(whole.by_world, float)
    return AblationRow(
        team=team, without=without, result=result, difference=estimate_groups(gains[np.isfinite(gains)])
    )


def ablation_table(rows: Sequence[AblationRow]) -> str:
    """Return the rows as a Markdown table."""
    parts = list(rows[0].result.parts)
    lines: list[list[str]] = []
    for row in rows:
        gain = row.difference
        # The difference to itself is 0 by definition, no measurement.
        known = np.isfinite(gain.low) and row.without != "nothing"
        change = f"{gain.value:+.1f} ({gain.low:+.1f} to {gain.high:+.1f})" if known else ""
        points = [f"{row.result.parts[part]:.1f}" for part in parts]
        lines.append([row.team, row.without, f"{row.result.score.value:.1f}", change, *points])
    return markdown_table(("team", "taken away", "score", "change, 95 % interval", *parts), lines)
