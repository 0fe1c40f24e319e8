"""What the ground of an arena is like, by C MuJoCo: its height under points, and robots set down on it."""

from dataclasses import replace

import mujoco
import numpy as np

from tests.rig import PERIOD, Rig
from usarmjx.models.compile.compose import new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose

HIGH = 5.0
"""Where rays start from, above everything [m]."""


def arena_of(*shapes, loose=()):
    """Return a floor with some solids on it."""
    start = StartPose(tag="S", at=(0.0, 0.0, START_ELEVATION))
    return ArenaSpec(
        name="elements", starts=(start,), extent=((-3, 3), (-3, 3)), shapes=tuple(shapes), loose=loose
    )


def heights(arena, points, high=HIGH):
    """Return the height of an arena without its victims under points (n, 2) [m] (n,).

    Rays fall from `high`, through what is higher.
    """
    model = new_spec(replace(arena, victims=(), false_alarms=()), Physics()).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    down, found = np.array([0.0, 0.0, -1.0]), []
    for x, y in points:
        top = np.array([x, y, arena.floor + high])
        found.append(high - mujoco.mj_ray(model, data, top, down, None, 1, -1, np.zeros(1, np.int32)))
    return np.array(found)


def on_starts(arena, name="P2AT"):
    """Return robots set down on all start poses of an arena."""
    places = [(*start.at[:2], start.yaw, start.at[2] - START_ELEVATION) for start in arena.starts]
    return Rig(name, arena=arena, places=places)


def deepest(rig):
    """Return how deep the deepest contact is before anything moves [m]."""
    mujoco.mj_forward(rig.model, rig.data)
    return float(max((-rig.data.contact.dist).max(initial=0.0), 0.0))


def roots(rig):
    """Return the poses of all robots' chassis (robots, 7)."""
    return np.array([rig.data.qpos[i.root_qposadr : i.root_qposadr + 7] for i in rig.indices])


def loose_qpos(rig):
    """Return the places of all loose objects [m] (objects, 3)."""
    return np.array([rig.data.body(f"loose/{loose.name}").xpos for loose in rig.arena.loose])


def loose_speeds(rig):
    """Return the speeds over ground of all loose objects [m/s] (objects,)."""
    names = [f"loose/{loose.name}" for loose in rig.arena.loose]
    return np.array([np.linalg.norm(rig.data.joint(name).qvel[:3]) for name in names])


NEAR = 0.25
"""How near to a point of its way a robot must get [m]."""


def head_for(rig, target, speed, gain=2.0):
    """Steer the first robot towards a point, with its inner wheels slower by what its heading is off.

    Returns:
        Distance to the point [m].
    """
    x, y = roots(rig)[0, :2]
    forward = rig.mat("chassis")[:2, 0]
    away = np.subtract(target, (x, y))
    error = np.arctan2(forward[0] * away[1] - forward[1] * away[0], forward @ away)
    turn = np.clip(gain * error, -1.0, 1.0)
    rig.tell(Left=speed * min(1.0, 1.0 - turn), Right=speed * min(1.0, 1.0 + turn))
    return float(np.linalg.norm(away))


def follow(rig, way, share, seconds, pose=None):
    """Drive the first robot along points at a share of its top speed.

    `pose`: angles of joints for a pitch [rad], nose up positive, to which they are moved on the way.

    Returns:
        Number of points that it has got to, and how upright it was at worst.
    """
    speed, way, worst = share * rig.robot.drive.max_spin, list(way), 1.0
    count = len(way)
    for _ in range(round(seconds / PERIOD)):
        if head_for(rig, way[0], speed) < NEAR:
            way.pop(0)
            if not way:
                break
        if pose is not None:
            rig.move(pose(np.arcsin(rig.mat("chassis")[2, 0])))
        rig.step()
        worst = min(worst, rig.up[0])
    return count - len(way), worst
