"""Speed of rays: laser scans of all robots of many worlds, and the same by brute force in one run.

Each world has upright walls of its own and a floor, and robots that move and turn between two scans, whose
parts are in the way of the others' rays. Brute force tests every ray against every geom.
"""

import statistics
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from benchmarks.baselines import (
    WORLDS_PER_CORE,
    baseline_lines,
    missing,
    model_of,
    multiray_rate,
    posed,
)
from benchmarks.cases import AllBaselineOptions, BaselineOptions, RayCase, one_class
from benchmarks.radio import ARENA_SIDE, random_walls
from benchmarks.tools import rate_of, run_case, time_repeats
from usarmjx.base.errors import UsageError
from usarmjx.base.process import cores
from usarmjx.base.warp_functions import warp_in_use
from usarmjx.models.compile.kinematic_tree import (
    BodyPoses,
    KinematicTree,
    forward_kinematics,
    geom_poses,
    kinematic_tree_of,
)
from usarmjx.models.drives.base import RobotState
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.ranging import RangeScanner
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.raycast import GeomHits, RayQuery, distance_to, nearest_hits
from usarmjx.sensors.rays.targets import GeomBlock, Geoms, make_geoms
from usarmjx.sensors.suite import suite_of

MAX_MOVE, MAX_TURN = 0.02, 0.05
"""Robots move [m] and turn [rad] so far at most between two scans."""
DISTANCE_TOLERANCE = 1e-3
"""Distances that differ by more count as different [m]."""
KINDS = mujoco.mjtGeom
ALL = AllBaselineOptions()


class _MovingRobots(struct.PyTreeNode, kw_only=True):
    """Robots of one world: positions [m] (n, 3) and headings [rad] (n,), and how they change per scan."""

    pos: jax.Array
    yaw: jax.Array
    move: jax.Array
    turn: jax.Array

    def after(self, scans: jax.Array) -> "_MovingRobots":
        return self.replace(pos=self.pos + scans * self.move, yaw=self.yaw + scans * self.turn)


def _moving_robots(key: jax.Array, robots: int, height: float) -> _MovingRobots:
    position, yaw, move, turn = jax.random.split(key, 4)
    flat = jnp.array([1.0, 1.0, 0.0])
    at = jax.random.uniform(position, (robots, 3), minval=-ARENA_SIDE / 2, maxval=ARENA_SIDE / 2)
    return _MovingRobots(
        pos=at * flat + jnp.array([0.0, 0.0, height]),
        yaw=jax.random.uniform(yaw, (robots,), maxval=2 * jnp.pi),
        move=jax.random.uniform(move, (robots, 3), minval=-MAX_MOVE, maxval=MAX_MOVE) * flat,
        turn=jax.random.uniform(turn, (robots,), minval=-MAX_TURN, maxval=MAX_TURN),
    )


def _bodies(plan: KinematicTree, moving: _MovingRobots) -> BodyPoses:
    """Return the robots' bodies; their joints are at zero."""
    count, joints = len(moving.yaw), len(plan.parts) - 1
    zero = jnp.zeros(count)
    quat = jnp.stack([jnp.cos(moving.yaw / 2), zero, zero, jnp.sin(moving.yaw / 2)], -1)
    still = {"linear": jnp.zeros((count, 3)), "angular": jnp.zeros((count, 3))}
    at_rest = {"joint_pos": jnp.zeros((count, joints)), "joint_vel": jnp.zeros((count, joints))}
    return jax.vmap(partial(forward_kinematics, plan))(
        RobotState(pos=moving.pos, quat=quat, **still, **at_rest)
    )


def _geoms(plan: KinematicTree, walls: GeomBlock, bodies: BodyPoses) -> Geoms:
    """Return walls, floor and robots of one world."""
    count, parts = len(bodies.pos), len(plan.geom_type)
    pos, mat = jax.vmap(partial(geom_poses, plan))(bodies)
    floor = (jnp.zeros((1, 3)), jnp.eye(3)[None], jnp.zeros((1, 3)), jnp.full(1, -1))
    robots = (
        pos.reshape(-1, 3),
        mat.reshape(-1, 3, 3),
        jnp.tile(plan.geom_size, (count, 1)),
        jnp.repeat(jnp.arange(count), parts),
    )
    rows = zip((walls.pos, walls.mat, walls.size, walls.owner), floor, robots, strict=True)
    pos, mat, size, owner = (jnp.concatenate(parts) for parts in rows)
    kind = np.concatenate(
        [np.full(len(walls.pos), KINDS.mjGEOM_BOX), [KINDS.mjGEOM_PLANE], np.tile(plan.geom_type, count)]
    )
    parts_of_robots = np.arange(len(kind)) > len(walls.pos)
    return make_geoms(kind, pos, mat, size, owner, compact=parts_of_robots.tolist())


def brute_force(geoms: Geoms, fans: Fans, viewer: jax.Array) -> jax.Array:
    """Return the distance of what each ray meets first, by testing all rays against all geoms (rays,)."""

    def one(start: jax.Array, along: jax.Array) -> jax.Array:
        first = jnp.asarray(jnp.inf)
        for kind, block in zip(geoms.kinds, geoms.blocks, strict=True):
            reach = jnp.where(block.owner == viewer, jnp.inf, distance_to(kind, block, start, along))
            first = jnp.minimum(first, reach.min())
        return first

    return jax.vmap(one)(*map(jnp.asarray, fans.rays()))


def _bounding_volume_cast(geoms: Geoms, fans: Fans, viewer: jax.Array) -> jax.Array:
    first: GeomHits = nearest_hits(geoms, *fans.rays(), RayQuery(exclude_owner=viewer), fans)
    return first.distance


def _scans(
    caster: Callable[..., jax.Array], plan: KinematicTree, walls: GeomBlock, moving: _MovingRobots
) -> jax.Array:
    """Return one world's scans (robots, beams)."""
    bodies = _bodies(plan, moving)
    geoms = _geoms(plan, walls, bodies)
    scanner = _scanner(plan)

    def scan(body: BodyPoses, slot: jax.Array) -> jax.Array:
        return caster(geoms, scanner.fans(body), slot)

    return jax.vmap(scan)(bodies, jnp.arange(len(moving.yaw)))


def _scanner(plan: KinematicTree) -> RangeScanner:
    sensors = suite_of(plan.robot).sensors
    found = [sensor for sensor in sensors if isinstance(sensor, RangeScanner)]
    if not found:
        have = ", ".join(sensor.kind for sensor in sensors)
        raise UsageError(f"{plan.robot.name} has no range scanner to measure with; it has: {have}")
    return found[0]


def _loop(
    case: RayCase,
    caster: Callable[..., jax.Array],
    plan: KinematicTree,
    walls: GeomBlock,
    moving: _MovingRobots,
) -> Callable[[jax.Array], jax.Array]:
    """Return a function that scans `steps` times in all worlds, and returns the last scans."""

    @jax.jit
    def run(scans: jax.Array, walls: GeomBlock, moving: _MovingRobots) -> jax.Array:
        def body(i: jax.Array, scans: jax.Array) -> jax.Array:
            del scans
            return jax.vmap(partial(_scans, caster, plan))(walls, moving.after(i))

        return jax.lax.fori_loop(0, case.steps, body, scans)

    return lambda scans: run(scans, walls, moving)


def _on_cpu(
    case: RayCase, plan: KinematicTree, walls: GeomBlock, moving: _MovingRobots, nearest: np.ndarray
) -> dict[str, Any]:
    """Return the rate of `mj_multiRay` for the last scans of some worlds, and how many of them differ.

    Args:
        case: The measured case.
        plan: The robots' bodies.
        walls: Of all worlds.
        moving: Robots of all worlds.
        nearest: Our distances in these scans [m] (worlds, robots, beams).
    """
    count, datas, bundles = min(case.worlds, WORLDS_PER_CORE * cores()), [], []
    scanner = _scanner(plan)
    for world in range(count):
        here = jax.tree.map(lambda x, w=world: x[w], (walls, moving))
        bodies = _bodies(plan, here[1].after(case.steps - 1))
        datas.append(posed(model_of(_geoms(plan, here[0], bodies))))
        for slot in range(len(moving.yaw[0])):
            fans = scanner.fans(jax.tree.map(lambda x, s=slot: x[s], bodies))
            start, along = (np.asarray(part, float) for part in fans.rays())
            bundles.append((world, start[0], along, slot + 1))
    rate, found = multiray_rate("rays/s", datas, bundles, case.repeats)
    theirs = np.array(found).reshape(count, len(moving.yaw[0]), -1)
    ours = np.where(np.isfinite(nearest[:count]), nearest[:count], -1.0)
    return {**rate, "worlds": count, "different": float((np.abs(theirs - ours) > DISTANCE_TOLERANCE).mean())}


def measure_rays(case: RayCase, options: BaselineOptions = ALL) -> str:
    """Measure a case, append its record, and return a summary for people.

    Raises:
        UnknownNameError: No such robot class.
        UsageError: One without a range scanner.
    """
    return run_case("rays", options, lambda: _measure(case, options.baselines), _summary)


def _measure(case: RayCase, baselines: str) -> dict[str, Any]:
    """Return the record of a case, without its header."""
    key, (robot, robots) = jax.random.key(case.seed), one_class(case.roster)
    plan = kinematic_tree_of(ROBOTS.get(robot))
    walls = jax.vmap(lambda k: random_walls(k, case.walls).blocks[0])(jax.random.split(key, case.worlds))
    moving = jax.vmap(partial(_moving_robots, robots=robots, height=plan.clearance))(
        jax.random.split(jax.random.fold_in(key, 1), case.worlds)
    )
    beams = len(_scanner(plan).directions())
    scans = jnp.zeros((case.worlds, robots, beams))
    first, times, ours = time_repeats(
        _loop(case, _bounding_volume_cast, plan, walls, moving), scans, case.repeats
    )
    slow_first, slow, theirs = time_repeats(
        _loop(case, brute_force, plan, walls, moving), scans, case.repeats
    )
    rays = case.worlds * robots * beams
    ours, theirs = np.asarray(ours), np.asarray(theirs)
    both = np.isfinite(ours) & np.isfinite(theirs)
    apart = np.abs(ours[both] - theirs[both])
    rates = {
        "rays": rate_of("rays/s", rays * case.steps, first, times),
        "brute_force": rate_of("rays/s", rays * case.steps, slow_first, slow),
    }
    on_cpu = missing("not asked for")
    if baselines != "none":
        on_cpu = _on_cpu(case, plan, walls, moving, ours)
    geoms = case.walls + 1 + robots * len(plan.geom_type)
    return {
        "case": case.as_record(),
        "scene": {"robots": robots, "geoms": geoms},
        "rates": rates,
        "baselines": {"mj_multiray": on_cpu, "mjx_ray": {"missing": "the rate `brute_force` is its way"}},
        "geoms_per_world": geoms,
        "geoms_per_robot": len(plan.geom_type),
        "in_the_step": "poses of all robots' geoms, beams, the distance of the first hit of each, the own "
        "robot left out; walls (boxes) own for each world; no noise, no reports",
        "rays_per_scan": rays,
        "rays_per_s": rays * case.steps / statistics.median(times),
        "brute_force_rays_per_s": rays * case.steps / statistics.median(slow),
        "times_s": times,
        "brute_force_times_s": slow,
        "caster": "warp" if warp_in_use() else "jax",
        "compile_s": {"rays": first - times[0], "brute_force": slow_first - slow[0]},
        "hits": float(np.isfinite(ours).mean()),
        "different": float(
            (np.isfinite(ours) != np.isfinite(theirs)).mean() + (apart > DISTANCE_TOLERANCE).mean()
        ),
    }


def _summary(record: dict[str, Any]) -> str:
    case, compiled = record["case"], record["compile_s"]
    return "\n".join(
        [
            f"{case['worlds']} worlds x {case['robots']} {case['robot']} on {record['device']}",
            f"geoms         {record['geoms_per_world']:15,} in a world",
            f"rays          {record['rays_per_s']:15,.0f} /s, cast by {record['caster']}",
            f"brute force   {record['brute_force_rays_per_s']:15,.0f} /s",
            *baseline_lines(record),
            f"ratio         {record['rays_per_s'] / record['brute_force_rays_per_s']:15.2f}",
            f"a ray         {record['in_the_step']}",
            f"hits          {record['hits']:.3f}; different from brute force {record['different']:.6f}",
            f"compile [s]   {compiled['rays']:.1f}, brute force {compiled['brute_force']:.1f}",
        ]
    )
