"""Geoms that move between worlds of C MuJoCo, and the bounding volume hierarchy of their body.

MuJoCo builds that hierarchy at compile time: it would be outdated for moved geoms, and without it each geom
of a robot is tested against each of the arena's. It is rebuilt here when many geoms have moved (another
arena), and refitted when a few have (limbs of victims).
"""

from typing import Any, NamedTuple

import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import mat_from_quat

REBUILD_FRACTION = 0.5
"""Fraction of moved geoms above which the hierarchy is rebuilt."""


class BoundingTree(NamedTuple):
    """Bounding volume hierarchy of one world.

    Attributes:
        places: Position, orientation and half sizes of the bounding box of each movable geom (movable, 10).
        leaves: Centre and half size of each geom's box (geoms, 6).
        order: Geoms by leaf, from left to right (geoms,).
        boxes: Centre and half size of each node's box (nodes, 6).
    """

    places: np.ndarray
    leaves: np.ndarray
    order: np.ndarray
    boxes: np.ndarray


class MovedBody:
    """Movable geoms of a static body at the world's origin, and their hierarchy in each world.

    The hierarchy splits the geoms in halves, along the axis of the largest spread of their centres; so its
    topology depends only on their number.

    Args:
        model: The compiled model; its hierarchy takes that topology.
        ids: The movable geoms, all of one body.
    """

    def __init__(self, model: mujoco.MjModel, ids: list[int]) -> None:
        self.ids = np.array(ids)
        body, tree = int(model.geom_bodyid[ids[0]]), _bvh_fields(model)
        begin, count = int(tree.body_bvhadr[body]), int(tree.body_bvhnum[body])
        self._nodes = slice(begin, begin + count)
        leaves: np.ndarray = tree.bvh_nodeid[self._nodes]
        self._geoms: np.ndarray = np.sort(leaves[leaves >= 0])
        self._movable = np.flatnonzero(np.isin(self._geoms, self.ids))
        self._children, self._levels, self._leaf = _tree_topology(len(self._geoms))
        inner = [nodes[self._children[nodes, 0] >= 0] for nodes, _ in reversed(self._levels)]
        self._merges = [(nodes, *self._children[nodes].T) for nodes in inner if len(nodes)]
        self._worlds: dict[int, BoundingTree] = {}
        self._written: dict[int, BoundingTree] = {}
        if len(self._geoms):
            tree.bvh_child[self._nodes] = self._children
            for depth, (nodes, _) in enumerate(self._levels):
                tree.bvh_depth[self._nodes][nodes] = depth
            self._write_tree(model, self._bounding_tree(model, 0))

    def move(
        self, model: mujoco.MjModel, pos: Array, quat: Array, size: Array | None = None, world: int = 0
    ) -> None:
        """Move the geoms. The model must have their `geom_sameframe` cleared.

        Args:
            model: The model.
            pos: Positions (n, 3) [m].
            quat: Orientations (n, 4).
            size: Half sizes (n, 3) [m] of boxes; None: unchanged.
            world: The world, whose hierarchy is kept for its next call.
        """
        model.geom_pos[self.ids], model.geom_quat[self.ids] = pos, quat
        if size is not None:
            model.geom_size[self.ids], model.geom_aabb[self.ids, 3:] = size, size
            model.geom_rbound[self.ids] = np.linalg.norm(size, axis=-1)
        if len(self._geoms):
            self._write_tree(model, self._bounding_tree(model, world))

    def _bounding_tree(self, model: mujoco.MjModel, world: int) -> BoundingTree:
        known, movable = self._worlds.get(world), self._geoms[self._movable]
        places = np.hstack([model.geom_pos[movable], model.geom_quat[movable], model.geom_aabb[movable, 3:]])
        if known is None:
            leaves = _bounding_boxes(model, self._geoms)
            order = self._leaf_order(leaves)
        else:
            changed = self._movable[(known.places != places).any(axis=1)]
            if not len(changed):
                return known
            leaves, order = known.leaves.copy(), known.order
            leaves[changed] = _bounding_boxes(model, self._geoms[changed])
            if len(changed) > REBUILD_FRACTION * len(leaves):
                order = self._leaf_order(leaves)
        self._worlds[world] = BoundingTree(places, leaves, order, self._node_boxes(leaves[order]))
        return self._worlds[world]

    def _write_tree(self, model: mujoco.MjModel, known: BoundingTree) -> None:
        if self._written.get(id(model)) is known:
            return
        node_ids = np.full(len(self._children), -1, np.int32)
        node_ids[self._leaf] = self._geoms[known.order]
        tree = _bvh_fields(model)
        tree.bvh_nodeid[self._nodes], tree.bvh_aabb[self._nodes] = node_ids, known.boxes
        self._written[id(model)] = known

    def _leaf_order(self, boxes: np.ndarray) -> np.ndarray:
        """Return geoms by leaf, from their boxes: a node sorts its own along its longest axis (geoms,)."""
        mid, order = boxes[:, :3], np.arange(len(boxes))
        for _, starts in self._levels:
            here = mid[order]
            spread = np.maximum.reduceat(here, starts) - np.minimum.reduceat(here, starts)
            node = np.repeat(np.arange(len(starts)), np.diff([*starts, len(mid)]))
            along = np.take_along_axis(here, spread.argmax(axis=1)[node, None], axis=1)[:, 0]
            order = order[np.lexsort((along, node))]
        return order

    def _node_boxes(self, leaves: np.ndarray) -> np.ndarray:
        """Return the boxes of all nodes around those of the leaves, from left to right (nodes, 6)."""
        bounds = np.empty((len(self._children), 6))  # low corner, and high corner times -1
        mid, half = leaves[:, :3], leaves[:, 3:]
        bounds[self._leaf, :3], bounds[self._leaf, 3:] = mid - half, -(mid + half)
        for nodes, one, other in self._merges:
            bounds[nodes] = np.minimum(bounds[one], bounds[other])
        low, high = bounds[:, :3], -bounds[:, 3:]
        return np.hstack([(low + high) / 2, (high - low) / 2])


def _bvh_fields(model: mujoco.MjModel) -> Any:  # noqa: ANN401 - MuJoCo's types leave the tree's fields out
    return model


def _tree_topology(count: int) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """Return the topology of a hierarchy of `count` leaves.

    Returns:
        Children of each node (nodes, 2), -1 for a leaf; for each level its nodes, and the first leaf of each
        subtree of this and higher levels; the node of each leaf (leaves,).
    """
    children, leaf = np.full((max(2 * count - 1, 0), 2), -1, np.int32), np.zeros(count, int)
    levels: list[tuple[np.ndarray, np.ndarray]] = []
    level, used = [(0, 0, count)] if count else [], 1
    starts = [start for _, start, _ in level]
    while level:
        levels.append((np.array([node for node, _, _ in level]), np.array(starts)))
        below: list[tuple[int, int, int]] = []
        for node, start, end in level:
            if end - start == 1:
                leaf[start] = node
                continue
            middle = (start + end) // 2
            children[node] = used, used + 1
            below += [(used, start, middle), (used + 1, middle, end)]
            used += 2
        starts = sorted({*starts, *(start for _, start, _ in below)})
        level = below
    return children, levels, leaf


def _bounding_boxes(model: mujoco.MjModel, geoms: np.ndarray) -> np.ndarray:
    """Return centres and half sizes of bounding boxes of geoms, in their body's inertial frame (geoms, 6)."""
    body, own = model.geom_bodyid[geoms[0]], model.geom_aabb[geoms]
    with numpy_backend():
        frame, mat = mat_from_quat(model.body_iquat[body]), mat_from_quat(model.geom_quat[geoms])
    mat = frame.T @ mat
    mid = (model.geom_pos[geoms] - model.body_ipos[body]) @ frame + np.einsum("nij,nj->ni", mat, own[:, :3])
    return np.hstack([mid, np.einsum("nij,nj->ni", np.abs(mat), own[:, 3:])])
