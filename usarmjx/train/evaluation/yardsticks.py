"""Scores of a team task in context: the most that its parts can reach, and the scores of simple teams.

    usarmjx teams explore-v2 --worlds 24 --engine c

All teams play one episode in each of the same buildings, with the same seed: robots that act at random, one
robot with the task's baseline, the team with the baseline, the same with a perfect radio, the packaged
policy if it fits, and any other policy. Each policy sees the planner's advice, or does not, as in its
training. Beside the score stand the points of its parts, and what share of
the points for finds was there after a quarter, a half and three quarters of the time.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base import random
from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.estimates import Estimate, estimate_groups
from usarmjx.base.tables import markdown_table
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.train.baselines import BASELINES, PLANNERS
from usarmjx.train.baselines.planners import ORACLE, knowing
from usarmjx.train.envs.env import Env, EnvState
from usarmjx.train.envs.membership import building_label
from usarmjx.train.envs.recipe import GeneratedArenas
from usarmjx.train.envs.task import ActionArrays, ObservationArrays, Policy
from usarmjx.train.evaluation.radio_matters import check_levels, check_whole
from usarmjx.train.make import build_env, make_task
from usarmjx.train.policies import POLICIES
from usarmjx.train.policies.sources import (
    PolicySource,
    arenas_of,
    load_exported,
    load_policy,
    task_settings,
    usual_split,
)
from usarmjx.train.task_names import full_name, newest_name, policy_name
from usarmjx.train.tasks import TASKS
from usarmjx.train.tasks.goal_team import GoalTeam
from usarmjx.train.tasks.team import PERFECT_RADIO, TeamTask
from usarmjx.train.tasks.victim_search import VictimSearch

QUARTERS = (0.25, 0.5, 0.75)
WORLDS = 24
"""Episodes by default."""
VIEWS = ("advice", "observed")
"""Fields of tasks that say what robots see."""
HELD_STEPS = 10
"""Steps for which robots that act at random keep an action: 2 s."""


def random_policy(env: Env) -> Policy:
    """Return a policy that draws speed and turn evenly, and keeps them for `HELD_STEPS`."""

    def initial_carry(worlds: int) -> Any:  # noqa: ANN401 - the policy's own
        still = tuple(jnp.zeros((worlds, len(g.agents), g.action_size)) for g in env.groups)
        return jnp.zeros(worlds, jnp.int32), still

    def act(carry: Any, obs: ObservationArrays, key: jax.Array) -> tuple[Any, ActionArrays]:  # noqa: ANN401
        del obs
        step, before = carry
        # Draws have mean 0: new ones at each step would cancel out, and robots would hardly leave their
        # starts.
        anew = (step % HELD_STEPS == 0)[:, None, None]
        # A key for each group: with one key, groups of one shape would draw the same actions.
        drawn = [
            jax.random.uniform(jax.random.fold_in(key, g), old.shape, minval=-1.0, maxval=1.0)
            for g, old in enumerate(before)
        ]
        now = tuple(jnp.where(anew, new, old) for new, old in zip(drawn, before, strict=True))
        return (step + 1, now), now

    return Policy(initial_carry=initial_carry, act=act)


def alone(task: TeamTask) -> TeamTask:
    """Return a task with its first robot only; a base stays."""
    if isinstance(task, VictimSearch):
        return replace(task, wheeled=task.wheeled[:1], tracked=(), flying=())
    if isinstance(task, GoalTeam):
        # Before the count: a task refuses a least number above it.
        task = replace(task, least_robots=0)
    return replace(task, count=1)


def packaged_policy(env: Env) -> Policy:
    """Return the packaged policy for an environment's task, else that for another version of it.

    Raises:
        UsageError: There is none, or it is for other robots or observations.
    """
    name = packaged_name(env.name)
    if name not in POLICIES:
        raise UsageError(f"no policy is packaged for {name}; known: {', '.join(POLICIES.names())}")
    return load_policy(name).policy(env)


def packaged_name(task: str) -> str:
    """Return the name of the packaged policy for a task, or for its first version."""
    task = newest_name(task)
    if task in POLICIES or (task in TASKS and isinstance(TASKS.get(task), GoalTeam)):
        return task  # no other version observes and acts alike
    return re.sub(r"-v\d+$", "-v1", task)


def baseline_policy(env: Env) -> Policy:
    """Return the baseline of an environment's task."""
    return BASELINES.get(env.name)(env)


def unchanged(task: TeamTask) -> TeamTask:
    """Return a task as it is."""
    return task


def with_advice(task: TeamTask) -> TeamTask:
    """Return a task as its baseline has to see it."""
    return task.for_baseline


def single_with_advice(task: TeamTask) -> TeamTask:
    """Return the task of `alone` as its baseline has to see it."""
    return alone(task.for_baseline)


def with_perfect_radio(task: TeamTask) -> TeamTask:
    """Return a task in which all robots hear each other, as its baseline has to see it."""
    return replace(task.for_baseline, radio=PERFECT_RADIO)


def with_training_view(source: PolicySource, task: TeamTask) -> TeamTask:
    """Return a task that shows what a policy saw in training: the planner's advice, a picture of maps."""
    # Only what it sees: its arena and robots are the task's, or teams would not be compared.
    shown = {name: text for name, text in source.overrides.items() if name in VIEWS and hasattr(task, name)}
    overrides, _ = task_settings(source.task, shown, ()) if shown else ({}, [])
    changes = {name: value for name, value in overrides.items() if getattr(task, name) != value}
    return replace(task, **changes) if changes else task


Team = tuple[Callable[[TeamTask], TeamTask], Callable[[Env], Policy]]
"""Change of the task for a team, and its driver."""

TEAMS: dict[str, Team] = {
    "random": (unchanged, random_policy),
    "one": (single_with_advice, baseline_policy),
    "baseline": (with_advice, baseline_policy),
    "perfect-radio": (with_perfect_radio, baseline_policy),
    "packaged": (unchanged, packaged_policy),
}
"""Teams that need no policy of the user's own, by name."""


GOAL_TEAMS: dict[str, Team] = {
    **{name: (unchanged, planner) for name, planner in PLANNERS.items()},
    ORACLE: (knowing, PLANNERS[ORACLE]),
}
"""Further ones for teams that choose goals: robots that never go home, that meet there at agreed times, and
that know the building and hear all."""


def named_team(name: str) -> Team | None:
    """Return a team that needs no policy of the user's own; None: there is none of that name."""
    return TEAMS.get(name) or GOAL_TEAMS.get(name)


def team_name(team: str) -> str:
    """Return the name of a team for tables, see `policy_name`."""
    return team if named_team(team) else policy_name(team)


def default_teams(task: str) -> tuple[str, ...]:
    """Return the names of `TEAMS` that can play a task: no policy is packaged for some."""
    chooses = task in TASKS and isinstance(TASKS.get(task), GoalTeam)
    usual = tuple(name for name in TEAMS if name != "packaged" or packaged_name(task) in POLICIES)
    # A chain stays near its base, which pays in relay-chain only, whose baseline it is.
    return usual + tuple(name for name in GOAL_TEAMS if name != "chain") * chooses


def find_team(name: str) -> Team:
    """Return one of `TEAMS`, or the team that a policy drives: of a run's folder, a file or the package.

    Raises:
        UnknownNameError: There is neither.
    """
    if team := named_team(name):
        return team
    try:
        source = load_policy(name)
    except UnknownNameError as error:
        # Both lists: a name that is neither may be a misspelt team or a misspelt policy.
        raise UnknownNameError(f"{name} is none of the teams {', '.join(TEAMS)}; {error}") from error
    return partial(with_training_view, source), source.policy


def training_note(team: str, task: TeamTask, name: str) -> str:
    """Return a warning if a team's policy was trained in buildings that it plays; empty if it was not.

    Args:
        team: As `find_team` takes it.
        task: The task as the team plays it.
        name: Name of the task.
    """
    if team == "packaged":
        source = replace(load_exported(POLICIES.get(packaged_name(name))), name=team)
    elif named_team(team):
        return ""
    else:
        source = load_policy(team)
    arenas = task.arenas
    if isinstance(arenas, GeneratedArenas):
        arenas = arenas.arenas()
    several = [arenas] if isinstance(arenas, str | ArenaSpec) else arenas
    return source.training_note([building_label(one) for one in several if isinstance(one, ArenaSpec)])


@dataclass(frozen=True, kw_only=True)
class TeamResult:
    """Result of a team.

    Attributes:
        name: As `find_team` takes it.
        score: Mean of the episodes.
        parts: Points of each part of the score, means of the episodes.
        finds: Points for finds by the end of each step, means of the episodes (steps,).
        outside: Share of the time that flying robots were not above the building.
        bad: Episodes left out as their physics failed.
        by_world: Score of each world's episode; NaN: its physics failed (worlds,).
        sent: Bytes that a robot sent a second, each receiver counted; None: not counted.
    """

    name: str
    score: Estimate
    parts: dict[str, float]
    finds: tuple[float, ...]
    outside: float
    bad: int
    by_world: tuple[float, ...] = ()
    sent: float | None = None

    @property
    def reached(self) -> tuple[float, ...]:
        """Share of the points for finds after each of `QUARTERS` of the time."""
        at = [round(share * len(self.finds)) - 1 for share in QUARTERS]
        # A team without finds: 0 of nothing.
        return tuple(self.finds[k] / max(self.finds[-1], 1e-9) for k in at)


TeamWatch = Callable[[str, Env, EnvState], None]
"""Sees a team's name, its worlds and a state of these."""


def ignore(name: str, env: Env, state: EnvState) -> None:
    """Look at nothing."""


def play_team(
    env: Env, task: TeamTask, policy: Policy, name: str, seed: int, watch: TeamWatch = ignore
) -> TeamResult:
    """Return a policy's result in the first episode of each world; `watch` sees all states but the last.

    Raises:
        UsageError: Robots come, go or drop out, so that episodes end early.
    """
    # The same seed for all teams: they differ by what they do, not by luck.
    act, carry, state = jax.jit(policy.act), policy.initial_carry(env.worlds), env.reset(seed)
    check_whole(env, state)
    good, rows, score = np.ones(env.worlds, bool), list[dict[str, np.ndarray]](), np.zeros(env.worlds)
    for step in range(env.episode_steps):
        watch(name, env, state)
        carry, actions = act(carry, state.obs, jax.random.fold_in(random.key(seed), step))
        state = env.step(state, actions)
        # For good: a bad world starts anew, and the final score it keeps is of an episode that was cut short.
        good &= ~np.asarray(state.bad)
        # Kept of the last step: there all episodes end together, see `check_whole`.
        score = np.asarray(state.final_score)
        rows.append({key: np.asarray(value, float) for key, value in state.metrics.items()})
    series = {key: np.stack([row[key] for row in rows])[:, good] for key in rows[0]}
    found = team_result(task, name, score[good], series, int((~good).sum()))
    return replace(found, by_world=tuple(np.where(good, score, np.nan).tolist()))


def team_result(
    task: TeamTask, name: str, scores: np.ndarray, series: dict[str, np.ndarray], bad: int = 0
) -> TeamResult:
    """Return a team's row from its scores (worlds,) and its metrics after each step (steps, worlds).

    Raises:
        UsageError: No episode ended well.
    """
    if not len(scores):
        raise UsageError(f"{name}: no episode ended well")
    parts = task.score_parts(series)
    # Penalties are parts, too, with at most 0 points.
    finds = sum(value.mean(-1) for part, value in parts.items() if task.most_points[part] > 0)
    return TeamResult(
        name=name,
        score=estimate_groups(scores),
        # Parts are points so far: the last step has those of the episode.
        parts={part: float(value[-1].mean()) for part, value in parts.items()},
        finds=tuple(np.asarray(finds).tolist()),
        outside=float(series["outside"].mean()) if "outside" in series else 0.0,
        bad=bad,
        sent=float(series["bytes"][-1].mean()) if "bytes" in series else None,
    )


def team_task(name: str, **overrides: object) -> TeamTask:
    """Return a team's task with overrides of its fields.

    Raises:
        UnknownNameError: No such task, or a field that it does not have.
        UsageError: A task without a team.
    """
    task = make_task(name, **overrides)
    if not isinstance(task, TeamTask):
        raise UsageError(f"{name} is no task for a team: its score has no parts")
    return task


def arenas_to_play(name: str, worlds: int | None, split: str, **overrides: object) -> tuple[ArenaSpec, ...]:
    """Return arenas of a split, which training leaves out: one for each world.

    Args:
        name: Name of a team task.
        worlds: Number, at most as many as the split has; fewer are spread over its levels and sizes. None:
            as many.
        split: A name of `SPLITS`.
        overrides: Fields of the task to set otherwise.

    Raises:
        UnknownNameError: No such split; lists those there are.
        UsageError: Its arenas are not generated.
    """
    arenas = arenas_of(name, overrides, split)
    there = arenas.total
    chosen, seeds = np.arange(min(worlds or there, there)), arenas.seeds().tolist()
    # Evenly over the numbers: a library holds its arenas by level and size in a row.
    numbers = (chosen * there // len(chosen)).tolist()
    return tuple(arenas.arena(number, seeds[number]) for number in numbers)


def task_to_play(
    name: str, worlds: int | None = None, split: str | None = None, **overrides: object
) -> tuple[TeamTask, int]:
    """Return a team's task with one arena for each world, and the number of worlds.

    Arguments and faults are those of `measure_teams`.
    """
    task = team_task(name, **overrides)
    if split is None:
        worlds, split = worlds or WORLDS, usual_split(name, overrides)
        if isinstance(task.arenas, GeneratedArenas):
            check_levels(task.arenas, worlds)
    if split is None:
        played = worlds or WORLDS
    else:
        arenas = arenas_to_play(name, worlds, split, **overrides)
        task, played = replace(task, arena=arenas), len(arenas)
    return task, played


def measure_teams(  # noqa: PLR0913 - all but the first may be left out
    name: str,
    worlds: int | None = None,
    seed: int = 0,
    engine: str = "auto",
    teams: Sequence[str] | None = None,
    tell: Callable[[TeamResult], None] = lambda row: None,
    watch: TeamWatch = ignore,
    split: str | None = None,
    warn: Callable[[str], None] = lambda note: None,
    **overrides: object,
) -> tuple[TeamResult, ...]:
    """Return the result of each team.

    Args:
        name: Name of a team task.
        worlds: Episodes, each in a building of its own, the same for all teams; None: `WORLDS`, or as many
            as a `split` that is given has, which is also the most.
        seed: Seed of the environments.
        engine: See `make`.
        teams: Names, see `find_team`; None: `default_teams`, of which one that does not fit is left out.
        tell: Receives each row as soon as it is known.
        watch: Sees every state of every team but the last one.
        split: Split of generated arenas, a name of `SPLITS`; None: `test`.
        warn: Is given a line for each policy that plays buildings of its training, or is left out.
        overrides: Fields of the task to set otherwise. Without `advice` among them, policies of runs and
            files see the planner's advice if they did in training.

    Raises:
        UnknownNameError: No such task, team or split, or a field that the task does not have.
        UsageError: A task without a team; worlds that are no multiple of the levels of generated arenas; a
            split of arenas that are not generated; a policy among `teams` that does not fit.
    """
    name = full_name(name)
    task, played = task_to_play(name, worlds, split, **overrides)
    envs: dict[TeamTask, Env] = {}  # each is compiled once
    ready: list[tuple[str, TeamTask, Policy]] = []
    chosen = default_teams(name) if teams is None else map(team_name, teams)
    # All are found before any world is built, which takes long: a wrong name fails at once.
    named = {team: find_team(team) for team in chosen}
    for team, (change, driver) in named.items():
        # The user's own advice counts for more than what a policy was trained with.
        own = task if not named_team(team) and "advice" in overrides else change(task)
        if own not in envs:
            envs[own] = build_env(own, played, name=name, engine=engine)
        try:
            ready.append((team, own, driver(envs[own])))
        # Usual teams need not fit a changed task; those that the user names must.
        except UsageError as error:
            if teams is not None:
                raise
            warn(f"{team} is left out: {error}")
    rows: list[TeamResult] = []
    # Only now, as all are ready: a policy that does not fit fails before the first one has played.
    for team, own, policy in ready:
        if note := training_note(team, own, name):
            warn(note)
        rows.append(play_team(envs[own], own, policy, team, seed, watch))
        tell(rows[-1])
    return tuple(rows)


def table(task: TeamTask, rows: Sequence[TeamResult]) -> str:
    """Return the rows as a Markdown table, below the most that each part can come to."""
    most = task.most_points
    best = [f"{points:g}" for points in most.values()]
    counted = any(row.sent is not None for row in rows)
    lines = [["at most", f"{sum(most.values()):g}", "", *best, "", "", "", "", *[""] * counted]]
    for row in rows:
        cells = [row.name, f"{row.score.value:.1f}", f"{row.score.low:.1f} to {row.score.high:.1f}"]
        cells += [f"{row.parts[part]:.1f}" for part in most]
        cells += [f"{100 * share:.0f} %" for share in (*row.reached, row.outside)]
        cells += ["" if row.sent is None else f"{row.sent:.0f}"] * counted
        lines.append(cells)
    head = ("team", "score", "95 % interval", *most, "1/4", "1/2", "3/4", "outside", *["bytes/s"] * counted)
    return markdown_table(head, lines)


def shares(rows: Sequence[TeamResult]) -> str:
    """Return the scores as shares between those of `random` (0) and `oracle` (1), in a line; empty without.

    Episodes of failed physics are left out, of all teams.
    """
    named = {row.name: np.array(row.by_world) for row in rows}
    if not {"random", "oracle"} <= named.keys():
        return ""
    # Of the same buildings for all, or a team's lost one would move its share.
    good = np.isfinite(np.stack([*named.values()])).all(0)
    low, high = (named[name][good].mean() for name in ("random", "oracle"))
    # In a few buildings the oracle may be no better than chance: no division by 0.
    found = {name: (one[good].mean() - low) / max(high - low, 1e-9) for name, one in named.items()}
    return "share of the oracle's: " + ", ".join(f"{name} {share:.2f}" for name, share in found.items())
