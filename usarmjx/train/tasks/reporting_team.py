"""Tasks whose score counts reports to the base of a team: maps of a building, and victims."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import get_rows, set_rows
from usarmjx.base.settings import POSITIVE, SHARE
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.scene import Scene
from usarmjx.train.envs.task import TaskView
from usarmjx.train.mapping.belief import Belief
from usarmjx.train.mapping.maps import FREE, MARK, UNKNOWN, MapGrid, classify_scan, to_robot_frame
from usarmjx.train.mapping.planning import box_sum
from usarmjx.train.tasks.critic_features import victim_features
from usarmjx.train.tasks.equip import VICTIM_FOV, victim_search_robot
from usarmjx.train.tasks.goal_state import GoalState, KnownMaps, Progress
from usarmjx.train.tasks.goal_team import GoalTeam
from usarmjx.train.tasks.team import TeamMemory, scan_of, station_slot
from usarmjx.train.tasks.victim_search import mark_victims, victims_there


@dataclass(frozen=True, kw_only=True)
class ReportingTeam(GoalTeam):
    """Tell a base about things: each counts once the base has it on its map.

    Score, over the n steps of an episode and the m things of a world: a thing that comes to the base in step
    k pays 100 / m times 1 - `haste` (k - 1) / n; less `price` for every contact.

    Reward: the points that a step adds to the score. All robots share the points for things equally, except
    the share `found`: it goes to the robots that saw the thing themselves, whoever reported it.

    Attributes:
        found: Share of the reward for reports that goes to those that saw what is reported.
    """

    part: ClassVar[str] = "reported"
    """Name of the share of the things that the base has, and of its part of the score."""

    found: Annotated[float, SHARE] = 0.0

    @abstractmethod
    def things(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return which things there are in a world (things,)."""

    @abstractmethod
    def at_base(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return which things the base's map shows now (things,)."""

    @abstractmethod
    def sighted(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return which agents have seen which things themselves (agents, things)."""

    def nothing(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the things that the base has at the start (things,)."""
        return self.things(view, memory) & self.at_base(view, memory)

    def progress(self, view: TaskView, memory: TeamMemory, worth: jax.Array) -> Progress:
        """Things that come to the base."""
        before, things = memory.extra.achieved, self.things(view, memory)
        # An arena without things scores 0, not NaN.
        number = jnp.maximum(things.sum(), 1)
        # Kept: a square that the base's map loses and shows again must not pay twice.
        has = before | (things & self.at_base(view, memory))
        news, point = has & ~before, 100.0 * worth / number
        return Progress(
            achieved=has,
            points=point * news.sum(),
            reward=point * self.shares(view, memory, news),
            metrics={self.part: has.sum() / number},
        )

    def shares(self, view: TaskView, memory: TeamMemory, news: jax.Array) -> jax.Array:
        """Return how many things that come to the base (things,) count for each slot (robots,)."""
        equal = jnp.full(view.scene.num_robots, news.sum() / len(self.agents(view.scene)))
        # A setting, so the choice is made while tracing: finders need a map per robot.
        if not self.found:
            return equal
        return (1 - self.found) * equal + self.found * self.finders(view, memory, news)

    def finders(self, view: TaskView, memory: TeamMemory, news: jax.Array) -> jax.Array:
        """Return how many of the things that came to the base (things,) each slot has found (robots,).

        The robots that saw a thing themselves share it equally; if there are none, all agents do. Robots that
        report it get nothing for that: else it would pay to wait beside the base and pass on the maps of
        others.
        """
        agents, has = self.agents(view.scene), self.sighted(view, memory)
        # A thing that nobody saw, as one by a mark beside it, is everybody's.
        has = (has | ~has.any(0)) & news
        # Things are squares (i, j) or victims: one axis stands for both.
        parts = (has / jnp.maximum(has.sum(0), 1)).reshape(len(agents), -1).sum(1)
        return set_rows(jnp.zeros(view.scene.num_robots), (agents, parts))

    def score_parts(self, series: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Points for reports, and the contacts'."""
        return {self.part: 100.0 * self.paid(series[self.part]), **super().score_parts(series)}

    @property
    def most_points(self) -> dict[str, float]:
        """The score if the base had all at the start."""
        return {self.part: 100.0, **super().most_points}


@dataclass(frozen=True, kw_only=True)
class ExploreBase(ReportingTeam):
    """Explore a building for a base: a square counts once the base has it on its map.

    See `GoalTeam` for goals, actions and observations, `ReportingTeam` for score and reward. The things are
    the squares of the building; a robot has seen a square if its own scans show it to be free. For an oracle
    every square that is not on its map is a frontier.
    """

    about: ClassVar[str] = "A team explores a building for its base."
    part: ClassVar[str] = "mapped"

    def ends(self, known: KnownMaps) -> jax.Array:
        """Return the frontiers of each robot (robots, i, j)."""
        ends = super().ends(known)
        return ends & (known.squares == UNKNOWN) if self.oracle else ends

    def things(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the squares of the building (i, j)."""
        del view
        return memory.reachable

    def at_base(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the squares that are free on the base's map (i, j)."""
        return memory.belief.squares[station_slot(view.scene)] == FREE

    def sighted(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the squares that each agent's own scans show to be free (agents, i, j)."""
        return memory.belief.evidence[self.agents(view.scene)] < 0

    def wanted(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return what the base has (i, j)."""
        del view
        return memory.extra.achieved


LOOK_RANGE = 3.0
"""Distance up to which a robot looks for victims [m]."""
LOOK_ANGLE = VICTIM_FOV / 2
"""Angle from straight ahead up to which it does [rad]."""
LOOK_BOX, LOOK_SHARE = 2, 0.5
"""A square is worth a look if this share of the squares so far around it, along both axes, is."""
AT_PLACE, TRY_RADIUS = 0.45, 0.75
"""Distance from a place at which an oracle is there, and around the robot within which it need not try again
[m]."""
FAR_AWAY = np.float32(1e6)
"""Coordinate of what is not to be looked at [m]."""


def in_view(grid: MapGrid, pose: jax.Array) -> jax.Array:
    """Return which squares a victim sensor at a pose (3,) is turned to, near enough (i, j)."""
    away = jnp.asarray(grid.centres) - pose[:2]
    ahead = away[..., 0] * jnp.cos(pose[2]) + away[..., 1] * jnp.sin(pose[2])
    distance = jnp.linalg.norm(away, axis=-1)
    # Times the distance, so that a robot's own square needs no division. `np.cos` gives float64, which is no
    # weak type and would widen all with x64.
    return (distance < LOOK_RANGE) & (ahead >= distance * np.float32(np.cos(LOOK_ANGLE)))


@dataclass(frozen=True, kw_only=True)
class SearchBase(ReportingTeam):
    """Find victims and tell a base where they are.

    See `GoalTeam` for goals, actions and observations, `ReportingTeam` for score and reward. The things are
    the victims. A robot that meets a part of a victim with its victim sensor puts a mark on the square in
    which the middle of that part is; marks travel with maps. A mark stands for the victim that is nearest to
    it, if that is within `near`, in the plane, and for no other: so a report says which victim it is, and
    where. A victim is reported as soon as the base has a mark that stands for it; more of these add nothing.

    News are marks, as many squares each as `news_worth` says. Frontiers are also places that a robot's
    scanner has seen and its victim sensor, which looks ahead only, has not. For an oracle the
    places nearest to victims that are not reported are the only ones.

    Attributes:
        near: Distance from a victim within which a mark is right [m].
    """

    about: ClassVar[str] = "A team finds victims and reports them to its base."
    news_kind: ClassVar[int] = MARK
    news_worth: ClassVar[float] = 300.0

    near: Annotated[float, POSITIVE] = 1.5

    def member(self) -> RobotSpec:
        """Return a robot with a victim sensor."""
        return victim_search_robot(self.robot)

    def update_task_belief(self, view: TaskView, belief: Belief) -> Belief:
        """Mark what victim sensors met, and look at the radio."""
        belief = mark_victims(view, self.arena_grid(view.scene), belief)
        return super().update_task_belief(view, belief)

    def advance(self, view: TaskView, memory: TeamMemory) -> tuple[TeamMemory, jax.Array, jax.Array]:
        """As `TeamTask`; robots remember when they last learned of a mark."""
        before = self.news(memory.belief)
        memory, credit, begun = super().advance(view, memory)
        belief = memory.belief
        when = jnp.where(self.news(belief) > before, view.time, belief.mark_time)
        memory = memory.replace(belief=belief.replace(mark_time=when))
        looks = self.tries(view, memory) if self.oracle else self.looks(view, belief)
        looked = memory.extra.looked | looks
        return memory.replace(extra=memory.extra.replace(looked=looked)), credit, begun

    def first_state(self, view: TaskView, memory: TeamMemory) -> GoalState:
        """As `GoalTeam`, and the first looks."""
        state = super().first_state(view, memory)
        if self.oracle:
            none = jnp.zeros((len(victims_there(view)), *memory.reachable.shape), bool)
            return state.replace(looked=none)
        return state.replace(looked=self.looks(view, memory.belief))

    def looks(self, view: TaskView, belief: Belief) -> jax.Array:
        """Return the squares that robots look at now, as far as scans show them free (robots, i, j)."""
        grid, found = self.arena_grid(view.scene), jnp.zeros_like(belief.visited)
        for g in self.agent_groups(view.scene):
            scan = scan_of(view, g, get_rows(belief.pose, view.scene.groups[g].slots))
            free, _ = jax.vmap(partial(classify_scan, grid, scan.settings))(scan.poses, scan.ranges)
            ahead = jax.vmap(partial(in_view, grid))(scan.poses)
            found = set_rows(found, (scan.slots, free & ahead & scan.fresh[:, None, None]))
        return found

    def pending(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the squares that robots have scanned, but neither looked at nor visited (robots, i, j)."""
        del view
        belief = memory.belief
        return (belief.evidence < 0) & ~(memory.extra.looked | belief.visited)

    def ends(self, known: KnownMaps) -> jax.Array:
        """As `GoalTeam`, and the middles of what robots have not looked at (robots, i, j)."""
        ends = super().ends(known)
        if self.oracle:
            return ends
        # Single squares that a look has missed are no place to go to.
        around = jax.vmap(partial(box_sum, radius=LOOK_BOX))(known.targets)
        wide = around >= LOOK_SHARE * (2 * LOOK_BOX + 1) ** 2
        return ends | (known.targets & wide & (known.squares == FREE))

    def base_is_informed(self, view: TaskView, belief: Belief) -> jax.Array:
        """As `GoalTeam`: marks are few, so it is known whether the last one came to the base."""
        del view
        return belief.mark_time < belief.base_contact_time

    def known(self, view: TaskView, memory: TeamMemory) -> KnownMaps:
        """As `GoalTeam`; an oracle knows where to look."""
        known = super().known(view, memory)
        if not self.oracle:
            return known
        wanted = victims_there(view) & ~memory.extra.achieved
        # Far from any goal: a robot at the place of one victim does not turn to another that is reported.
        sights = jnp.where(wanted[:, None], jnp.asarray(view.victims.at)[:, :2], FAR_AWAY)
        return known.replace(sights=sights)

    def places(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the place nearest to each victim that robots get to (victims, i, j).

        It is another one where robots have looked from there in vain, as through a wall.
        """
        gap = self.arena_grid(view.scene).gaps(jnp.asarray(view.victims.at)[:, :2])
        allowed = memory.reachable & ~memory.extra.looked if self.oracle else memory.reachable
        gap = jnp.where(allowed, gap, jnp.inf)
        nearest = gap.min((1, 2), keepdims=True)
        # Equal to the last bit, as the least gap is one of them. Where no square is allowed all gaps are
        # infinite and equal, too: the range excludes these.
        return (gap == nearest) & (nearest < LOOK_RANGE) & victims_there(view)[:, None, None]

    def tries(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the squares around robots that are turned to victims from their places (victims, i, j)."""
        grid, pose = self.arena_grid(view.scene), memory.belief.pose[self.agents(view.scene)]
        away = to_robot_frame(pose[:, None], jnp.asarray(view.victims.at)[:, :2])
        # Half of the view: a robot that turns has had the victim in view by then.
        faced = away[..., 0] > jnp.linalg.norm(away, axis=-1) * np.float32(np.cos(LOOK_ANGLE / 2))
        gap = grid.gaps(pose[:, :2])[:, None]
        there = ((gap < AT_PLACE) & self.places(view, memory)).any((2, 3))
        return ((gap < TRY_RADIUS) & (faced & there)[..., None, None]).any(0)

    def targets(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the places of victims that are not reported (i, j)."""
        return (self.places(view, memory) & ~memory.extra.achieved[:, None, None]).any(0)

    def ways(self, scene: Scene, known: KnownMaps, goal: jax.Array) -> jax.Array:
        """As `GoalTeam`; behind the place of a victim an oracle's way leads to the victim: it turns there."""
        way = super().ways(scene, known, goal)
        # Without victims there is no nearest one: the least of no gaps is an error.
        if isinstance(known.sights, tuple) or not len(known.sights):
            return way
        gap = jnp.linalg.norm(goal[:, None] - known.sights, axis=-1)
        victim = known.sights[gap.argmin(-1)]
        there = jnp.linalg.norm(way - goal[:, None], axis=-1) < self.cell / 2
        # All but the first square at the place: the robot gets there before it turns.
        behind = there & jnp.roll(there, 1, -1).at[:, 0].set(False)
        looks = (gap.min(-1) < LOOK_RANGE)[:, None] & behind
        return jnp.where(looks[..., None], victim[:, None], way)

    def unfound(self, memory: TeamMemory) -> jax.Array:
        """As `GoalTeam`, by the looks of victim sensors (i, j); an oracle remembers looks in vain only."""
        if self.oracle:
            return super().unfound(memory)
        return memory.reachable & ~memory.extra.looked.any(0)

    def things(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return which victims there are (victims,)."""
        del memory
        return victims_there(view)

    def at_base(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return which victims the marks on the base's map stand for (victims,)."""
        return self.marked(view, memory.belief.squares[station_slot(view.scene)] == MARK)

    def sighted(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return which victims each agent has met itself (agents, victims)."""
        own = jnp.asarray(memory.belief.marks)[self.agents(view.scene)]
        return jax.vmap(partial(self.marked, view))(own)

    def progress(self, view: TaskView, memory: TeamMemory, worth: jax.Array) -> Progress:
        """Victims that are reported; metric `found` is the share that a robot has met."""
        step, people = super().progress(view, memory, worth), victims_there(view)
        met = (self.sighted(view, memory).any(0) & people).sum() / jnp.maximum(people.sum(), 1)
        return step._replace(metrics={**step.metrics, "found": met})

    def marked(self, view: TaskView, marks: jax.Array) -> jax.Array:
        """Return which victims some marks (i, j) stand for (victims,)."""
        at = jnp.asarray(view.victims.at)[:, :2]
        gap = self.arena_grid(view.scene).squared_gaps(at)
        # By squares, not by marks: each square stands for one victim at most.
        nearest = gap.argmin(0) == jnp.arange(len(at))[:, None, None]
        return (nearest & (gap <= self.near**2) & marks).any((1, 2))

    def wanted(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the places of victims that are not reported (i, j)."""
        return self.targets(view, memory)

    def privileged(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """As `GoalTeam`, and victims: where they are, which are reported, and which are on whose map."""
        marks = get_rows(memory.belief.squares, self.agents(view.scene)) == MARK
        victims = victim_features(
            view.scene.arena,
            jnp.asarray(view.victims.at)[:, :2],
            victims_there(view),
            memory.extra.achieved,
            jax.vmap(partial(self.marked, view))(marks),
        )
        return jnp.concatenate([super().privileged(view, memory), victims])
