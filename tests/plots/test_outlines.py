"""What solids cover, against closed forms: how far a solid reaches along a direction."""

import math

import numpy as np
import pytest

from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.types.shapes import HeightField, Mesh, Shape
from usarmjx.plots.picture import CIRCLE_POINTS, area, height_range, outline

TETRAHEDRON = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float)
SHAPES = {
    "box": Shape(kind="box", size=(0.5, 0.3, 0.1)),
    "sphere": Shape(kind="sphere", size=(0.4,)),
    "capsule": Shape(kind="capsule", size=(0.2, 0.5)),
    "cylinder": Shape(kind="cylinder", size=(0.2, 0.5)),
    "ellipsoid": Shape(kind="ellipsoid", size=(0.5, 0.3, 0.1)),
    "mesh": Shape(kind="mesh", mesh=Mesh(TETRAHEDRON)),
}
ROUNDNESS = 1 - math.cos(math.pi / CIRCLE_POINTS)
"""What a polygon's middle of a side lies inside its circle, in radii."""


def reach(shape: Shape, way: np.ndarray) -> float:
    """How far a solid reaches from its place along a unit vector in its own frame."""
    size = np.array(shape.size)
    if shape.kind == "box":
        return float((np.abs(way) * size).sum())
    if shape.kind == "sphere":
        return size[0]
    if shape.kind == "ellipsoid":
        return float(np.linalg.norm(size * way))
    if shape.kind == "mesh":
        return float((TETRAHEDRON @ way).max())
    along, across = abs(way[2]) * size[1], math.hypot(way[0], way[1])
    return along + size[0] * (across if shape.kind == "cylinder" else 1.0)


@pytest.mark.oracle
@pytest.mark.parametrize("kind", SHAPES)
def test_outline_and_heights_are_as_far_out_as_the_solid(kind: str):
    rng = np.random.default_rng(0)
    for _ in range(20):
        at, rotation = rng.uniform(-2, 2, 3), rng.uniform(-math.pi, math.pi, 3)
        shape = Shape(**{**vars(SHAPES[kind]), "at": tuple(at), "rotation": tuple(rotation)})
        turn = mat_from_angles(*rotation)
        corners = outline(shape)
        for angle in rng.uniform(-math.pi, math.pi, 10):
            way = np.array([math.cos(angle), math.sin(angle), 0.0])
            expected = at @ way + reach(shape, turn.T @ way)
            found = (corners @ way[:2]).max()
            assert expected - 0.5 * ROUNDNESS - 1e-9 <= found <= expected + 1e-9  # radii up to 0.5
        low, high = height_range(shape)
        up = np.array([0.0, 0.0, 1.0])
        assert high == pytest.approx(at[2] + reach(shape, turn.T @ up))
        assert low == pytest.approx(at[2] - reach(shape, -turn.T @ up))


def test_outline_of_a_ramp_is_as_long_as_its_shadow():
    angle = math.radians(15)
    ramp = Shape(kind="box", size=(0.5, 0.3, 0.1), at=(1.0, 2.0, 0.0), rotation=(0.0, -angle, 0.0))
    shadow = outline(ramp)
    length = 1.0 * math.cos(angle) + 0.2 * math.sin(angle)
    assert np.ptp(shadow, axis=0) == pytest.approx((length, 0.6))
    assert shadow.mean(0) == pytest.approx((1.0, 2.0))
    assert area(shadow) == pytest.approx(length * 0.6)


def test_area_of_round_things():
    assert area(outline(SHAPES["sphere"])) == pytest.approx(math.pi * 0.16, rel=0.01)
    assert area(outline(SHAPES["ellipsoid"])) == pytest.approx(math.pi * 0.15, rel=0.01)
    assert area(np.array([(0, 0), (0, 2), (3, 0)])) == pytest.approx(3.0)


def test_terrain_covers_its_rectangle_from_its_bottom_to_its_highest_point():
    table = HeightField(np.array([[0.0, 0.2], [0.4, 0.7]]))
    ground = Shape(kind="hfield", size=(2.0, 1.0, 0.3), at=(1.0, 0.0, 0.5), heights=table)
    assert np.sort(outline(ground)[:, 0]) == pytest.approx([-1.0, -1.0, 3.0, 3.0])
    assert height_range(ground) == pytest.approx((0.2, 1.2))
