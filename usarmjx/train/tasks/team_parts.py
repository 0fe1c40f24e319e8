"""Small functions of the tasks for teams: where robots are, what they see of each other, who is linked."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.backend import Part, set_rows
from usarmjx.base.rotations import wrap_angle
from usarmjx.base.transforms import flip_angles, flip_vector
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.sim.robot_group import RobotGroup
from usarmjx.sim.scene import Scene
from usarmjx.train.envs.task import TaskView
from usarmjx.train.mapping.belief import STALE_AGE, Belief, GroupScan, other_slots
from usarmjx.train.mapping.maps import MapGrid, classify_scan

BASE_STATION = "ComStation"
WALLED_RADIO = RadioSettings(pdo=-40.0, do=1.0, n=2.0, cutoff=-49.0, max_obs=8, atten_fac=6.0)
"""A radio for which walls are walls: 2.8 m in the open, half of that behind a thin one, a quarter behind one
that counts twice."""
PERFECT_RADIO = RadioSettings(cutoff=-1e6)
"""A radio that is always heard."""
LOCAL_MAP_WIDTH, SPACING = 11, 0.6
"""Points along a side of the map that a robot observes around itself, and the distance between two [m]."""
WAYPOINT_SCALE, POSITION_SCALE, PATH_SCALE = 1.2, 6.0, 60.0
"""What is observed as 1: the distance of the next position on the path [m], that of robots and goals [m], the
length of a path [squares]."""
PROGRESS_SCALE = 0.5
"""So far a robot has come lately, if it drives [m]."""


class TeamMemory(struct.PyTreeNode, kw_only=True):
    """What team tasks remember of an episode.

    Attributes:
        belief: What each robot believes (robots, ...).
        step: Actions so far ().
        reachable: Which squares a robot gets to (i, j).
        explored: Which of them the team's scanners have truly seen to be free (i, j).
        touching: Which robots touch something (robots,).
        contacts: How often robots began to touch something ().
        unlinked: Sum over steps of the share of pairs of robots that have no link ().
        score: So far ().
        extra: The task's own.
    """

    belief: Belief
    step: jax.Array
    reachable: jax.Array
    explored: jax.Array
    touching: jax.Array
    contacts: jax.Array
    unlinked: jax.Array
    score: jax.Array
    extra: Any = ()


def to_robot_frame(pose: jax.Array, position: jax.Array) -> jax.Array:
    """Return positions [m] (..., 2) in the axes of robots at poses x, y [m], yaw [rad] (..., 3)."""
    away = position - pose[..., :2]
    cos, sin = jnp.cos(pose[..., 2]), jnp.sin(pose[..., 2])
    return jnp.stack([cos * away[..., 0] + sin * away[..., 1], cos * away[..., 1] - sin * away[..., 0]], -1)


def has_scanner(group: RobotGroup) -> bool:
    """Return whether a group's robots have a range scanner."""
    return any(sensor.kind == "RangeScanner" for sensor in group.suite.sensors)


def scanner_poses(group: RobotGroup, poses: jax.Array) -> jax.Array:
    """Return where the scanners of robots at poses x, y [m], yaw [rad] are (robots, 3)."""
    mount = group.suite.sensors[group.suite.index("RangeScanner")].mounts[0]
    x, y, _ = flip_vector(mount.at)
    cos, sin = jnp.cos(poses[:, 2]), jnp.sin(poses[:, 2])
    position = poses[:, :2] + jnp.stack([cos * x - sin * y, sin * x + cos * y], -1)
    yaw = wrap_angle(poses[:, 2] + flip_angles(mount.direction)[2])
    return jnp.concatenate([position, yaw[:, None]], -1)


def scan_of(view: TaskView, group: int, poses: jax.Array) -> GroupScan:
    """Return the scans of a group's robots at poses (robots, 3)."""
    members = view.scene.groups[group]
    sensor = members.suite.sensors[members.suite.index("RangeScanner")]
    return GroupScan(
        slots=members.slots,
        settings=sensor.settings[0],
        poses=scanner_poses(members, poses),
        ranges=view.sensor(group, "RangeScanner"),
        fresh=view.is_fresh(group, "RangeScanner"),
    )


def true_poses(view: TaskView, group: int) -> jax.Array:
    """Return where a group's robots truly are: x, y [m], yaw [rad] (robots, 3)."""
    robots = view.robots(group)
    w, x, y, z = jnp.moveaxis(robots.quat, -1, 0)
    yaw = jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return jnp.concatenate([robots.pos[:, :2], yaw[:, None]], -1)


def newly_explored(view: TaskView, memory: TeamMemory, grid: MapGrid) -> tuple[jax.Array, jax.Array]:
    """Return what of the arena is explored now (i, j), and whose part of what is new that is (robots,).

    Scans are drawn from where the scanners truly are; what several show at once is shared.
    """
    scene = view.scene
    parts = list[Part]()
    for g, group in enumerate(scene.groups):
        if not has_scanner(group):
            continue
        scan = scan_of(view, g, true_poses(view, g))
        free, _ = jax.vmap(partial(classify_scan, grid, scan.settings))(scan.poses, scan.ranges)
        parts.append((group.slots, free & scan.fresh[:, None, None]))
    new = set_rows(jnp.zeros((scene.num_robots, *grid.shape), bool), *parts)
    new = new & memory.reachable & ~memory.explored
    seers = new.sum(0)
    credit = (new / jnp.maximum(seers, 1)).sum((1, 2)) / jnp.maximum(memory.reachable.sum(), 1)
    return memory.explored | new.any(0), credit


def mate_observations(view: TaskView, belief: Belief) -> jax.Array:
    """Return what each robot believes of the others, as it observes that (robots, 4 others)."""
    robots = view.scene.num_robots
    others = other_slots(robots)
    rows = np.arange(robots)[:, None]
    age = (view.time - belief.heard_time)[rows, others]
    there = jax.vmap(to_robot_frame)(belief.pose, belief.mate_headers[rows, others, :2])
    there = jnp.where((age < STALE_AGE)[..., None], there / POSITION_SCALE, 0.0)
    linked = jnp.zeros((robots, robots), bool) if view.world.links is None else view.links.in_range
    facts = [there, jnp.minimum(age / STALE_AGE, 1.0)[..., None], linked[rows, others][..., None]]
    return jnp.concatenate(facts, -1).reshape(robots, -1)


def true_pose_features(view: TaskView) -> jax.Array:
    """Return where all robots truly are, for critics (numbers,).

    Group by group: x and y as shares of the arena, then cosine and sine of the yaw.
    """
    extent = np.array(view.scene.arena.extent, np.float32)
    rows: list[Array] = []
    for group in range(len(view.scene.groups)):
        robots = view.robots(group)
        w, z = robots.quat[:, 0], robots.quat[:, 3]
        position = (robots.pos[:, :2] - extent[:, 0]) / (extent[:, 1] - extent[:, 0])
        rows += [position.ravel(), jnp.stack([w * w - z * z, 2 * w * z], -1).ravel()]
    return jnp.concatenate(rows)


def base_slot(scene: Scene) -> int | None:
    """Return the slot of the base station; None: there is none."""
    for group in scene.groups:
        if group.robot.name == BASE_STATION:
            return int(group.slots[0])
    return None


def station_slot(scene: Scene) -> int:
    """Return the slot of the base station, of a scene that has one."""
    slot = base_slot(scene)
    assert slot is not None  # as the task's roster says
    return slot


def unlinked(view: TaskView) -> jax.Array:
    """Return the share of pairs of robots, the base too, that have no link ()."""
    if view.world.links is None:
        return jnp.ones(())
    links = view.links
    return 1 - links.in_range.sum() / jnp.maximum(links.paired.sum(), 1)


def coverage(memory: TeamMemory) -> jax.Array:
    """Return the share of the squares a robot gets to that are explored ()."""
    return memory.explored.sum() / jnp.maximum(memory.reachable.sum(), 1)
