"""Hierarchies of boxes: their splits against all that are possible, and what is looked at in vain."""

import math

import numpy as np
import pytest

from usarmjx.engines.c.bounding_trees import REACH, tree_shape


def scattered(seed, count):
    """Boxes, centre and half size (count, 6)."""
    rng = np.random.default_rng(seed)
    return np.hstack([rng.uniform(-5, 5, (count, 3)), rng.uniform(0.02, 0.8, (count, 3))])


def footprint(boxes):
    """Area of what is around boxes, seen from above, enlarged by `REACH` [m2]."""
    low, high = (boxes[:, :2] - boxes[:, 3:5]).min(0), (boxes[:, :2] + boxes[:, 3:5]).max(0)
    return np.prod(high - low + REACH)


def cost(parts):
    return sum(footprint(part) * len(part) for part in parts)


def below(shape, node):
    """Boxes below a node."""
    children = shape.children[node]
    if children[0] < 0:
        return np.flatnonzero(shape.leaf == node).tolist()
    return [box for child in children.tolist() for box in below(shape, child)]


@pytest.mark.parametrize("seed", range(3))
def test_each_split_is_the_cheapest_of_all(seed):
    boxes = scattered(seed, 30)
    shape = tree_shape(boxes)
    assert sorted(below(shape, 0)) == list(range(30))
    for node in np.flatnonzero(shape.children[:, 0] >= 0).tolist():
        chosen = boxes[below(shape, node)]
        by_axis = [chosen[np.argsort(chosen[:, axis])] for axis in range(3)]
        least = min(cost((row[:k], row[k:])) for row in by_axis for k in range(1, len(chosen)))
        found = cost([boxes[below(shape, child)] for child in shape.children[node].tolist()])
        assert found == pytest.approx(least, rel=1e-5)  # the most uneven split counts a millionth more


def test_boxes_at_one_place_make_no_chain():
    shape = tree_shape(np.tile(scattered(0, 1), (64, 1)))
    assert shape.depth.max() == math.log2(64)


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_boxes_make_a_tree(count):
    boxes = scattered(1, count)
    shape = tree_shape(boxes)
    assert len(shape.children) == max(2 * count - 1, 0)
    assert sorted(shape.leaf) == np.flatnonzero(shape.children[:, 0] < 0).tolist()
    np.testing.assert_allclose(shape.node_boxes(boxes)[shape.leaf], boxes, atol=1e-15)
