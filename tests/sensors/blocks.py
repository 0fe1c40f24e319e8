"""Rooms of blocks that our rays and C MuJoCo's see alike."""

import math

import mujoco
import numpy as np

BLOCKS = 6


def random_blocks(seed):
    """Blocks (centre, half lengths, yaw) around the origin, some of them in the air."""
    rng = np.random.default_rng(seed)
    blocks = []
    for _ in range(BLOCKS):
        bearing, far = rng.uniform(-math.pi, math.pi), rng.uniform(2.0, 6.0)
        centre = (far * math.cos(bearing), far * math.sin(bearing), rng.uniform(0.0, 4.0))
        blocks.append((centre, tuple(rng.uniform(0.3, 2.0, 3)), bearing))
    return tuple(blocks)


def c_rays(blocks, origin, directions, floor=True):
    """Distances [m] (rays,) that C MuJoCo gives, infinite without a hit."""
    spec = mujoco.MjSpec()
    if floor:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1))
    for centre, half, yaw in blocks:
        turn = (math.cos(yaw / 2), 0, 0, math.sin(yaw / 2))
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=centre, size=half, quat=turn)
    model = spec.compile()
    data, geom = mujoco.MjData(model), np.zeros(1, np.int32)
    mujoco.mj_kinematics(model, data)
    met = [
        mujoco.mj_ray(model, data, np.asarray(origin, float), along, None, 1, -1, geom)
        for along in np.asarray(directions, float)
    ]
    return np.where(np.array(met) < 0, np.inf, met)
