"""Cars follow the lane of a road one behind the other."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.backend import Array
from usarmjx.base.errors import SpecError, UsageError
from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE, POSITIVE, Setting
from usarmjx.models.arenas import ARENAS
from usarmjx.models.arenas.arda import NETWORK
from usarmjx.models.drives import Ackermann
from usarmjx.models.roads.network import LatLon, RouteNetwork
from usarmjx.models.roads.shapes import lane_path, lane_width
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose, start_tag
from usarmjx.models.types.robot import Mount, RobotSpec, options
from usarmjx.sim.actions import Actions
from usarmjx.sim.scene import Scene
from usarmjx.train.envs.recipe import Arenas, spec_of
from usarmjx.train.envs.task import StepResult, Task, TaskView


@dataclass(frozen=True, eq=False)
class LanePath:
    """A closed path of straight edges.

    Attributes:
        points: Its corners x, y [m] (points, 2); the last one leads to the first.
        width: Of the lane [m].
    """

    points: np.ndarray
    width: float

    @cached_property
    def edges(self) -> np.ndarray:
        """From each corner to the next [m] (points, 2)."""
        return (np.roll(self.points, -1, 0) - self.points).astype(np.float32)

    @cached_property
    def lengths(self) -> np.ndarray:
        """Of the edges [m] (points,)."""
        return np.linalg.norm(self.edges, axis=-1)

    @cached_property
    def edge_starts(self) -> np.ndarray:
        """Distance of each corner along the lane [m] (points,)."""
        return np.concatenate([[0.0], np.cumsum(self.lengths)[:-1]]).astype(np.float32)

    @property
    def length(self) -> float:
        """Once round [m]."""
        return float(self.lengths.sum())

    def position(self, along: jax.Array) -> jax.Array:
        """Return the positions so far along (...,) [m] (..., 2)."""
        along = jnp.mod(along, self.length)
        edge = self._edge(along)
        share = (along - jnp.asarray(self.edge_starts)[edge]) / jnp.asarray(self.lengths)[edge]
        return jnp.asarray(self.points, jnp.float32)[edge] + share[..., None] * jnp.asarray(self.edges)[edge]

    def heading(self, along: jax.Array) -> jax.Array:
        """Return the directions of the path so far along (...,) [rad] (...,)."""
        edge = jnp.asarray(self.edges)[self._edge(jnp.mod(along, self.length))]
        return jnp.arctan2(edge[..., 1], edge[..., 0])

    def _edge(self, along: jax.Array) -> jax.Array:
        # `right`: a corner belongs to the edge that begins there.
        return jnp.searchsorted(jnp.asarray(self.edge_starts), along, side="right") - 1

    def nearest(self, positions: Array) -> tuple[jax.Array, jax.Array]:
        """Return how far along the nearest points to positions (..., 2) are, and how far to their left these.

        Returns:
            Both in metres (...,); the second is negative to the right.
        """
        unit = self.edges / self.lengths[:, None]
        off = positions[..., None, :] - self.points.astype(np.float32)
        # Cut to each edge: beyond its ends the corner is the nearest point.
        along = jnp.clip((off * unit).sum(-1), 0.0, self.lengths)
        gap = off - along[..., None] * unit
        far = jnp.linalg.norm(gap, axis=-1)
        best = jnp.argmin(far, -1)[..., None]
        # The sign of the cross product says which side of the edge a position is on.
        left = jnp.sign(unit[:, 0] * gap[..., 1] - unit[:, 1] * gap[..., 0]) * far
        there = jnp.take_along_axis(jnp.asarray(self.edge_starts) + along, best, -1)
        return there[..., 0], jnp.take_along_axis(left, best, -1)[..., 0]


def closed_lane(network: RouteNetwork, owner: tuple[int, int], origin: LatLon | None) -> LanePath:
    """Return a lane that leads back to its beginning.

    Args:
        network: The route network.
        owner: Numbers of its segment and of the lane.
        origin: Latitude and longitude of the arena's origin [degrees].

    Raises:
        SpecError: No such lane, one that ends, or an arena of which nobody knows where it lies.
    """
    lane = network.lane(*owner)
    if origin is None:
        raise SpecError("this arena has no latitude and longitude: a route network cannot be laid out in it")
    if (lane.last, (*owner, lane.first)) not in lane.exits:
        raise SpecError(
            f"lane {owner[0]}.{owner[1]} ends; expected one whose last waypoint leads to its first"
        )
    return LanePath(points=lane_path(lane, origin), width=lane_width(lane))


AHEAD = (3.0, 5.0, 8.0, 12.0, 17.0, 23.0)
"""Distances ahead of the rear axle at which the lane is observed [m]."""
LATERAL_SCALE, RANGE_SCALE, SPEED_SCALE = 2.0, 20.0, 10.0
"""Quantities observed as 1: sideways [m], ranges and the lane's points [m], speeds [m/s]."""
FAN = options(MaxRange=RANGE_SCALE, MinRange=0.1, Resolution=0.1, ScanFov=1.2, ScanInterval=0.1, Noise=0.01)
"""13 beams over 69 degrees: two meet a car that is 18 m ahead."""
SCANNER_HEIGHT = 0.6
"""Height of the scanner above the road [m]: below it kerbs, above it the bonnets of low cars."""
BEAMS = 13


class ConvoyMemory(struct.PyTreeNode, kw_only=True):
    """The task's memory of an episode.

    Attributes:
        target_speed: Target speed [m/s] ().
        ahead: Which car each one follows; -1: none (cars,).
        arc_length: Distance of the cars along the lane; it goes on after once round [m] (cars,).
        poses: Their INS readings of the last step (cars, 6).
        speeds: Their speeds by INS [m/s] (cars,).
        score: So far ().
    """

    target_speed: jax.Array
    ahead: jax.Array
    arc_length: jax.Array
    poses: jax.Array
    speeds: jax.Array
    score: jax.Array


@dataclass(frozen=True, kw_only=True)
class Convoy(Task):
    """Follow the lane at the target speed, and the car ahead at a safe distance.

    The cars start one behind the other in a lane that leads back to its beginning, in random order, `spacing`
    apart from front to front. A target speed is drawn from `speeds` for each episode.

    Observation, of each car: how far its rear axle is to the left of the lane's middle (1: 2 m), sine and
    cosine of its heading against the lane's, both by its INS, which sits on the rear axle; its speed by that
    and the target speed (1: 10 m/s); the lane's middle at 3, 5, 8, 12, 17 and 23 m along the lane from
    beside the rear axle, x forward and y left of that (1: 20 m); the 13 beams of a scanner on the front
    bumper, from the right to the left over 1.2 rad (1: 20 m or nothing).

    Action: speed (1: 10 m/s), FrontSteer (1: all that the car can do, to the left).

    Of a step a car is worth from 0 to 1: its speed along the lane over the target speed, from 0 to 1;
    but 0 unless its origin is within (width of the lane - width of the car) / 2 of the lane's middle; and for
    one that follows another times 1 - |gap - wanted| / wanted, at least 0. The gap is along the lane from its
    front to the rear end of the one ahead; wanted are `standstill` + `headway` times its speed along it.

    Score: 100 times the mean of that over all cars and all steps of an episode of full length.

    Reward: 100 times its worth over the number of steps, less `price` for a car that ends the episode.

    The episode ends when the gap before a car is 0 or less, or its origin is farther from the lane's middle
    than the lane is wide.

    Attributes:
        robot: Class of the cars, which steer with their front wheels.
        count: Number of cars.
        network: Route network of the arena.
        lane: Segment and lane of the network, from 1.
        spacing: Distance between the cars at the start, front to front [m].
        speeds: Lowest and highest target speed [m/s].
        standstill: Gap that is wanted at rest [m].
        headway: Gap that is wanted in addition, per speed [s].
        price: Price of ending the episode.
    """

    about: ClassVar[str] = "Cars follow a lane one behind the other."

    arena: Arenas = "arda"
    repeat: int = 5
    episode_steps: int = 300
    robot: str | RobotSpec = "Sedan"
    count: Annotated[int, AT_LEAST_ONE] = 3
    network: RouteNetwork = NETWORK
    lane: Annotated[tuple[int, int], Setting(ge=1)] = (1, 1)
    spacing: Annotated[float, POSITIVE] = 8.0
    speeds: Annotated[tuple[float, float], POSITIVE] = (3.0, 6.0)
    standstill: Annotated[float, NOT_NEGATIVE] = 3.0
    headway: Annotated[float, NOT_NEGATIVE] = 1.0
    price: float = 5.0

    @cached_property
    def _robots(self) -> tuple[RobotSpec, ...]:
        car = spec_of(self.robot)
        if not isinstance(car.drive, Ackermann) or car.drive.max_rear_steer > 0:
            raise UsageError(f"a {car.name} in a convoy: expected a car that steers its front wheels only")
        sensors = (
            Mount(
                kind="INS",
                name="INS",
                # The origin is midway between the axles; a car turns about a point beside its rear one.
                at=(-car.wheel_base / 2, 0.0, 0.0),
                options=options(Sigma=0.01, ScanInterval=0.1),
            ),
            Mount(
                kind="RangeScanner",
                name="Front",
                at=(car.dimensions[0] / 2, 0.0, car.origin_height - SCANNER_HEIGHT),
                options=FAN,
            ),
        )
        return (replace(car, sensors=sensors),) * self.count

    @property
    def robots(self) -> tuple[RobotSpec, ...]:
        """The cars, each with an INS on its rear axle and a scanner on its front bumper."""
        return self._robots

    @cached_property
    def path(self) -> LanePath:
        """The lane's middle."""
        return closed_lane(self.network, self.lane, self._arena.gps)

    @property
    def _arena(self) -> ArenaSpec:
        if not isinstance(self.arena, str | ArenaSpec):
            raise UsageError("a convoy drives in one arena: expected its name or description")
        return ARENAS.get(self.arena) if isinstance(self.arena, str) else self.arena

    @property
    def arenas(self) -> ArenaSpec:
        """The arena, with start poses in the lane, the first one in front."""
        starts: list[StartPose] = []
        for i in range(self.count):
            # The first start is the one in front.
            along = jnp.float32(10.0 + self.spacing * (self.count - i))
            (x, y), yaw = np.asarray(self.path.position(along)), float(self.path.heading(along))
            at = (float(x), float(y), START_ELEVATION)
            starts.append(StartPose(tag=start_tag(i), at=at, yaw=yaw))
        return replace(self._arena, starts=tuple(starts))

    def action_sizes(self, scene: Scene) -> tuple[int, ...]:
        """Speed and steering."""
        return (2,)

    def act(self, view: TaskView, memory: ConvoyMemory, actions: tuple[jax.Array, ...]) -> Actions:
        """Speed and steering."""
        drive = self.robots[0].drive
        assert isinstance(drive, Ackermann)  # as `robots` says
        speed, steer = actions[0][:, 0], actions[0][:, 1]
        return Actions(
            drive={
                # Cars are driven by their wheels' turning rate [rad/s].
                0: {"Speed": SPEED_SCALE * speed / drive.radius, "FrontSteer": drive.max_front_steer * steer}
            }
        )

    def start(self, view: TaskView, key: jax.Array) -> ConvoyMemory:
        """Order and speeds of the cars."""
        along, _ = self.path.nearest(view.robots(0).pos[:, :2])
        # Start poses lie one after the other from 10 m on: distances need no wrap before the cars have moved.
        ahead = along[None, :] - along[:, None]
        follows = jnp.argmin(jnp.where(ahead > 0, ahead, jnp.inf), -1)
        low, high = self.speeds
        return ConvoyMemory(
            target_speed=jax.random.uniform(key, minval=low, maxval=high),
            # For the first car all gaps are infinite, and the index of the least would be that of car 0.
            ahead=jnp.where((ahead > 0).any(-1), follows, -1),
            arc_length=along,
            poses=view.sensor(0, "INS"),
            speeds=jnp.zeros(self.count),
            score=jnp.zeros(()),
        )

    def observe(self, view: TaskView, memory: ConvoyMemory) -> tuple[jax.Array, ...]:
        """Lane and ranges, as the sensors have them."""
        poses, scans = view.sensor(0, "INS"), view.sensor(0, "RangeScanner")
        seen = jax.vmap(self._seen, in_axes=(0, 0, 0, None))(poses, memory.speeds, scans, memory.target_speed)
        return (seen,)

    def _seen(self, pose: jax.Array, speed: jax.Array, scan: jax.Array, target_speed: jax.Array) -> jax.Array:
        along, left = self.path.nearest(pose[:2])
        # Observed by its sine and cosine, so that the difference needs no wrap.
        off, yaw = pose[5] - self.path.heading(along), pose[5]
        way = self.path.position(along + np.array(AHEAD, np.float32)) - pose[:2]
        cos, sin = jnp.cos(yaw), jnp.sin(yaw)
        points = jnp.stack([way[:, 0] * cos + way[:, 1] * sin, way[:, 1] * cos - way[:, 0] * sin], -1)
        return jnp.concatenate(
            [
                jnp.stack(
                    [
                        left / LATERAL_SCALE,
                        jnp.sin(off),
                        jnp.cos(off),
                        speed / SPEED_SCALE,
                        target_speed / SPEED_SCALE,
                    ]
                ),
                points.ravel() / RANGE_SCALE,
                jnp.clip(scan / RANGE_SCALE, 0.0, 1.0),
            ]
        )

    def privileged(self, view: TaskView, memory: ConvoyMemory) -> jax.Array:
        """True distances of cars to the left [m], their speeds [m/s], the gaps before them, at most 50 m."""
        robots = view.robots(0)
        _, left = self.path.nearest(robots.pos[:, :2])
        # The first car's gap is infinite, and observations must be finite.
        gap = jnp.minimum(self.gaps(memory.arc_length, memory.ahead), 50.0)
        return jnp.concatenate([left, jnp.linalg.norm(robots.linear[:, :2], axis=-1), gap])

    def gaps(self, along: jax.Array, ahead: jax.Array) -> jax.Array:
        """Return the gaps before cars, infinite where there is none to follow [m] (cars,)."""
        # An index of -1 reads the last car, whose gap is discarded here.
        return jnp.where(ahead < 0, jnp.inf, along[ahead] - along - self.robots[0].dimensions[0])

    def evaluate(self, view: TaskView, memory: ConvoyMemory) -> StepResult:
        """Worth of each car's step."""
        period = self.repeat * view.scene.physics.period
        here, left = self.path.nearest(view.robots(0).pos[:, :2])
        length = self.path.length
        # The shorter way round: at the lane's beginning the distance jumps by its length.
        moved = jnp.mod(here - memory.arc_length + length / 2, length) - length / 2
        along, speed = memory.arc_length + moved, moved / period
        gap = self.gaps(along, memory.ahead)
        wanted = self.standstill + self.headway * jnp.maximum(speed, 0.0)
        kept = jnp.where(memory.ahead < 0, 1.0, jnp.clip(1.0 - jnp.abs(gap - wanted) / wanted, 0.0, 1.0))
        inside = jnp.abs(left) <= (self.path.width - self.robots[0].dimensions[1]) / 2
        worth = jnp.clip(speed / memory.target_speed, 0.0, 1.0) * inside * kept
        lost = (gap <= 0.0) | (jnp.abs(left) > self.path.width)
        poses = view.sensor(0, "INS")
        # By the INS: how far along its heading it has come since the last step.
        way, yaw = poses[:, :2] - memory.poses[:, :2], poses[:, 5]
        by_ins = (way[:, 0] * jnp.cos(yaw) + way[:, 1] * jnp.sin(yaw)) / period
        score = memory.score + 100.0 * worth.mean() / self.episode_steps
        return StepResult(
            memory=memory.replace(arc_length=along, poses=poses, speeds=by_ins, score=score),
            reward=(100.0 * worth / self.episode_steps - self.price * lost,),
            terminated=lost.any(),
            score=score,
            metrics={
                "worth": worth.mean(),
                "sideways": jnp.abs(left).max(),
                "gap_error": jnp.where(memory.ahead < 0, 0.0, jnp.abs(gap - wanted)).max(),
                "lost": lost.any(),
            },
        )
