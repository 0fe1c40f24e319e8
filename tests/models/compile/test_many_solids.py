"""An arena of many solids has them as geoms of the world, which MuJoCo need not bound in each step."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from usarmjx.models.compile.compose import MAX_BODY_SOLIDS, add_robot, new_spec, split_long_boxes
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import Shape

pytestmark = pytest.mark.oracle

SIDE = 17
"""Plates in a row and in a column."""
FLOOR = 0.4
"""Height of the floor [m]."""


def plates(count=SIDE * SIDE):
    """An arena of tilted plates over its floor, 0.5 m apart, the first 2 m from the origin along x."""
    at = [(2 + 0.5 * (i % SIDE), 0.5 * (i // SIDE) - 4, 0.01) for i in range(SIDE * SIDE)]
    shapes = tuple(
        Shape(kind="box", size=(0.2, 0.15, 0.02), at=one, rotation=(0.05, 0.1, 0.2), surface="ground")
        for one in at[:count]
    )
    return ArenaSpec(name="plates", starts=(), extent=((-3, 12), (-6, 6)), floor=FLOOR, shapes=shapes)


def model_of(moves):
    """A model of a P2AT among the plates."""
    spec = new_spec(plates(), Physics(), moves=moves)
    add_robot(spec, ROBOTS.get("P2AT"), "r/", (0.0, 0.0, 0.0))
    return spec.compile()


@pytest.mark.parametrize(("count", "body"), [(MAX_BODY_SOLIDS, "arena"), (MAX_BODY_SOLIDS + 1, "world")])
def test_more_solids_than_the_bound_are_geoms_of_the_world(count, body):
    model = new_spec(plates(count), Physics()).compile()
    owners = {model.body(int(model.geom(f"arena/{i}").bodyid[0])).name for i in range(count)}
    assert owners == {body}


def test_geoms_of_the_world_lie_where_those_of_the_arena_do():
    found = []
    for moves in (False, True):
        model = new_spec(plates(), Physics(), moves=moves).compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        ids = [model.geom(f"arena/{i}").id for i in range(SIDE * SIDE)]
        found.append((ids, data.geom_xpos[ids], data.geom_xmat[ids]))
    (ids, pos, mat), (wanted_ids, wanted_pos, wanted_mat) = found
    assert ids == wanted_ids
    np.testing.assert_allclose(pos, wanted_pos, rtol=0, atol=1e-15)
    np.testing.assert_allclose(mat, wanted_mat, rtol=0, atol=1e-15)


def test_a_robot_touches_the_same_solids_at_the_same_depths():
    found = []
    for moves in (False, True):
        model = model_of(moves)
        data = mujoco.MjData(model)
        touched = []
        for x in np.linspace(0.0, 8.0, 33):  # sunk into floor and plates
            data.qpos[:3] = x, 0.1, FLOOR + 0.15
            mujoco.mj_forward(model, data)
            pairs = [
                (*(model.geom(int(g)).name for g in contact.geom), round(contact.dist, 12))
                for contact in data.contact
            ]
            touched.append(sorted(pairs))
        found.append(touched)
    assert found[0] == found[1]
    assert sum(pair[0].startswith("arena/") for pairs in found[0] for pair in pairs) > 33


def test_pieces_of_a_long_box_fill_it_also_as_geoms_of_the_world():
    """Of a wall of 3 x 0.1 x 0.1 m the pieces are at most 0.25 m long: 12 of them."""
    wall = Shape(kind="box", size=(1.5, 0.05, 0.05), at=(0.0, 3.0, 0.05), rotation=(0.0, 0.0, 0.3))
    arena = plates()
    small = tuple(replace(plate, size=(0.1, 0.1, 0.02)) for plate in arena.shapes)
    model = split_long_boxes(new_spec(replace(arena, shapes=(*small, wall)), Physics()), 0.25)
    names = [model.geom(g).name for g in range(model.ngeom)]
    assert {model.body(int(b)).name for b in model.geom_bodyid} == {"world"}
    pieces = np.array([name.startswith(f"arena/{len(small)}/") for name in names])
    assert pieces.sum() == 12
    assert 8 * model.geom_size[pieces].prod(-1).sum() == pytest.approx(3.0 * 0.1 * 0.1)
    np.testing.assert_allclose(model.geom_pos[pieces].mean(0), (0.0, 3.0, 0.05 + FLOOR), atol=1e-12)
