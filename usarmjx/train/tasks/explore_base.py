"""A team explores a building for its base: what counts has to get there."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE, SHARE
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.actions import Actions
from usarmjx.sim.scene import Scene
from usarmjx.train.envs.layout import NO_PICTURE, ObservationLayout, Picture
from usarmjx.train.envs.presence import Presence
from usarmjx.train.envs.task import StepResult, TaskView
from usarmjx.train.mapping.belief import SECTOR_COUNT, Belief, update_base_contact
from usarmjx.train.mapping.goals import WAY_SQUARES, Goals, find_goals, next_on_way, way_to, where_due
from usarmjx.train.mapping.maps import FREE, UNKNOWN, WALL, MapGrid, to_robot_frame
from usarmjx.train.mapping.planning import near_others
from usarmjx.train.mapping.pyramid import CHANNELS, LEVELS, WIDTH, map_pyramid
from usarmjx.train.mapping.wavefront import frontier
from usarmjx.train.mapping.way_driving import frontier_action
from usarmjx.train.tasks.attrition import drawn_team, remaining_robots
from usarmjx.train.tasks.equip import base_station, mapping_robot
from usarmjx.train.tasks.goal_features import (
    CONTACT_SCALE,
    FRONTIERS,
    GOAL_NUMBERS,
    GOALS,
    KNOWN_SCALE,
    MATE_AGE,
    MATE_NUMBERS,
    MATES,
    NEWS_SCALE,
    OBSERVATION_SIZE,
    OBSERVED_MATES,
    OWN_NUMBERS,
    TEAM_SCALE,
    TIME_SCALE,
    GoalView,
    Mates,
    chosen_goal,
    goal_features,
    heard_of,
    mate_features,
    nearest_mates,
    sector_features,
)
from usarmjx.train.tasks.team import (
    PROGRESS_SCALE,
    WAYPOINT_SCALE,
    TeamMemory,
    TeamTask,
    coverage,
    station_slot,
    true_pose_features,
)

TRUTH_WIDTH = 16
"""Squares along a side of the maps that critics see."""
RECENT_REPORT = 1.0
"""A robot whose beliefs had come to the base so short a time ago has nothing new for it [s]."""


class ExploreBaseState(struct.PyTreeNode, kw_only=True):
    """The task's memory of reports and goals.

    Attributes:
        mapped: Which squares of the building the base has on its map (i, j).
        reported: Free squares on each robot's map when the base last had all of it (robots,).
        shared: Free squares on each robot's map when it last had a link to each other one (robots, robots).
        goals: Goals of each robot as of the last choice (robots, goals, ...).
        chosen: Which of them it chose (robots,).
        way: Next positions on the way there [m] (robots, WAY_SQUARES, 2).
        sent: Free squares on each robot's map when the base last had all of it, if pictures show them
            (robots, i, j); else empty.
        picture: Pictures of the robots' maps as of the last choice (robots, LEVELS, WIDTH, WIDTH, channels);
            else empty.
    """

    mapped: jax.Array
    reported: jax.Array
    shared: jax.Array
    goals: Goals
    chosen: jax.Array
    way: jax.Array
    sent: jax.Array | tuple[()] = ()
    picture: jax.Array | tuple[()] = ()


class KnownMaps(struct.PyTreeNode, kw_only=True):
    """Facts that goals and ways of robots depend on.

    Attributes:
        squares: Their maps (robots, i, j).
        reachable: Squares that robots get to, for an oracle (i, j).
        pose: Their poses (robots, 3).
        headers: Headers that they received, see `Belief` (robots, robots, HEADER_SIZE).
        age: Age of these [s] (robots, robots).
        mates: The others that are goals (robots, MATES).
    """

    squares: jax.Array
    reachable: jax.Array
    pose: jax.Array
    headers: jax.Array
    age: jax.Array
    mates: Mates


@dataclass(frozen=True, kw_only=True)
class ExploreBase(TeamTask):
    """Explore a building for a base: a square counts once the base has it on its map.

    A base station stands at the first start pose. It takes part in the mail: it sends its map, and draws into
    it what it receives. Robots that meet copy each other's maps; so a square comes to the base with the robot
    that saw it, over links of others, or with a robot that met its finder.

    Score, over the n steps of an episode: 100 times the mean over all steps of the share of the building that
    is free on the base's map, for a `haste` of 1; with less, the share at the end counts the more, see
    `TeamTask`; less `price` for every contact.

    Each robot has up to 19 goals: its base, the two nearest robots that it has heard of, and a frontier of
    each of the 16 nearest blocks of its map of 2.4 m.

    Action `goals`: a number for each goal; the robot takes the valid one with the greatest, every `hold`
    steps, and one given controller drives it there along the shortest way on its own map. Action `wheels`:
    speed and turn, as `TeamTask`; the way leads to the goal of the planner that brings news home.

    Observation, in the robot's axes: see `goal_features`. Its size depends neither on the team nor on the
    building. The last 19 numbers say which goals are valid. With `observed=map` a picture of the robot's
    whole map at three scales stands before them, see `mapping.pyramid`.

    Reward: the points that a step adds to the score. Robots that touch something pay for their contacts.
    Points for squares that come onto the base's map are shared equally by all robots, except the share
    `found`: it goes to the robots whose own scans show the square, whoever reported it. Besides, each robot
    gets `hint` times 100 times the share of the building that it was the first to see; this is not part of
    the score.

    Attributes:
        robot: Class of the robots, or their description.
        count: Number of robots.
        actions: Kind of the actions, see above.
        hold: Steps for which a goal is kept.
        hint: Reward for squares that a robot explores.
        found: Share of the reward for squares on the base's map that goes to those that saw them.
        observed: Whether robots see their goals only, or also the picture of their map.
        least_robots: Least number of robots; each world draws its number, up to `count`, at each reset. 0:
            always `count`.
        oracle: Let the robots know the building: their ways lead through what they have not seen, and every
            square that is not on their maps is a frontier. A bound, not a method.
    """

    about: ClassVar[str] = "A team explores a building for its base."
    reports: ClassVar[bool] = True
    decides: ClassVar[bool] = True

    episode_steps: int = 800
    haste: float = 0.5
    robot: str | RobotSpec = "P2AT"
    count: Annotated[int, AT_LEAST_ONE] = 4
    actions: Literal["goals", "wheels"] = "goals"
    hold: Annotated[int, AT_LEAST_ONE] = 8
    hint: Annotated[float, NOT_NEGATIVE] = 0.1
    found: Annotated[float, SHARE] = 0.0
    observed: Literal["goals", "map"] = "goals"
    least_robots: Annotated[int, NOT_NEGATIVE] = 0
    oracle: bool = False

    def problem(self) -> str:
        """Return a conflict between settings."""
        if not self.advice:
            return "advice is false, but robots of this task see no advice"
        if self.observed == "map" and not self.discrete:
            return "observed is map, but with actions=wheels robots see no picture"
        wrong = self.least_robots > self.count
        return f"least_robots is {self.least_robots}, but the team has {self.count} robots" if wrong else ""

    @property
    def robots(self) -> tuple[RobotSpec, ...]:
        """The base, and the team."""
        return (base_station(), *(mapping_robot(self.robot),) * self.count)

    @property
    def discrete(self) -> bool:
        """Goals are choices."""
        return self.actions == "goals"

    def action_sizes(self, scene: Scene) -> tuple[int, ...]:
        """A number for each goal, or speed and turn."""
        return (GOALS if self.discrete else 2,) * len(self.agent_groups(scene))

    def layout(self, scene: Scene) -> ObservationLayout | None:
        """As `Task`: the robot, the others, the goals, and perhaps the picture."""
        del scene
        if not self.discrete:
            return None
        return ObservationLayout(
            own=OWN_NUMBERS + SECTOR_COUNT,
            others=(OBSERVED_MATES, MATE_NUMBERS),
            choices=(GOALS, GOAL_NUMBERS),
            kinds=(0, *(1,) * MATES, *(2,) * FRONTIERS),
            picture=Picture(LEVELS, WIDTH, len(CHANNELS)) if self.pictures else NO_PICTURE,
        )

    @property
    def pictures(self) -> bool:
        """Whether robots see pictures of their maps."""
        return self.observed == "map"

    # Members of the team.

    def team(self, scene: Scene, key: jax.Array) -> jax.Array | None:
        """Those that the world draws."""
        if not self.least_robots:
            return None
        return drawn_team(scene, self.agents(scene), self.least_robots, key)

    def presence(self, view: TaskView, memory: TeamMemory) -> Presence | None:
        """Those that the world has drawn."""
        del memory
        if not self.least_robots:
            return None
        agents, nobody = self.agents(view.scene), np.zeros(view.scene.num_robots, int)
        return remaining_robots(view, agents, self.least_robots, nobody, self.repeat, 0.0)

    def working(self, view: TaskView, memory: TeamMemory) -> jax.Array | None:
        """As `TeamTask`: those that are alive."""
        presence = self.presence(view, memory)
        return None if presence is None else presence.alive

    # Beliefs of the robots, and their ways.

    def update_task_belief(self, view: TaskView, belief: Belief) -> Belief:
        """Look at the radio."""
        if view.world.links is None or self.talk == "none":
            return belief
        return update_base_contact(belief, view.links.in_range, station_slot(view.scene), view.time)

    def plan(self, view: TaskView, belief: Belief) -> Belief:
        """Keep goals: they are chosen by `decide`."""
        del view
        return belief

    def known(self, view: TaskView, memory: TeamMemory) -> KnownMaps:
        """Return what goals and ways depend on."""
        belief = memory.belief
        return KnownMaps(
            squares=belief.squares,
            reachable=memory.reachable,
            pose=belief.pose,
            headers=belief.mate_headers,
            age=view.time - belief.heard_time,
            mates=nearest_mates(belief, station_slot(view.scene), view.time, MATES),
        )

    def find(self, scene: Scene, known: KnownMaps) -> Goals:
        """Return the goals of all robots, by slot (robots, GOALS, ...)."""
        grid, robots, base = self.arena_grid(scene), scene.num_robots, station_slot(scene)
        mates = known.mates
        heads = known.headers[np.arange(robots)[:, None], mates.slot]
        home = jnp.broadcast_to(known.pose[base, :2], (robots, 1, 2))
        places = jnp.concatenate([home, heads[..., :2]], 1)
        unseen = known.reachable & (known.squares == UNKNOWN)
        ends = unseen if self.oracle else jax.vmap(frontier)(known.squares)
        facts = self.drivable(known), known.pose, ends, places, _blocked(grid, known)

        def one(
            squares: jax.Array, pose: jax.Array, ends: jax.Array, places: jax.Array, blocked: jax.Array
        ) -> Goals:
            return find_goals(grid, squares, pose, ends, places, blocked=blocked, count=FRONTIERS)

        goals = _of_agents(jax.vmap(one), self.agents(scene), robots, facts)
        here = jnp.ones((robots, 1), bool)
        real = jnp.concatenate([here, mates.valid, jnp.repeat(here, FRONTIERS, 1)], 1)
        # The base is always a goal; without a way there a robot waits.
        return goals.replace(valid=(goals.valid & real).at[:, 0].set(True))

    def drivable(self, known: KnownMaps) -> jax.Array:
        """Return the maps that ways lead over; an oracle's is the building (robots, i, j)."""
        if not self.oracle:
            return known.squares
        truth = jnp.where(known.reachable, FREE, WALL).astype(jnp.uint8)
        return jnp.broadcast_to(truth, known.squares.shape)

    def decide(self, view: TaskView, memory: TeamMemory, actions: tuple[jax.Array, ...]) -> TeamMemory:
        """Take the robots' choices when these are due, and find ways there."""
        extra, scene = memory.extra, view.scene
        due = memory.step % self.hold == 0
        if self.discrete:
            wanted = jnp.zeros((scene.num_robots, GOALS))
            for group, action in zip(self.agent_groups(scene), actions, strict=True):
                wanted = wanted.at[scene.groups[group].slots].set(action)
            choice = jnp.where(extra.goals.valid, wanted, -jnp.inf).argmax(-1)
        else:
            choice = chosen_goal(
                self.observations(view, memory)[:, -OBSERVATION_SIZE:], self.cell, report=True
            )
        chosen = jnp.where(due, choice, extra.chosen).astype(jnp.int32)
        goal = _picked(extra.goals.position, chosen)
        way = where_due(partial(self.ways, scene), due, extra.way, self.known(view, memory), goal)
        return memory.replace(extra=extra.replace(chosen=chosen, way=way))

    def ways(self, scene: Scene, known: KnownMaps, goal: jax.Array) -> jax.Array:
        """Return ways to goals (robots, 2), by slot (robots, WAY_SQUARES, 2)."""
        grid = self.arena_grid(scene)

        def one(squares: jax.Array, pose: jax.Array, goal: jax.Array, blocked: jax.Array) -> jax.Array:
            return way_to(grid, squares, pose, goal, blocked=blocked)

        facts = self.drivable(known), known.pose, goal, _blocked(grid, known)
        return _of_agents(jax.vmap(one), self.agents(scene), scene.num_robots, facts)

    def act(self, view: TaskView, memory: TeamMemory, actions: tuple[jax.Array, ...]) -> Actions:
        """As `TeamTask`; wheels turn as the controller wants if actions are goals."""
        memory = memory.replace(belief=self.followed(memory))
        if self.discrete:
            drive = frontier_action(self.controller_input(memory), self.episode_steps)
            actions = self.per_group(view.scene, drive)
        return super().act(view, memory, actions)

    def followed(self, memory: TeamMemory) -> Belief:
        """Return the belief with the next position on each robot's way, and where that leads."""
        belief, extra = memory.belief, memory.extra
        waypoint = jax.vmap(next_on_way)(extra.way, belief.pose[:, :2])
        goal, length = (_picked(x, extra.chosen) for x in (extra.goals.position, extra.goals.length))
        return belief.replace(waypoint=waypoint, goal=goal, path_length=length)

    def controller_input(self, memory: TeamMemory) -> jax.Array:
        """Return what the controller of ways looks at, in the order of `TeamTask` (robots, n)."""
        belief = memory.belief
        moved = jnp.linalg.norm(belief.pose[:, :2] - belief.lagged_position, axis=-1)
        left = jnp.broadcast_to(1 - memory.step / self.episode_steps, moved.shape)
        rows = [
            to_robot_frame(belief.pose, belief.waypoint) / WAYPOINT_SCALE,
            jnp.zeros((len(moved), 3)),
            jnp.minimum(moved / PROGRESS_SCALE, 1.0)[:, None],
            sector_features(belief),
            left[:, None],
        ]
        return jnp.concatenate(rows, -1)

    # Evaluation.

    def start(self, view: TaskView, key: jax.Array) -> TeamMemory:
        """Nothing is reported."""
        memory = super().start(view, key)
        pose = memory.belief.pose
        memory = memory.replace(
            extra=ExploreBaseState(
                mapped=memory.reachable & (memory.belief.squares[station_slot(view.scene)] == FREE),
                reported=jnp.zeros(len(pose)),
                shared=jnp.zeros((len(pose), len(pose))),
                goals=self.find(view.scene, self.known(view, memory)),
                chosen=jnp.zeros(len(pose), jnp.int32),
                way=jnp.broadcast_to(pose[:, None, :2], (len(pose), WAY_SQUARES, 2)),
            )
        )
        memory = self._noted(view, memory)
        if not self.pictures:
            return memory
        sent = self._sent(view, memory)
        picture = self.picture(view.scene, self.known(view, memory), sent)
        return memory.replace(extra=memory.extra.replace(sent=sent, picture=picture))

    def picture(self, scene: Scene, known: KnownMaps, sent: jax.Array) -> jax.Array:
        """Return the pictures of all robots' maps, by slot (robots, LEVELS, WIDTH, WIDTH, channels)."""
        grid, robots, base = self.arena_grid(scene), scene.num_robots, station_slot(scene)
        there = ~np.eye(robots, dtype=bool) & (np.arange(robots) != base)
        news = (known.squares == FREE) & ~sent
        facts = known.squares, news, known.pose, known.headers[..., :2], (known.age < MATE_AGE) & there
        return _of_agents(jax.vmap(partial(map_pyramid, grid)), self.agents(scene), robots, facts)

    def _sent(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the free squares on each robot's map when the base last had all of it (robots, i, j)."""
        belief, before = memory.belief, memory.extra.sent
        recent = view.time - belief.base_contact_time < RECENT_REPORT
        free = belief.squares == FREE
        return jnp.where(recent[:, None, None], free, False if isinstance(before, tuple) else before)

    def _noted(self, view: TaskView, memory: TeamMemory) -> TeamMemory:
        """Return the memory with what the base and the others have got to know."""
        belief, extra = memory.belief, memory.extra
        recent = view.time - belief.base_contact_time < RECENT_REPORT
        free = (belief.squares == FREE).sum((1, 2)).astype(jnp.float32)
        reported = jnp.where(recent, free, extra.reported)
        shared = jnp.where(_linked(view), free[:, None], extra.shared)
        return memory.replace(extra=extra.replace(reported=reported, shared=shared))

    def shares(self, view: TaskView, memory: TeamMemory, news: jax.Array) -> jax.Array:
        """Return how many squares that come onto the base's map (i, j) count for each slot (robots,)."""
        equal = jnp.full(view.scene.num_robots, news.sum() / len(self.agents(view.scene)))
        if not self.found:
            return equal
        return (1 - self.found) * equal + self.found * self.finders(view, memory, news)

    def evaluate(self, view: TaskView, memory: TeamMemory) -> StepResult:
        """Squares on the base's map, and contacts."""
        steps, scene, before = self.episode_steps, view.scene, memory.extra
        worth = self.worth((steps - memory.step) / steps)  # this step's number is one more
        squares = jnp.maximum(memory.reachable.sum(), 1)
        first = 100.0 * before.mapped.sum() / squares
        memory, credit, begun = self.advance(view, memory)
        base = station_slot(scene)
        mapped = before.mapped | (memory.reachable & (memory.belief.squares[base] == FREE))
        memory = self._noted(view, memory.replace(extra=before.replace(mapped=mapped)))
        due, known = memory.step % self.hold == 0, self.known(view, memory)
        goals = where_due(partial(self.find, scene), due, before.goals, known)
        if self.pictures:
            sent = self._sent(view, memory)
            picture = where_due(partial(self.picture, scene), due, before.picture, known, sent)
            memory = memory.replace(extra=memory.extra.replace(sent=sent, picture=picture))
        point = 100.0 * worth / squares
        news = mapped & ~before.mapped
        gain = point * news.sum()
        contacts = self.price * begun
        score = memory.score + jnp.where(memory.step == memory.skipped + 1, first, 0.0)
        memory = memory.replace(extra=memory.extra.replace(goals=goals), score=score + gain - contacts.sum())
        reward = point * self.shares(view, memory, news) + self.hint * 100.0 * credit - contacts
        return StepResult(
            memory=memory,
            reward=self.per_group(scene, reward),
            terminated=jnp.zeros((), bool),
            score=memory.score,
            metrics={**self.metrics(memory), "mapped": mapped.sum() / squares},
        )

    def finders(self, view: TaskView, memory: TeamMemory, news: jax.Array) -> jax.Array:
        """Return how many of the squares that came to the base (i, j) each slot has found (robots,).

        The robots whose own scans show a square to be free share it equally; if there are none, all agents
        do. Robots that report it get nothing for that: else it would pay to wait beside the base and pass on
        the maps of others.
        """
        agents = self.agents(view.scene)
        has = memory.belief.evidence[agents] < 0
        has = (has | ~has.any(0)) & news
        parts = (has / jnp.maximum(has.sum(0), 1)).sum((1, 2))
        return jnp.zeros(view.scene.num_robots).at[agents].set(parts)

    def score_parts(self, series: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Points for the base's map, and the contacts'."""
        return {"mapped": 100.0 * self.paid(series["mapped"]), **super().score_parts(series)}

    @property
    def most_points(self) -> dict[str, float]:
        """The score if the base had all on its map at the start."""
        return {"mapped": 100.0, **super().most_points}

    # Observations.

    def observations(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """See `goal_features`; with wheels, the way of `TeamTask` before it."""
        belief, extra, scene = memory.belief, memory.extra, view.scene
        base, robots = station_slot(scene), scene.num_robots
        linked = _linked(view)
        free = (belief.squares == FREE).sum((1, 2)).astype(jnp.float32)
        left = 1 - memory.step / self.episode_steps
        seconds = left * self.episode_steps * self.repeat * scene.physics.period
        moved = jnp.linalg.norm(belief.pose[:, :2] - belief.lagged_position, axis=-1)
        own = [
            jnp.broadcast_to(left, (robots,)),
            jnp.broadcast_to(seconds / TIME_SCALE, (robots,)),
            jnp.minimum(moved / PROGRESS_SCALE, 1.0),
            linked[:, base],
            jnp.minimum((view.time - belief.base_contact_time) / CONTACT_SCALE, 1.0),
            jnp.maximum(free - extra.reported, 0.0) / NEWS_SCALE,
            free / KNOWN_SCALE,
            heard_of(belief, base, view.time).sum(-1) / TEAM_SCALE,
        ]
        grid = self.arena_grid(scene)
        untold = jnp.maximum(free[:, None] - extra.shared, 0.0)
        untold = untold.at[:, base].set(jnp.maximum(free - extra.reported, 0.0))
        rows = [
            jnp.stack([jnp.asarray(one, jnp.float32) for one in own], -1),
            sector_features(belief),
            mate_features(belief, base, view.time, linked, untold),
            goal_features(
                grid, belief, extra.goals, extra.chosen, GoalView(base, view.time, seconds, untold)
            ),
            *([extra.picture.reshape(robots, -1)] if self.pictures else []),
            extra.goals.valid,
        ]
        way = [] if self.discrete else [self.controller_input(memory.replace(belief=self.followed(memory)))]
        return jnp.concatenate([*way, *rows], -1).astype(jnp.float32)

    def baseline_obs(
        self, scene: Scene, memory: TeamMemory, obs: tuple[jax.Array, ...]
    ) -> tuple[jax.Array, ...]:
        """As `Task`."""
        del scene, memory
        return obs

    def privileged(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """As `TeamTask`, and the true maps: the building, what is explored, and what the base has."""
        facts = [coverage(memory), memory.step / self.episode_steps, memory.score / 100.0]
        truth = [memory.reachable, memory.explored, memory.extra.mapped]
        maps = [_coarse(one).ravel() for one in truth]
        return jnp.concatenate([jnp.stack(facts), *maps, true_pose_features(view)])


def _linked(view: TaskView) -> jax.Array:
    """Return which robots have links (robots, robots)."""
    robots = view.scene.num_robots
    return jnp.zeros((robots, robots), bool) if view.world.links is None else jnp.asarray(view.links.in_range)


def _picked(values: jax.Array, chosen: jax.Array) -> jax.Array:
    """Return the chosen row (robots,) of each robot's values (robots, n, ...)."""
    return values[jnp.arange(len(chosen)), chosen]


def _blocked(grid: MapGrid, known: KnownMaps) -> jax.Array:
    """Return the squares that others take, for each robot (robots, i, j)."""
    own = jnp.eye(len(known.pose), dtype=bool)
    return jax.vmap(partial(near_others, grid))(known.headers, jnp.where(own, jnp.inf, known.age))


def _of_agents(
    run: Callable[..., Any],
    agents: np.ndarray,
    robots: int,
    facts: tuple[jax.Array, ...],
) -> Any:  # noqa: ANN401 - a PyTree
    """Return what a function computes of the agents' rows, and zeros for the others (robots, ...)."""
    found = run(*(one[agents] for one in facts))
    return jax.tree.map(lambda x: jnp.zeros((robots, *x.shape[1:]), x.dtype).at[agents].set(x), found)


def _coarse(mask: jax.Array) -> jax.Array:
    """Return the share of a mask (i, j) in each of `TRUTH_WIDTH` times as many blocks."""
    sides = [-(-side // TRUTH_WIDTH) for side in mask.shape]
    missing = [(0, side * TRUTH_WIDTH - length) for side, length in zip(sides, mask.shape, strict=True)]
    whole = jnp.pad(mask.astype(jnp.float32), missing)  # pyright: ignore[reportUnknownMemberType]
    return whole.reshape(TRUTH_WIDTH, sides[0], TRUTH_WIDTH, sides[1]).mean((1, 3))
