"""How much scratch `warp` needs for convex pairs: for those that can touch, not for every contact.

MuJoCo Warp looks at some pairs of kinds, such as two boxes, or a cylinder and a box, by an iteration that
needs kilobytes for each pair it looks at, one pair of kinds after the other. It looks at those whose boxes
overlap. That is one for each robot or two where the floor is a plane, and a dozen where it is made of boxes.
"""

from importlib import import_module

import mujoco
import numpy as np

NUM_KINDS = int(mujoco.mjtGeom.mjGEOM_MESH) + 1
"""Kinds of geoms that touch."""
NEAR = 0.05
"""Geoms whose boxes are this close count as near [m]."""
AT_ONCE = 2
"""Room for so many times the pairs that are near each other at the start."""
LEAST_SHARE = 0.25
"""Room for at least that share of all contacts. A P2AT has room for 16 contacts and, driving at random in
`yellow`, `orange` and `red`, 0.4 such pairs on average and 1.2 at most."""


def convex_kinds() -> np.ndarray:
    """Return which pairs of kinds are looked at in that way, the lower one first (kinds, kinds)."""
    # Not public; the version of MJX is pinned.
    table = import_module("mujoco.mjx.third_party.mujoco_warp._src.collision_driver").MJ_COLLISION_TABLE
    convex = np.zeros((NUM_KINDS, NUM_KINDS), bool)
    for kinds, how in table.items():
        if max(map(int, kinds)) < len(convex):
            convex[tuple(map(int, kinds))] = how.name == "CONVEX"
    return convex


def world_boxes(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the boxes about all geoms at the start, along the world's axes [m] (geoms, 3)."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mat = data.geom_xmat.reshape(-1, 3, 3)
    middle = data.geom_xpos + (mat @ model.geom_aabb[:, :3, None])[..., 0]
    half = (np.abs(mat) @ model.geom_aabb[:, 3:, None])[..., 0] + NEAR / 2
    return middle - half, middle + half


def convex_room(model: mujoco.MjModel, pairs: np.ndarray, contacts: int) -> int:
    """Return for how many convex pairs of one world there should be room.

    Args:
        model: The model; its robots stand at their starts.
        pairs: Geoms that may touch (pairs, 2).
        contacts: For how many contacts of a world there is room.
    """
    kinds = np.sort(model.geom_type[pairs], axis=1)
    pairs, kinds = (rows[convex_kinds()[kinds[:, 0], kinds[:, 1]]] for rows in (pairs, kinds))
    low, high = world_boxes(model)
    one, other = pairs.T
    near = ((low[one] <= high[other]) & (low[other] <= high[one])).all(1)
    _, counts = np.unique(kinds[near], axis=0, return_counts=True)
    most = AT_ONCE * int(counts.max(initial=0))
    return int(np.clip(most, np.ceil(LEAST_SHARE * contacts), contacts))
