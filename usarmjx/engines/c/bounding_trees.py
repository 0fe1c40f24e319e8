"""Bounding volume hierarchies of bodies with many geoms, which C MuJoCo's contacts and rays descend.

A hierarchy decides only how much is looked at in vain: contacts and hits are the same with every one.
"""

from typing import NamedTuple

import numpy as np

REACH = 0.3
"""Enlargement of the footprints of boxes: about the width of what meets them [m]."""
EVENNESS = 1e-6
"""Share of its cost by which the most uneven split counts as worse: boxes at one place make no chain."""


class TreeShape(NamedTuple):
    """Topology of a hierarchy; node 0 is the root.

    Attributes:
        children: Children of each node, -1 for a leaf (nodes, 2).
        leaf: Node of each box (boxes,).
        depth: Level of each node (nodes,).
        merges: For each level, the deepest first, its inner nodes, and their children (n,).
    """

    children: np.ndarray
    leaf: np.ndarray
    depth: np.ndarray
    merges: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]

    def node_boxes(self, boxes: np.ndarray) -> np.ndarray:
        """Return the boxes of all nodes around those given: centre and half size (nodes, 6)."""
        bounds = np.empty((len(self.children), 6))  # low corner, and high corner times -1
        mid, half = boxes[:, :3], boxes[:, 3:]
        bounds[self.leaf, :3], bounds[self.leaf, 3:] = mid - half, -(mid + half)
        for nodes, one, other in self.merges:
            # With upper corners negated one minimum merges both.
            bounds[nodes] = np.minimum(bounds[one], bounds[other])
        low, high = bounds[:, :3], -bounds[:, 3:]
        return np.hstack([(low + high) / 2, (high - low) / 2])


def tree_shape(boxes: np.ndarray) -> TreeShape:
    """Return the topology that splits boxes, centre and half size (boxes, 6), so that few are met in vain.

    Each node splits its boxes in two by their centres along the axis, and at the place, with the least cost:
    the footprints of both parts, each times its number of boxes.
    """
    count = len(boxes)
    children, leaf = np.full((max(2 * count - 1, 0), 2), -1, np.int32), np.zeros(count, int)
    depth = np.zeros(len(children), np.int32)
    merges: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    # Boxes of all nodes of a level, node by node, and the numbers of these nodes.
    order, sizes = np.arange(count), np.array([count] if count > 1 else [], int)
    nodes, used = np.zeros(len(sizes), int), 1
    while len(nodes):
        order, left = _split(boxes, order, sizes)
        below = used + np.arange(2 * len(nodes)).reshape(-1, 2)
        children[nodes], used = below, used + below.size
        merges.append((nodes, below[:, 0], below[:, 1]))
        depth[below] = len(merges)
        parts, numbers = np.stack([left, sizes - left], 1).reshape(-1), below.reshape(-1)
        single = np.repeat(parts == 1, parts)
        leaf[order[single]] = numbers[parts == 1]
        order, sizes, nodes = order[~single], parts[parts > 1], numbers[parts > 1]
    # Deepest level first: a node's box comes after its children's.
    return TreeShape(children, leaf, depth, tuple(reversed(merges)))


def _split(boxes: np.ndarray, order: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return boxes of nodes in the order of their splits, and how many are in the first part of each.

    Args:
        boxes: Centre and half size (boxes, 6).
        order: Boxes, node by node (n,).
        sizes: Number of boxes of each node, at least two (nodes,).
    """
    starts, node = np.cumsum(sizes) - sizes, np.repeat(np.arange(len(sizes)), sizes)
    before = np.arange(1, len(order) + 1) - starts[node]  # boxes up to and with each
    after = sizes[node] - before
    least, chosen, first = np.full(len(sizes), np.inf), order, sizes // 2
    for along in boxes[:, :3].T:
        found = order[np.lexsort((along[order], node))]
        low, high = boxes[found, :2] - boxes[found, 3:5], boxes[found, :2] + boxes[found, 3:5]
        # Nodes are moved apart by more than their extent, so that one pass accumulates within each.
        apart = (node * (1.0 + high.max() - low.min()))[:, None]
        one = np.maximum.accumulate(high + apart) - np.minimum.accumulate(low - apart) - 2 * apart
        other = (np.maximum.accumulate((high - apart)[::-1]) - np.minimum.accumulate((low + apart)[::-1]))[
            ::-1
        ] + 2 * apart
        # The last place of each node stays infinite: it would leave the second part empty.
        cost = np.full(len(order), np.inf)
        splits = np.flatnonzero(after)
        cost[splits] = (one[splits] + REACH).prod(1) * before[splits]
        cost[splits] += (other[splits + 1] + REACH).prod(1) * after[splits]
        cost *= 1.0 + EVENNESS * np.abs(before - after) / sizes[node]
        best = np.minimum.reduceat(cost, starts)
        place = np.flatnonzero(cost == best[node])
        here = place[np.searchsorted(place, starts)] - starts + 1  # the first of equal ones
        better = best < least
        chosen = np.where(better[node], found, chosen)
        first, least = np.where(better, here, first), np.where(better, best, least)
    return chosen, first
