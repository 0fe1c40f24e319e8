"""A robot that does on engine `planar` what it is told at once, and how to drive it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.engines.planar.neighbor_lists import Margin, build_neighbor_list
from usarmjx.engines.planar.proposed_motion import SolidPlacement
from usarmjx.engines.planar.responses import Response, override_response
from usarmjx.models.robots import ROBOTS

SINGLE = 2e-4
"""What is rounded over a second in single precision [m, rad]."""
AT_ONCE = Response(forward_lag=1e-4, turn_lag=1e-4, acceleration=1e4, turn_acceleration=1e4, cornering=1e4)
"""Does what it is told at once."""
BLIND = replace(ROBOTS.get("P2AT"), sensors=(), cameras=())
EAGER = replace(BLIND, name="Eager", battery_life=1e6)
"""A P2AT that does what it is told at once."""

override_response(EAGER, AT_ONCE)


def around(prints, solids, floor=0.0):
    """What is around robots (worlds, robots) whose worlds all have the same solids."""

    def of_world(one):
        reach = Margin(aside=jnp.full_like(one.low, 0.1), height=jnp.zeros_like(one.low))
        scene = SolidPlacement(loose=jnp.zeros(0), geoms=jnp.zeros((0, 10)))
        return build_neighbor_list(one, one.low + one.step, solids, floor, reach, scene)

    return jax.vmap(of_world)(prints)


def drive(batch, left, right, steps, state=None):
    state = batch.drive(batch.reset() if state is None else state, 0, {"Left": left, "Right": right})
    for _ in range(steps):
        state = batch.step(state)
    return state


def poses(batch, state):
    """Positions on the plan and headings (worlds, robots, 3)."""
    group = batch.scene.groups[0]
    root = np.asarray(batch.physics(state).qpos)[:, group.root_qposadr]
    yaw = 2 * np.arctan2(root[..., 6], root[..., 3])
    return np.concatenate([root[..., :2], yaw[..., None]], -1)
