"""Water in an arena, and what it does to robots that are no submarines."""

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.models.drives import DRY_DEPTH
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.robot import RobotSpec


def depth_in_water(arena: ArenaSpec, pos: Array) -> Array:
    """Return how far points (..., 3) are below water, negative above it [m] (...,); else `DRY_DEPTH`."""
    depth = xp.full(pos.shape[:-1], DRY_DEPTH)
    for water in arena.waters:
        low, high = np.array(water.low), np.array(water.high)
        inside = (pos[..., :2] >= low[:2]).all(-1) & (pos[..., :2] <= high[:2]).all(-1)
        here = inside & (pos[..., 2] >= low[2] + arena.floor)
        depth = xp.where(here, high[2] + arena.floor - pos[..., 2], depth)
    return depth


def drowns(robot: RobotSpec, depth: Array) -> Array:
    """Return whether water kills the battery: of all but underwater robots (KRobot.uc) (...,)."""
    return (depth > 0) & (robot.drive.vehicle != "NauticVehicle")
