"""A chain of robots carries the radio of a base as far into a building as it can: by driving, or by goals."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.backend import set_rows
from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE
from usarmjx.comms.links import reachable
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.radio import world_radio
from usarmjx.train.envs.recipe import Arenas
from usarmjx.train.envs.task import StepResult, TaskView
from usarmjx.train.mapping import planning
from usarmjx.train.mapping.belief import Belief, other_slots, update_base_contact
from usarmjx.train.mapping.maps import MapGrid, to_robot_frame
from usarmjx.train.mapping.wavefront import UNREACHABLE, distances, frontier, passable
from usarmjx.train.tasks.buildings import Buildings
from usarmjx.train.tasks.equip import base_station, mapping_robot
from usarmjx.train.tasks.goal_state import Progress
from usarmjx.train.tasks.goal_team import GoalTeam
from usarmjx.train.tasks.team import POSITION_SCALE, TeamMemory, TeamTask, station_slot

INWARD_COST = 3.0
"""Way that a square is worth for each square farther from the base [squares]."""
NON_FRONTIER_COST = 10.0
"""Addition to the way to a square that is no frontier [squares]."""
CONTACT_TIMEOUT = 2.0
"""A robot that has had no contact with the base for so long goes home [s]."""
SIGNAL_SCALE = 20.0
"""So far above the cutoff a signal is seen as 1 [dB]."""


class RelayChainState(struct.PyTreeNode, kw_only=True):
    """The task's memory of the chain.

    Attributes:
        depth: Distance of each square from the base along the ground, as a share of that of the farthest; 0
            where no robot gets to (i, j).
        linked: Which robots reach the base now (robots,).
    """

    depth: jax.Array
    linked: jax.Array


@dataclass(frozen=True, kw_only=True)
class RelayChain(TeamTask):
    """Keep the base connected while the front robot goes as far as it can.

    A base station stands at the first start pose. The depth of a robot is the length of the shortest way from
    the base to its square over squares that a robot of class `passing` gets to, as a share of that of the
    deepest square; a robot outside of such squares has no depth.

    Score: 100 times the mean over all steps of the depth of the deepest robot that reaches the base at that
    moment, over any number of links; less `price` for every contact.

    Observation: as `TeamTask`, but that the way leads away from the base, see `plan`; then the way home to
    the base (x, y; 1 is 6 m), how long ago it had contact with it (1: 60 s), and the power received from each
    of the others, the base first, above the cutoff (1: 20 dB; -1: that much below, or nothing).

    Action: as `TeamTask`.

    Reward: the points that a step adds to the score. Robots that touch something pay for their contacts; all
    robots share the rest equally.

    Attributes:
        robot: Class of the robots, or their description.
        count: Number of robots.
    """

    about: ClassVar[str] = "Robots carry the radio of a base into a building."

    arena: Arenas = field(default_factory=partial(Buildings, renewable=True))
    episode_steps: int = 400
    robot: str | RobotSpec = "P2AT"
    count: Annotated[int, AT_LEAST_ONE] = 5

    @property
    def robots(self) -> tuple[RobotSpec, ...]:
        """The base, and the team."""
        return (base_station(), *(mapping_robot(self.robot),) * self.count)

    def update_task_belief(self, view: TaskView, belief: Belief) -> Belief:
        """Look at the radio."""
        base = station_slot(view.scene)
        if view.world.links is None or self.talk == "none":
            return belief
        return update_base_contact(belief, view.links.in_range, base, view.time)

    def plan(self, view: TaskView, belief: Belief) -> Belief:
        """Away from the base, as the crow flies, to frontiers first; home when the contact is lost.

        With `talk` at none nobody goes home.
        """
        grid, base = self.arena_grid(view.scene), station_slot(view.scene)
        squares = belief.squares
        gap = grid.gaps(belief.pose[base, :2]) / grid.cell
        away = jax.vmap(partial(_outward, gap))(squares)
        home = (view.time - belief.base_contact_time > CONTACT_TIMEOUT) & (self.talk != "none")
        # Any square near the base is home: the base itself stands in its own square.
        doorstep = jnp.where(gap * grid.cell < planning.HOME_RADIUS, gap, UNREACHABLE)
        wanted = jnp.where(home[:, None, None], doorstep, away)
        return planning.plan_paths(grid, belief, view.time, self.planner_settings(view.scene), wanted)

    def start(self, view: TaskView, key: jax.Array) -> TeamMemory:
        """Measure how deep the building is."""
        memory = super().start(view, key)
        return memory.replace(extra=first_chain(view, memory, self.arena_grid(view.scene)))

    def evaluate(self, view: TaskView, memory: TeamMemory) -> StepResult:
        """Depth of the chain."""
        scene, grid = view.scene, self.arena_grid(view.scene)
        memory, _, begun = self.advance(view, memory)
        agents, (chain, depths) = self.agents(scene), chain_now(view, memory.extra, grid)
        linked, reach = chain.linked, jnp.where(chain.linked, depths, 0.0).max()
        gain, contacts = 100.0 * reach / self.episode_steps, self.price * begun
        score = memory.score + gain - contacts.sum()
        memory = memory.replace(extra=chain, score=score)
        return StepResult(
            memory=memory,
            reward=self.per_group(scene, gain / len(agents) - contacts),
            terminated=jnp.zeros((), bool),
            score=memory.score,
            metrics={
                **self.metrics(memory),
                "reach": reach,
                "deepest": depths.max(),
                "connected": linked[agents].mean(),
            },
        )

    def score_parts(self, series: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Points for depth, and the contacts'."""
        return {"depth": depth_points(series, self.episode_steps), **super().score_parts(series)}

    @property
    def most_points(self) -> dict[str, float]:
        """The score if the deepest square were reached from the start."""
        return {"depth": 100.0, **super().most_points}

    def observations(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """As `TeamTask`, and the way home, the last contact, and the powers."""
        belief, robots = memory.belief, view.scene.num_robots
        home = to_robot_frame(belief.pose, belief.pose[station_slot(view.scene), :2]) / POSITION_SCALE
        age = jnp.clip((view.time - belief.base_contact_time) / 60.0, 0.0, 1.0)[:, None]
        margin = power_margins(view)[jnp.arange(robots)[:, None], other_slots(robots)]
        return jnp.concatenate([super().observations(view, memory), home, age, margin], -1)

    def privileged(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """As `TeamTask`, and who reaches the base."""
        return jnp.concatenate([super().privileged(view, memory), memory.extra.linked])


def first_chain(view: TaskView, memory: TeamMemory, grid: MapGrid) -> RelayChainState:
    """Return how deep the squares of a building are, before any robot reaches the base."""
    here = grid.index(memory.belief.pose[station_slot(view.scene), :2])
    # The base's own square may be none that a robot gets to, and the wave starts there.
    base = grid.only(here)
    far = distances(jnp.where(base, 0.0, UNREACHABLE), memory.reachable | base)
    there = memory.reachable & (far < UNREACHABLE)
    # A base that is shut in has a depth of 0 all over, not NaN.
    deepest = jnp.where(there, far, 0.0).max()
    return RelayChainState(
        depth=jnp.where(there, far / jnp.maximum(deepest, 1.0), 0.0),
        linked=jnp.zeros(view.scene.num_robots, bool),
    )


def chain_now(view: TaskView, chain: RelayChainState, grid: MapGrid) -> tuple[RelayChainState, jax.Array]:
    """Return the chain with who reaches the base now, and the true depths of all robots (robots,)."""
    scene, depths = view.scene, jnp.zeros(view.scene.num_robots)
    for g, group in enumerate(scene.groups):
        there = grid.index(view.robots(g).pos[:, :2])
        depths = set_rows(depths, (group.slots, chain.depth[there[:, 0], there[:, 1]]))
    linked = reachable(jnp.asarray(view.links.in_range), station_slot(scene))
    return chain.replace(linked=linked), depths


def depth_points(series: Mapping[str, np.ndarray], steps: int) -> np.ndarray:
    """Return the points for depth after each step (steps, ...) of episodes of some steps."""
    return 100.0 * np.cumsum(series["reach"], axis=0) / steps


def power_margins(view: TaskView) -> jax.Array:
    """Return the powers received above the cutoff (robots, robots) (1: `SIGNAL_SCALE`), from -1 to 1.

    A robot's radio knows its own cutoff, also where that differs between worlds.
    """
    cutoff = 0.0 if view.scene.radio is None else world_radio(view.scene, view.world).cutoff
    return jnp.clip((jnp.asarray(view.links.power) - cutoff) / SIGNAL_SCALE, -1.0, 1.0)


def _outward(gap: jax.Array, squares: jax.Array) -> jax.Array:
    """Return what ways cost at their ends that lead outward: 0 at the outermost frontier (i, j).

    Args:
        gap: Distance from the base, as the crow flies [squares] (i, j).
        squares: A robot's belief of them (i, j).
    """
    open_ = passable(squares)
    outermost = jnp.where(open_, gap, 0.0).max()
    return jnp.where(
        open_, INWARD_COST * (outermost - gap) + NON_FRONTIER_COST * ~frontier(squares), UNREACHABLE
    )


DEEP = 0.95
"""Depth from which an oracle wants to be."""


@dataclass(frozen=True, kw_only=True)
class RelayBase(GoalTeam):
    """Keep the base connected while the front robot goes as far as it can, by choosing goals.

    See `GoalTeam` for goals, actions and observations. The third goal is to stay where the robot is, in place
    of the second robot. Links are observed as the power received above the cutoff (1: 20 dB), 0 without a
    link. For an oracle the deepest twentieth of the building is a frontier. `hint` is 0: a reward for new
    squares draws robots out of the chain.

    Score: 100 times the mean over all steps of the depth of the deepest robot that reaches the base at that
    moment, see `RelayChain`; less `price` for every contact.

    Reward: the points that a step adds to the score, shared equally.
    """

    about: ClassVar[str] = "Robots choose goals to carry the radio of a base into a building."
    holds: ClassVar[bool] = True
    base_first: ClassVar[bool] = False  # maps are of use to robots, not to the base

    hint: Annotated[float, NOT_NEGATIVE] = 0.0

    def nothing(self, view: TaskView, memory: TeamMemory) -> RelayChainState:
        """Return the depths of the building."""
        return first_chain(view, memory, self.arena_grid(view.scene))

    def progress(self, view: TaskView, memory: TeamMemory, worth: jax.Array) -> Progress:
        """Depth of the chain."""
        del worth
        scene, agents = view.scene, self.agents(view.scene)
        chain, depths = chain_now(view, memory.extra.achieved, self.arena_grid(scene))
        reach = jnp.where(chain.linked, depths, 0.0).max()
        points = 100.0 * reach / self.episode_steps
        return Progress(
            achieved=chain,
            points=points,
            reward=jnp.full(scene.num_robots, points / len(agents)),
            metrics={"reach": reach, "deepest": depths.max(), "connected": chain.linked[agents].mean()},
        )

    def signals(self, view: TaskView) -> jax.Array:
        """Return the powers above the cutoff of links (robots, robots)."""
        if view.world.links is None:
            return super().signals(view)
        return jnp.where(super().signals(view), jnp.maximum(power_margins(view), 0.0), 0.0)

    def targets(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the deepest squares (i, j)."""
        del view
        return self.unfound(memory)

    def unfound(self, memory: TeamMemory) -> jax.Array:
        """Return the deepest squares (i, j)."""
        return memory.reachable & (memory.extra.achieved.depth > DEEP)

    def wanted(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return how deep the building is (i, j)."""
        del view
        return memory.extra.achieved.depth

    def score_parts(self, series: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Points for depth, and the contacts'."""
        return {"depth": depth_points(series, self.episode_steps), **super().score_parts(series)}

    @property
    def most_points(self) -> dict[str, float]:
        """The score if the deepest square were reached from the start."""
        return {"depth": 100.0, **super().most_points}
