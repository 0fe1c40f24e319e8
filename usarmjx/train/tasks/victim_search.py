"""A mixed team searches a building for victims and reports them to its base."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.backend import get_rows, set_rows
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE
from usarmjx.base.transforms import flip_angles, flip_vector, mat_from_angles
from usarmjx.comms.links import reachable
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.actions import Actions, JointAction
from usarmjx.sim.scene import RobotGroup, Scene
from usarmjx.train.envs.presence import Presence, arrival_actions, drawn_team, remaining_robots, team_key
from usarmjx.train.envs.recipe import Arenas
from usarmjx.train.envs.task import StepResult, TaskView
from usarmjx.train.mapping import planning
from usarmjx.train.mapping.belief import Belief, update_base_contact
from usarmjx.train.mapping.maps import FREE, MARK, MapGrid, to_robot_frame
from usarmjx.train.mapping.planning import VISITED_FRONTIER_COST
from usarmjx.train.mapping.wavefront import UNREACHABLE, frontier
from usarmjx.train.tasks.buildings import Buildings
from usarmjx.train.tasks.equip import base_station, flies, pose_sensor, victim_search_robot
from usarmjx.train.tasks.team import (
    BASE_STATION,
    POSITION_SCALE,
    TeamMemory,
    TeamTask,
    station_slot,
)

ABSENT_VICTIM_DISTANCE = 1e5
"""Victims that a world does not have are farther away than this [m]."""
FENCE_MARGIN = 0.25
"""The fence of robots that fly is so far inside the building's outline [m]."""
FENCE_GAIN = 1.3
"""Their speed over the way that is left to it, at most [1/s]."""

SEEKING_COST, OUTWARD_COST = 1000.0, 2.0
"""Addition to the way to a frontier, which exceeds any way home [squares]; and addition for each square
of its distance from the base [squares]."""


def seeking_costs(belief: Belief, gap: jax.Array) -> jax.Array:
    """Return what ways cost at their ends for robots that know none home: frontiers (robots, i, j) [squares].

    Args:
        belief: Their beliefs.
        gap: Distances of squares from the base, as the crow flies [squares] (i, j).
    """
    # Above any way home, so that a known way home always wins.
    cost = SEEKING_COST + OUTWARD_COST * gap + VISITED_FRONTIER_COST * belief.visited
    return jnp.where(jax.vmap(frontier)(belief.squares), cost, UNREACHABLE)


def detected_positions(view: TaskView, group: int) -> jax.Array:
    """Return what a group's victim sensors met: whether, then x ahead and y to the left [m].

    The robot is taken to stand level. Shape (robots, boxes, 3).
    """
    members = view.scene.groups[group]
    mount = members.suite.sensors[members.suite.index("VictSensor")].mounts[0]
    boxes = view.sensor(group, "VictSensor")
    mat = mat_from_angles(*flip_angles(mount.direction)).astype(np.float32)
    at = np.array(flip_vector(mount.at), np.float32)
    # The first two numbers of a box are whether it was met and which part it is; the position comes behind.
    position = (mat * boxes[..., None, 2:]).sum(-1) + at
    return jnp.concatenate([boxes[..., :1], position[..., :2]], -1)


def mark_squares(grid: MapGrid, pose: jax.Array, met: jax.Array) -> jax.Array:
    """Return the squares in which a robot at a pose (3,) met something (boxes, 3) (i, j)."""
    cos, sin = jnp.cos(pose[2]), jnp.sin(pose[2])
    x, y = met[:, 1], met[:, 2]
    position = pose[:2] + jnp.stack([cos * x - sin * y, sin * x + cos * y], -1)
    there = grid.index(position)
    # By maximum: of several boxes in one square `set` lets any one win.
    return jnp.zeros(grid.shape, bool).at[there[:, 0], there[:, 1]].max(met[:, 0] > 0)


def mark_victims(view: TaskView, grid: MapGrid, belief: Belief) -> Belief:
    """Return the belief with marks where the robots' victim sensors met something."""
    for g, group in enumerate(view.scene.groups):
        # The base has no victim sensor.
        if group.robot.name == BASE_STATION:
            continue
        pose, marks = (get_rows(rows, group.slots) for rows in (belief.pose, belief.marks))
        marked = jax.vmap(partial(mark_squares, grid))(pose, detected_positions(view, g))
        # An old reading was taken elsewhere: from here it would mark a wrong square.
        marked &= view.is_fresh(g, "VictSensor")[:, None, None]
        belief = belief.replace(marks=set_rows(belief.marks, (group.slots, marks | marked)))
    return belief


def victims_there(view: TaskView) -> jax.Array:
    """Return which victims of its table a world has (victims,)."""
    return jnp.asarray(view.victims.at)[:, 0] < ABSENT_VICTIM_DISTANCE


def fence_of(extent: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return lowest and highest x and y [m] (2,) within the fence of an arena's extent (2, low or high)."""
    return extent[:, 0] + FENCE_MARGIN, extent[:, 1] - FENCE_MARGIN


def way_left(at: jax.Array, ahead: jax.Array, fence: tuple[jax.Array, jax.Array]) -> jax.Array:
    """Return how far robots may go on before they leave a fence [m] (robots,); 0: not at all.

    Args:
        at: Positions [m] (robots, 2).
        ahead: Directions: unit vectors (robots, 2).
        fence: Lowest and highest x and y [m] (2,).
    """
    edge = jnp.where(ahead > 0, fence[1], fence[0]) - at
    # A robot that flies along an edge never reaches it; the inner replacement keeps 0/0 from being computed.
    along = jnp.where(ahead == 0, jnp.inf, edge / jnp.where(ahead == 0, 1.0, ahead))
    return jnp.maximum(along.min(-1), 0.0)


FLIPPERS = {"FRFlipper": -1.3, "FLFlipper": -1.3, "RRFlipper": 1.3, "RLFlipper": 1.3}
"""Flippers folded up [rad]: negative in front and positive behind is up."""
HEIGHT, FLIGHT_SPACING = 2.0, 0.5
"""Flying robots fly so high, the second one that much higher, and so on [m]."""
MAX_HEIGHT_ERROR = 0.4
"""A robot that is that much too low does not fly on [m]."""
CLIMB_GAIN, FLIGHT_SPEED, TURN_RATE = 1.0, 1.2, 1.0
"""Of flying robots: upward speed over error of height [1/s], forward speed [m/s], turning rate [rad/s]."""
SWEEP_RADIUS = 1.0
"""Radius that a flying robot has seen around it [m]."""
RETURN_MARGIN = 5.0
"""Time to spare with which robots plan to be home [s]."""
RECENT_CONTACT = 10.0
"""A robot that has had contact for as recent as this need not come home when the time runs out [s]."""


class VictimSearchState(struct.PyTreeNode, kw_only=True):
    """The task's memory of victims.

    Attributes:
        reported: Which victims are reported (victims,).
        wrong: Squares that were reported wrongly so far ().
        mapped: Which squares of the building the base has on its map (i, j).
        connected: Sum over steps of the share of robots that reached the base ().
        linked: Which robots reach the base now (robots,).
    """

    reported: jax.Array
    wrong: jax.Array
    mapped: jax.Array
    connected: jax.Array
    linked: jax.Array


@dataclass(frozen=True, kw_only=True)
class VictimSearch(TeamTask):
    """Find victims and tell the base where they are.

    A base station stands at the first start pose. It takes part in the mail: it sends all its map, and draws
    into it what it receives. Robots that meet a part of a victim with their victim sensor put a mark on the
    square in which the middle of that part is. A victim is reported as soon as the base has a mark on a
    square whose middle is within `near` of the victim's pelvis, in the plane; nothing else counts. So a
    report reaches the base over a link of its finder, or over links of others that pass it on, or its finder
    drives back until it has one. A mark of the base that is not within `near` of any victim is wrong.

    Score, over the n steps of an episode:
    - 60 times the mean over all steps of the share of the victims that are reported;
    - 30 times the mean over all steps of the share of the building that is free on the base's map: the
      squares of 0.3 m whose middles a robot of class `passing` gets to;
    - 10 times the mean over all steps of the share of robots that reach the base over any number of links;
    - less `price` for every contact and `wrong` for every square wrongly marked at the base.
    The first two are so for a `haste` of 1; with less, the shares at the end count the more, see `TeamTask`.

    Observation: as `TeamTask`; then the way home to the base (x, y; 1 is 6 m), how long ago it had contact
    with the base (1: 60 s), whether it knows of marks that the base may not know, and marks on the map around
    it are walls. Robots that fly have no scanner; for them all is free that they have flown over.

    Action: as `TeamTask`; robots that fly: forward speed, turn to the left. They keep their height. With
    `fence` they know the building's outline: beyond it all is wall for them, and they brake before it.

    Reward: the points that a step adds to the final score. Robots that touch something pay for their
    contacts; all robots share the rest equally. Besides, each robot gets `hint` times 100 times the share of
    the building that it was the first to see; this is not part of the score.

    Attributes:
        wheeled: Robots on wheels.
        tracked: Robots on tracks with flippers, which they hold up.
        flying: Robots that fly above the walls and look down.
        near: Distance from a victim within which a mark is right [m].
        wrong: Price of a square wrongly marked.
        hint: Reward for squares that a robot explores.
        return_speed: Speed with which robots plan to be home in time, in a straight line [m/s].
        seek_home: Let robots that have to go home and know no way look for one at frontiers near the base;
            else they wait.
        fence: Keep robots that fly above the building.
        battery_life: Time after which batteries are empty [s]; 0: the class's own, longer than an episode.
            A robot whose battery is empty stays where it is, one that flies falls; its radio works on.
        loss_rate: Losses of a robot per second; a lost robot leaves the world.
        least_robots: Least number of robots beside the base; each world draws its number, up to the whole
            team, and which of them it has, at each reset. 0: always the whole team.
        arrival_interval: Time between two robots that enter, in the order of their slots [s]; 0: all are
            there from the start.
    """

    about: ClassVar[str] = "A mixed team finds victims and reports them over the radio."
    reports: ClassVar[bool] = True

    arena: Arenas = field(default_factory=lambda: Buildings(victims=5, reachable=1.0))
    episode_steps: int = 300
    wheeled: tuple[str, ...] = ("P2AT",) * 4
    tracked: tuple[str, ...] = ("kenaf",) * 2
    flying: tuple[str, ...] = ("AirRobot",) * 2
    near: Annotated[float, POSITIVE] = 1.5
    wrong: float = 0.5
    hint: float = 0.05
    return_speed: Annotated[float, POSITIVE] = 0.3
    seek_home: bool = False
    fence: bool = False
    battery_life: Annotated[float, NOT_NEGATIVE] = 0.0
    loss_rate: Annotated[float, NOT_NEGATIVE] = 0.0
    least_robots: Annotated[int, NOT_NEGATIVE] = 0
    arrival_interval: Annotated[float, NOT_NEGATIVE] = 0.0

    def problem(self) -> str:
        """Return a conflict between settings."""
        team = len(self.wheeled) + len(self.tracked) + len(self.flying)
        wrong = self.least_robots > team
        return f"least_robots is {self.least_robots}, but the team has {team} robots" if wrong else ""

    @property
    def varies(self) -> bool:
        """Whether robots may be missing or drop out."""
        return max(self.battery_life, self.loss_rate, self.least_robots, self.arrival_interval) > 0

    @property
    def robots(self) -> tuple[RobotSpec, ...]:
        """The base, and the team."""
        team = [victim_search_robot(name) for name in (*self.wheeled, *self.tracked, *self.flying)]
        if self.battery_life > 0:
            team = [replace(robot, battery_life=self.battery_life) for robot in team]
        return (base_station(), *team)

    # Members of the team.

    def team(self, scene: Scene, key: jax.Array) -> jax.Array | None:
        """Those that the world draws and that do not arrive later."""
        if not self.varies:
            return None
        return drawn_team(scene, self.agents(scene), self.least_robots, key) & (self._arrivals(scene) == 0)

    def _arrivals(self, scene: Scene) -> np.ndarray:
        period = self.repeat * scene.physics.period
        return arrival_actions(scene, self.agents(scene), self.arrival_interval, period)

    def presence(self, view: TaskView, memory: TeamMemory) -> Presence | None:
        """Those that have arrived, are not lost, and have charge."""
        del memory
        if not self.varies:
            return None
        arrivals, agents = self._arrivals(view.scene), self.agents(view.scene)
        return remaining_robots(view, agents, self.least_robots, arrivals, self.repeat, self.loss_rate)

    def working(self, view: TaskView, memory: TeamMemory) -> jax.Array | None:
        """As `TeamTask`: those that are alive."""
        presence = self.presence(view, memory)
        return None if presence is None else presence.alive

    def _over(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return whether all robots are out of action, and none will come ()."""
        presence = self.presence(view, memory)
        if presence is None:
            return jnp.zeros((), bool)
        agents = self.agents(view.scene)
        left = (presence.alive & presence.present)[agents].any()
        # Not before the last arrival: until then an empty building is no end.
        return ~left & (view.world.step // self.repeat > self._arrivals(view.scene).max())

    def _share_linked(self, view: TaskView, linked: jax.Array) -> jax.Array:
        """Return the share of the robots of this world that reach the base ()."""
        agents = self.agents(view.scene)
        if not self.varies:
            return linked[agents].mean()
        # The draw of the start again, from the same key: robots that are lost or still to come count as not
        # linked.
        team = drawn_team(view.scene, agents, self.least_robots, team_key(view.world))
        return linked[agents].sum() / jnp.maximum(team[agents].sum(), 1)

    # Beliefs of the robots.

    def first_belief(self, view: TaskView) -> Belief:
        """As `TeamTask`; beyond the fence all is wall for robots that fly."""
        belief = super().first_belief(view)
        flyers = self.planner_settings(view.scene).flyers
        if not self.fence or not flyers.any():
            return belief
        grid = self.arena_grid(view.scene)
        low, high = fence_of(self.note(view, "extent"))
        inside = ((grid.centres > low) & (grid.centres < high)).all(-1)
        beyond = flyers[:, None, None] & ~inside
        return belief.replace(evidence=jnp.where(beyond, 1, belief.evidence).astype(jnp.int8))

    def update_task_belief(self, view: TaskView, belief: Belief) -> Belief:
        """Mark what victim sensors met and what flying robots have swept, and look at the radio."""
        grid, scene = self.arena_grid(view.scene), view.scene
        before = (belief.squares == MARK).sum((1, 2))
        belief = mark_victims(view, grid, belief)
        gap = grid.gaps(belief.pose[:, :2])
        swept = self.planner_settings(scene).flyers[:, None, None] & (gap < SWEEP_RADIUS)
        swept &= belief.evidence <= 0  # not beyond the fence
        belief = belief.replace(evidence=jnp.where(swept, -1, belief.evidence).astype(jnp.int8))
        if view.world.links is not None and self.talk != "none":
            belief = update_base_contact(belief, view.links.in_range, station_slot(scene), view.time)
        more = (belief.squares == MARK).sum((1, 2)) > before
        return belief.replace(mark_time=jnp.where(more, view.time, belief.mark_time))

    def plan(self, view: TaskView, belief: Belief) -> Belief:
        """To a frontier, or home with news or when the time runs out.

        With `talk` at none nobody goes home: there is nothing to send.
        """
        grid, scene = self.arena_grid(view.scene), view.scene
        base = station_slot(scene)
        to_base = jnp.linalg.norm(belief.pose[:, :2] - belief.pose[base, :2], axis=-1)
        left = self.episode_steps * self.repeat * scene.physics.period - view.time
        late = (left < to_base / self.return_speed + RETURN_MARGIN) & (
            view.time - belief.base_contact_time > RECENT_CONTACT
        )
        home = ((belief.mark_time > belief.base_contact_time) | late) & (self.talk != "none")
        gap = grid.gaps(belief.pose[base, :2])
        doorstep = jnp.where(gap < planning.HOME_RADIUS, gap, UNREACHABLE)
        ends = seeking_costs(belief, gap / grid.cell) if self.seek_home else UNREACHABLE
        # NaN asks the planner for a frontier of its own choice.
        wanted = jnp.where(home[:, None, None], jnp.minimum(doorstep, ends), jnp.nan)
        return planning.plan_paths(grid, belief, view.time, self.planner_settings(scene), wanted)

    # Their commands.

    def act(self, view: TaskView, memory: TeamMemory, actions: tuple[jax.Array, ...]) -> Actions:
        """As `TeamTask`; flippers are held up."""
        commands = super().act(view, memory, actions)
        folded = [g for g, group in enumerate(view.scene.groups) if "FRFlipper" in group.plan.parts]
        targets = {key: jnp.float32(angle) for key, angle in FLIPPERS.items()}
        return replace(
            commands, joint_actions=tuple(JointAction(group=group, targets=targets) for group in folded)
        )

    def drive_values(
        self, view: TaskView, memory: TeamMemory, group: RobotGroup, action: jax.Array
    ) -> dict[str, jax.Array]:
        """As `TeamTask`; robots that fly climb to their height by their INS."""
        if not flies(group.robot):
            return super().drive_values(view, memory, group, action)
        # By identity: two groups may be equal in all they hold.
        index = next(g for g, other in enumerate(view.scene.groups) if other is group)
        # Different heights, so that robots above each other do not touch.
        height = HEIGHT + FLIGHT_SPACING * np.arange(len(group.slots)) + view.scene.arena.floor
        pose = view.sensor(index, pose_sensor(group.robot))
        error, speed = height - pose[:, 2], FLIGHT_SPEED * action[:, 0]
        low = error > MAX_HEIGHT_ERROR  # not yet above the walls
        if self.fence:
            fence = fence_of(self.note(view, "extent"))
            ahead = jnp.stack([jnp.cos(pose[:, 5]), jnp.sin(pose[:, 5])], -1)
            limits = [FENCE_GAIN * way_left(pose[:, :2], side * ahead, fence) for side in (-1.0, 1.0)]
            # Limits that shrink with the way left: the robot slows down before the fence, not at it.
            speed = jnp.clip(speed, -limits[0], limits[1])
        return {
            "AltitudeVelocity": jnp.clip(CLIMB_GAIN * error, -1.0, 1.0),
            "LinearVelocity": jnp.where(low, 0.0, speed),
            "LateralVelocity": jnp.zeros(len(action)),
            # Rotors turn clockwise for positive values; actions are positive to the left.
            "RotationalVelocity": jnp.where(low, 0.0, -TURN_RATE * action[:, 1]),
        }

    # Evaluation.

    def start(self, view: TaskView, key: jax.Array) -> TeamMemory:
        """Nothing is reported."""
        memory = super().start(view, key)
        found = VictimSearchState(
            reported=jnp.zeros(view.victims.at.shape[0], bool),
            wrong=jnp.zeros(()),
            mapped=jnp.zeros_like(memory.reachable),
            connected=jnp.zeros(()),
            linked=jnp.zeros(view.scene.num_robots, bool),
        )
        return memory.replace(extra=found)

    def evaluate(self, view: TaskView, memory: TeamMemory) -> StepResult:
        """Knowledge of the base, links to it, and contacts."""
        before, steps, scene = memory.extra, self.episode_steps, view.scene
        left = (steps - memory.step) / steps  # this step's number is one more
        memory, credit, begun = self.advance(view, memory)
        found = self._found(view, memory)
        # A world may have fewer victims than its table has rows.
        people = victims_there(view)
        share = (found.reported & people).sum() - (before.reported & people).sum()
        share = share / jnp.maximum(people.sum(), 1)
        squares = jnp.maximum(memory.reachable.sum(), 1)
        mapped = (found.mapped.sum() - before.mapped.sum()) / squares
        linked = found.connected - before.connected
        gain = self.worth(left) * (60.0 * share + 30.0 * mapped) + 10.0 * linked / steps
        gain -= self.wrong * (found.wrong - before.wrong)
        shared, contacts = gain / len(self.agents(scene)), self.price * begun
        reward = shared + self.hint * 100.0 * credit - contacts
        memory = memory.replace(extra=found, score=memory.score + gain - contacts.sum())
        return StepResult(
            memory=memory,
            reward=self.per_group(scene, reward),
            terminated=self._over(view, memory),
            score=memory.score,
            metrics={
                **self.metrics(memory),
                "reported": (found.reported & people).sum() / jnp.maximum(people.sum(), 1),
                "mapped": found.mapped.sum() / squares,
                # Steps that a staggered start skips have no sums behind them.
                "connected": found.connected / (memory.step - memory.skipped),
                "wrong": found.wrong,
                "outside": self._outside(view),
            },
        )

    def score_parts(self, series: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Points for victims, for the base's map and for links, and the costs."""
        steps = np.arange(1, self.episode_steps + 1).reshape(-1, *[1] * (series["connected"].ndim - 1))
        return {
            "victims": 60.0 * self.paid(series["reported"]),
            "mapped": 30.0 * self.paid(series["mapped"]),
            # The metric is the mean so far; times the steps it is the sum again.
            "connected": 10.0 * series["connected"] * steps / self.episode_steps,
            **super().score_parts(series),
            "wrong": -self.wrong * series["wrong"],
        }

    @property
    def most_points(self) -> dict[str, float]:
        """The score if all were reported, mapped and connected from the start."""
        shares = {"victims": 60.0, "mapped": 30.0, "connected": 10.0}
        return {**shares, **super().most_points, "wrong": 0.0}

    def _outside(self, view: TaskView) -> jax.Array:
        """Return the share of the flying robots that truly are not above the building ()."""
        flying = [g for g, group in enumerate(view.scene.groups) if flies(group.robot)]
        if not flying:
            return jnp.zeros(())
        extent = self.note(view, "extent")
        at = jnp.concatenate([view.robots(g).pos[:, :2] for g in flying])
        return 1.0 - ((at > extent[:, 0]) & (at < extent[:, 1])).all(-1).mean()

    def _found(self, view: TaskView, memory: TeamMemory) -> VictimSearchState:
        """Return what the base knows now."""
        before, scene, grid = memory.extra, view.scene, self.arena_grid(view.scene)
        base = station_slot(scene)
        squares = memory.belief.squares[base]
        marked = squares == MARK
        gap = jnp.linalg.norm(grid.centres[:, :, None] - jnp.asarray(view.victims.at)[:, :2], axis=-1)
        right = gap <= self.near
        # Nobody takes marks away, so those that are wrong stay so.
        linked = before.linked
        if self.radio is not None:
            linked = jnp.asarray(reachable(jnp.asarray(view.links.in_range), base))
        return VictimSearchState(
            # A report stays, though the base's map may lose the mark when another message overwrites it.
            reported=before.reported | (right & marked[:, :, None]).any((0, 1)),
            wrong=(marked & ~right.any(-1)).sum().astype(jnp.float32),
            mapped=before.mapped | (memory.reachable & (squares == FREE)),
            connected=before.connected + self._share_linked(view, linked),
            linked=linked,
        )

    # Observations of the agents.

    def observations(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """As `TeamTask`, and the way home, the last contact with it, and whether there is news for it."""
        belief = memory.belief
        home = to_robot_frame(belief.pose, belief.pose[station_slot(view.scene), :2]) / POSITION_SCALE
        age = jnp.clip((view.time - belief.base_contact_time) / 60.0, 0.0, 1.0)
        news = (belief.mark_time > belief.base_contact_time).astype(jnp.float32)
        return jnp.concatenate([super().observations(view, memory), home, jnp.stack([age, news], -1)], -1)

    def privileged(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """As `TeamTask`, and shares of what is reported and mapped, and who reaches the base."""
        found, people = memory.extra, victims_there(view)
        reported = (found.reported & people).sum() / jnp.maximum(people.sum(), 1)
        mapped = found.mapped.sum() / jnp.maximum(memory.reachable.sum(), 1)
        more = jnp.concatenate([jnp.stack([reported, mapped]), found.linked])
        return jnp.concatenate([super().privileged(view, memory), more])
