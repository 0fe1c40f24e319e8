"""A team looks for victims and reports them to its base: what counts has to get there."""

from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.settings import POSITIVE
from usarmjx.models.types.robot import RobotSpec
from usarmjx.train.envs.task import TaskView
from usarmjx.train.mapping.belief import Belief
from usarmjx.train.mapping.maps import FREE, MARK, MapGrid, classify_scan
from usarmjx.train.mapping.planning import box_sum
from usarmjx.train.tasks.equip import VICTIM_FOV, victim_search_robot
from usarmjx.train.tasks.goal_team import GoalState, KnownMaps, Progress
from usarmjx.train.tasks.reporting_team import ReportingTeam
from usarmjx.train.tasks.team import TeamMemory, scan_of, station_slot
from usarmjx.train.tasks.victim_search import mark_victims, victims_there

LOOK_RANGE = 3.0
"""Distance up to which a robot looks for victims [m]."""
LOOK_ANGLE = VICTIM_FOV / 2
"""Angle from straight ahead up to which it does [rad]."""
LOOK_BOX, LOOK_SHARE = 2, 0.5
"""A square is worth a look if this share of the squares so far around it, along both axes, is."""
LOOK_RADIUS = 0.9
"""Distance from a victim at which an oracle looks at it [m]."""


def in_view(grid: MapGrid, pose: jax.Array) -> jax.Array:
    """Return which squares a victim sensor at a pose (3,) is turned to, near enough (i, j)."""
    away = jnp.asarray(grid.centres) - pose[:2]
    ahead = away[..., 0] * jnp.cos(pose[2]) + away[..., 1] * jnp.sin(pose[2])
    distance = jnp.linalg.norm(away, axis=-1)
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
    scanner has seen and its victim sensor, which looks ahead only, has not. For an oracle squares beside
    victims that are not reported are the only ones.

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
        looked = memory.extra.looked | self.looks(view, belief)
        return memory.replace(extra=memory.extra.replace(looked=looked)), credit, begun

    def first_state(self, view: TaskView, memory: TeamMemory) -> GoalState:
        """As `GoalTeam`, and the first looks."""
        return super().first_state(view, memory).replace(looked=self.looks(view, memory.belief))

    def looks(self, view: TaskView, belief: Belief) -> jax.Array:
        """Return the squares that robots look at now, as far as scans show them free (robots, i, j)."""
        grid, found = self.arena_grid(view.scene), jnp.zeros_like(belief.visited)
        for g in self.agent_groups(view.scene):
            scan = scan_of(view, g, belief.pose[view.scene.groups[g].slots])
            free, _ = jax.vmap(partial(classify_scan, grid, scan.settings))(scan.poses, scan.ranges)
            ahead = jax.vmap(partial(in_view, grid))(scan.poses)
            found = found.at[scan.slots].set(free & ahead & scan.fresh[:, None, None])
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
        around = jax.vmap(partial(box_sum, radius=LOOK_BOX))(known.targets)
        wide = around >= LOOK_SHARE * (2 * LOOK_BOX + 1) ** 2
        return ends | (known.targets & wide & (known.squares == FREE))

    def told(self, view: TaskView, belief: Belief) -> jax.Array:
        """As `GoalTeam`: marks are few, so it is known whether the last one came to the base."""
        del view
        return belief.mark_time < belief.base_contact_time

    def targets(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the squares beside victims that are not reported (i, j)."""
        grid, people = self.arena_grid(view.scene), victims_there(view)
        beside = grid.gaps(jnp.asarray(view.victims.at)[:, :2]) < LOOK_RADIUS
        missing = people & ~memory.extra.achieved
        return memory.reachable & (beside & missing[:, None, None]).any(0)

    def unfound(self, memory: TeamMemory) -> jax.Array:
        """As `GoalTeam`, by the looks of victim sensors (i, j)."""
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
        nearest = gap.argmin(0) == jnp.arange(len(at))[:, None, None]
        return (nearest & (gap <= self.near**2) & marks).any((1, 2))

    def wanted(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return where victims lie that are not reported (i, j)."""
        return self.targets(view, memory)
