"""Broad phase of solver `block`: bounding boxes of robots, objects and solids before those of their geoms.

MuJoCo Warp tests every pair of geoms in every world. Here a group is a kinematic tree, or a solid that does
not move; one launch finds the groups' boxes, another the pairs of geoms of groups whose boxes overlap.
MuJoCo Warp's own test decides on each of these. Pairs that it alone would pass are too far apart to touch.
"""

from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

import mujoco
import numpy as np
import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})

DRIVER = "mujoco.mjx.third_party.mujoco_warp._src.collision_driver"
"""Private; the version of MJX is pinned."""
FAR = wp.constant(1e6)
"""Half size of the box of a plane [m]."""
SLACK = wp.constant(1e-4)
"""Slack of the boxes for roundings [m]."""
ANY = -1
"""Group of pairs that are always tested: those with margins of their own."""


@dataclass(frozen=True)
class Table:
    """Pairs of geoms by pair of groups.

    Attributes:
        geoms: Geoms by group.
        first_geom: Index of the first geom of each group, and the number of geoms (groups + 1,).
        order: Indices in MuJoCo Warp's list of pairs.
        groups: Both groups of each pair of groups (n, 2).
        first_pair: Index in `order` of the first pair of each pair of groups, and the number of all (n + 1,).
    """

    geoms: np.ndarray
    first_geom: np.ndarray
    order: np.ndarray
    groups: np.ndarray
    first_pair: np.ndarray


def make_table(model: mujoco.MjModel, pairs: np.ndarray, own: np.ndarray) -> Table:
    """Return the table of a model.

    Args:
        model: The model.
        pairs: MuJoCo Warp's list of pairs of geoms (pairs, 2).
        own: Which of them have settings of their own (pairs,).
    """
    tree = _trees_of_geoms(model)
    group = np.where(tree >= 0, tree, int(tree.max(initial=-1)) + 1 + np.arange(model.ngeom))
    used, place = np.unique(group, return_inverse=True)
    geoms = np.argsort(place, kind="stable")
    first_geom = np.searchsorted(place[geoms], np.arange(len(used) + 1))
    both = np.where(own[:, None], ANY, np.sort(place[pairs.reshape(-1, 2)], axis=1))
    groups, of_pair = np.unique(both, axis=0, return_inverse=True)
    order = np.argsort(of_pair.ravel(), kind="stable")
    first_pair = np.searchsorted(of_pair.ravel()[order], np.arange(len(groups) + 1))
    return Table(geoms, first_geom, order, groups.reshape(-1, 2), first_pair)


def _trees_of_geoms(model: Any) -> np.ndarray:  # noqa: ANN401 - more of MuJoCo than its stubs have
    """Return the kinematic tree of each geom (ngeom,), -1 for what does not move."""
    return np.asarray(model.body_treeid)[model.geom_bodyid]


@wp.kernel(enable_backward=False, grid_stride=False)
def group_boxes(  # noqa: PLR0913 - a kernel's arguments are its buffers
    aabb: wp.array3d[wp.vec3],
    rbound: wp.array2d[float],
    margin: wp.array2d[float],
    gap: wp.array2d[float],
    geoms: wp.array[int],
    first: wp.array[int],
    xpos: wp.array2d[wp.vec3],
    xmat: wp.array2d[wp.mat33],
    low_out: wp.array2d[wp.vec3],
    high_out: wp.array2d[wp.vec3],
) -> None:
    """Find the boxes of the groups of all worlds, their margins included."""
    world, group = wp.tid()
    low = wp.vec3(FAR, FAR, FAR)
    high = -low
    for k in range(first[group], first[group + 1]):
        geom = geoms[k]
        turn = xmat[world, geom]
        shape = world % aabb.shape[0]
        half = aabb[shape, geom, 1]
        middle = xpos[world, geom]
        side = wp.vec3(FAR, FAR, FAR)
        if rbound[world % rbound.shape[0], geom] > 0.0:
            reach = margin[world % margin.shape[0], geom] + gap[world % gap.shape[0], geom]
            middle += turn * aabb[shape, geom, 0]
            for i in range(3):
                side[i] = reach + SLACK
                for j in range(3):
                    side[i] += wp.abs(turn[i, j]) * half[j]
        low = wp.min(low, middle - side)
        high = wp.max(high, middle + side)
    low_out[world, group] = low
    high_out[world, group] = high


@cache
def pairs_kernel(
    options: int, aabbs: int, rbounds: int, margins: int, gaps: int, own: int, own_gaps: int
) -> Any:  # noqa: ANN401
    """Return the kernel that lists pairs of geoms; arguments as of MuJoCo Warp's own test."""
    driver = import_module(DRIVER)
    near, add = (
        driver._broadphase_filter(options, aabbs, rbounds, margins, gaps, own, own_gaps),
        driver._add_geom_pair,
    )

    # fmt: off
    @wp.kernel(enable_backward=False, grid_stride=False, module="unique")
    def near_pairs(  # noqa: PLR0913 - as above
        geom_type: wp.array[int], aabb: wp.array3d[wp.vec3], rbound: wp.array2d[float],
        margin: wp.array2d[float], gap: wp.array2d[float],
        own_margin: wp.array2d[float], own_gap: wp.array2d[float],
        pairs: wp.array[wp.vec2i], ids: wp.array[wp.vec2i],
        groups: wp.array[wp.vec2i], first: wp.array[int], order: wp.array[int],
        low: wp.array2d[wp.vec3], high: wp.array2d[wp.vec3],
        xpos: wp.array2d[wp.vec3], xmat: wp.array2d[wp.mat33], room: int,
        count_out: wp.array[int], pair_out: wp.array[wp.vec2i], id_out: wp.array[wp.vec2i],
        world_out: wp.array[int],
    ) -> None:
        # fmt: on
        world, which = wp.tid()
        one, other = groups[which][0], groups[which][1]
        if one >= 0:
            for i in range(3):
                if low[world, one][i] > high[world, other][i] or low[world, other][i] > high[world, one][i]:
                    return
        for k in range(first[which], first[which + 1]):
            a, b, own_id = pairs[order[k]][0], pairs[order[k]][1], ids[order[k]]
            if own_id[1] >= 0 or near(
                aabb, rbound, margin, gap, own_margin, own_gap, xpos, xmat, a, b, own_id[0], world
            ):
                kinds = wp.vec2i(geom_type[a], geom_type[b])
                add(room, a, b, kinds[0], kinds[1], world, own_id, count_out, pair_out, id_out, world_out)

    return near_pairs


class BroadPhase:
    """Function in place of MuJoCo Warp's broad phase of all pairs.

    Args:
        table: Pairs of geoms of the model.
        device: Device of its arrays.
    """

    def __init__(self, table: Table, device: Any = None) -> None:  # noqa: ANN401
        array: Any = wp.array

        def put(value: np.ndarray, kind: Any = int) -> Any:  # noqa: ANN401
            return array(np.ascontiguousarray(value, np.int32), dtype=kind, device=device)

        self._geoms, self._first_geom = put(table.geoms), put(table.first_geom)
        self._order, self._first_pair = put(table.order), put(table.first_pair)
        self._pairs = put(table.groups, wp.vec2i)
        self.groups, self.group_pairs = len(table.first_geom) - 1, len(table.groups)

    def __call__(self, m: Any, d: Any, context: Any, awake: Any = None) -> None:  # noqa: ANN401
        """List the pairs of geoms that may touch, in MuJoCo Warp's arrays."""
        assert awake is None, "no sleeping trees, see `coverage`"
        low = wp.empty((d.nworld, self.groups), dtype=wp.vec3)
        high = wp.empty((d.nworld, self.groups), dtype=wp.vec3)
        shapes = [m.geom_aabb, m.geom_rbound, m.geom_margin, m.geom_gap]
        own = [m.pair_margin, m.pair_gap]
        poses = [d.geom_xpos, d.geom_xmat]
        wp.launch(
            group_boxes,
            dim=(d.nworld, self.groups),
            inputs=[*shapes, self._geoms, self._first_geom, *poses],
            outputs=[low, high],
        )
        kernel = pairs_kernel(m.opt.broadphase_filter, *(array.shape[0] for array in shapes + own))
        lists = [m.nxn_geom_pair_filtered, m.nxn_pairid_filtered, self._pairs, self._first_pair, self._order]
        wp.launch(
            kernel,
            dim=(d.nworld, self.group_pairs),
            inputs=[m.geom_type, *shapes, *own, *lists, low, high, *poses, d.naconmax],
            outputs=[
                d.ncollision,
                context.collision_pair,
                context.collision_pairid,
                context.collision_worldid,
            ],
        )
