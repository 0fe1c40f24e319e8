"""Small functions of the tasks for teams: where robots are, what they see of each other, who is linked."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.transforms import flip_angles, flip_vector
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.sensors.motion import wrap
from usarmjx.sim.scene import Scene, Team
from usarmjx.train.envs.task import View
from usarmjx.train.mapping import knowledge
from usarmjx.train.mapping.knowledge import Knowledge, Scan
from usarmjx.train.mapping.maps import MapGrid, look

STATION = "ComStation"
WALLED = RadioSettings(pdo=-40.0, do=1.0, n=2.0, cutoff=-49.0, max_obs=8, atten_fac=6.0)
"""A radio for which walls are walls: 2.8 m in the open, half of that behind a thin one, a quarter behind one
that counts twice."""
PERFECT = RadioSettings(cutoff=-1e6)
"""A radio that is always heard."""
WIDTH, SPACING = 11, 0.6
"""Places along a side of the map that a robot sees around itself, and the distance between two [m]."""
NEAR, WIDE, LONG = 1.2, 6.0, 60.0
"""What is seen as 1: the distance of the next place on the way [m], that of robots and goals [m], the length
of a way [squares]."""
STILL = 0.5
"""So far a robot has come lately, if it drives [m]."""


class TeamMemory(struct.PyTreeNode, kw_only=True):
    """What team tasks remember of an episode.

    Attributes:
        mind: What each robot knows (robots, ...).
        step: Actions so far ().
        reachable: Which squares a robot gets to (i, j).
        explored: Which of them the team's scanners have truly seen to be free (i, j).
        touching: Which robots touch something (robots,).
        contacts: How often robots began to touch something ().
        unlinked: Sum over steps of the share of pairs of robots that have no link ().
        score: So far ().
        extra: The task's own.
    """

    mind: Knowledge
    step: jax.Array
    reachable: jax.Array
    explored: jax.Array
    touching: jax.Array
    contacts: jax.Array
    unlinked: jax.Array
    score: jax.Array
    extra: Any = ()


def local(pose: jax.Array, place: jax.Array) -> jax.Array:
    """Return places [m] (..., 2) in the axes of robots at poses x, y [m], yaw [rad] (..., 3)."""
    away = place - pose[..., :2]
    cos, sin = jnp.cos(pose[..., 2]), jnp.sin(pose[..., 2])
    return jnp.stack([cos * away[..., 0] + sin * away[..., 1], cos * away[..., 1] - sin * away[..., 0]], -1)


def has_scanner(team: Team) -> bool:
    """Return whether a team's robots have a range scanner."""
    return any(sensor.kind == "RangeScanner" for sensor in team.suite.sensors)


def scanner_poses(team: Team, poses: jax.Array) -> jax.Array:
    """Return where the scanners of robots at poses x, y [m], yaw [rad] are (robots, 3)."""
    mount = team.suite.sensors[team.suite.place("RangeScanner")].mounts[0]
    x, y, _ = flip_vector(mount.at)
    cos, sin = jnp.cos(poses[:, 2]), jnp.sin(poses[:, 2])
    place = poses[:, :2] + jnp.stack([cos * x - sin * y, sin * x + cos * y], -1)
    yaw = wrap(poses[:, 2] + flip_angles(mount.direction)[2])
    return jnp.concatenate([place, yaw[:, None]], -1)


def scan_of(view: View, team: int, poses: jax.Array) -> Scan:
    """Return the scans of a team's robots at poses (robots, 3)."""
    members = view.scene.teams[team]
    sensor = members.suite.sensors[members.suite.place("RangeScanner")]
    return Scan(
        slots=members.slots,
        settings=sensor.settings[0],
        poses=scanner_poses(members, poses),
        ranges=view.sensor(team, "RangeScanner"),
        fresh=view.fresh(team, "RangeScanner"),
    )


def true_poses(view: View, team: int) -> jax.Array:
    """Return where a team's robots truly are: x, y [m], yaw [rad] (robots, 3)."""
    robots = view.robots(team)
    w, x, y, z = jnp.moveaxis(robots.quat, -1, 0)
    yaw = jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return jnp.concatenate([robots.pos[:, :2], yaw[:, None]], -1)


def newly_seen(view: View, memory: TeamMemory, grid: MapGrid) -> tuple[jax.Array, jax.Array]:
    """Return what of the arena is explored now (i, j), and whose part of what is new that is (robots,).

    Scans are drawn from where the scanners truly are; what several show at once is shared.
    """
    scene = view.scene
    new = jnp.zeros((scene.robots, *grid.shape), bool)
    for team, members in enumerate(scene.teams):
        if not has_scanner(members):
            continue
        scan = scan_of(view, team, true_poses(view, team))
        free, _ = jax.vmap(lambda pose, ranges, s=scan.settings: look(grid, s, pose, ranges))(
            scan.poses, scan.ranges
        )
        new = new.at[members.slots].set(free & scan.fresh[:, None, None])
    new = new & memory.reachable & ~memory.explored
    seers = new.sum(0)
    credit = (new / jnp.maximum(seers, 1)).sum((1, 2)) / jnp.maximum(memory.reachable.sum(), 1)
    return memory.explored | new.any(0), credit


def mates_seen(view: View, mind: Knowledge) -> jax.Array:
    """Return what each robot knows of the others, as it observes that (robots, 4 others)."""
    robots = view.scene.robots
    others = knowledge.others(robots)
    rows = np.arange(robots)[:, None]
    age = (view.time - mind.heard)[rows, others]
    there = jax.vmap(lambda pose, mates: local(pose, mates))(mind.pose, mind.mates[rows, others, :2])
    there = jnp.where((age < knowledge.STALE)[..., None], there / WIDE, 0.0)
    linked = jnp.zeros((robots, robots), bool) if view.world.links is None else view.links.in_range
    facts = [there, jnp.minimum(age / knowledge.STALE, 1.0)[..., None], linked[rows, others][..., None]]
    return jnp.concatenate(facts, -1).reshape(robots, -1)


def true_places(view: View) -> jax.Array:
    """Return where all robots truly are, for critics (numbers,).

    Team by team: x and y as shares of the arena, then cosine and sine of the yaw.
    """
    extent, rows = np.array(view.scene.arena.extent, np.float32), []
    for team in range(len(view.scene.teams)):
        robots = view.robots(team)
        w, z = robots.quat[:, 0], robots.quat[:, 3]
        place = (robots.pos[:, :2] - extent[:, 0]) / (extent[:, 1] - extent[:, 0])
        rows += [place.ravel(), jnp.stack([w * w - z * z, 2 * w * z], -1).ravel()]
    return jnp.concatenate(rows)


def base_of(scene: Scene) -> int | None:
    """Return the slot of the base station; None: there is none."""
    for team in scene.teams:
        if team.robot.name == STATION:
            return int(team.slots[0])
    return None


def unlinked(view: View) -> jax.Array:
    """Return the share of pairs of robots, the base too, that have no link ()."""
    if view.world.links is None:
        return jnp.ones(())
    links = view.links
    return 1 - links.in_range.sum() / jnp.maximum(links.paired.sum(), 1)


def coverage(memory: TeamMemory) -> jax.Array:
    """Return the share of the squares a robot gets to that are explored ()."""
    return memory.explored.sum() / jnp.maximum(memory.reachable.sum(), 1)
