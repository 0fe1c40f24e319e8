"""How deep robots are in anything where an arena has them start."""

import math

import mujoco
import numpy as np

from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.standing import standing_height
from usarmjx.models.robots import ROBOTS
from usarmjx.sim.scene import build_scene, start_height

SINGLE = 1e-6
"""Resolution of heights in single precision [m]."""


def deepest(arena, name, starts=None):
    """Return how deep a robot of that class is in the arena at each start [m], by tag; 0 where clear.

    It is counted from the depth at which the class stands on level ground.
    """
    scene = build_scene(arena, [name])
    model, data = scene.model, mujoco.MjData(scene.model)
    ours = np.isin(model.geom_bodyid, scene.groups[0].indices[0].body_ids)
    sinking = max(0.0, kinematic_tree_of(ROBOTS.get(name)).clearance - standing_height(ROBOTS.get(name)))
    found = {}
    for start in starts or arena.starts:
        mujoco.mj_resetData(model, data)
        root = data.joint("r0/root").qpos
        root[:3] = *start.at[:2], start_height(arena, start, ROBOTS.get(name))
        root[3:] = math.cos(start.yaw / 2), 0.0, 0.0, math.sin(start.yaw / 2)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        mine = ours[data.contact.geom].any(-1) if data.ncon else np.zeros(0, bool)
        found[start.tag] = max(0.0, -float(data.contact.dist[mine].min(initial=0.0)) - sinking - SINGLE)
    return found
