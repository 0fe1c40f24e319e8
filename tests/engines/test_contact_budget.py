"""Scratch of `warp` for convex pairs is sized by what can touch, and what it lacks is told."""

import itertools

import mujoco
import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

from usarmjx.engines.mjx_warp import (
    MIN_CONVEX_FRACTION,
    NEAR_BOX_GAP,
    WarpEngine,
    convex_contact_budget,
    convex_kinds,
    world_boxes,
)
from usarmjx.sim.scene import build_scene

Geom = mujoco.mjtGeom
FLOOR = {"plane": "type='plane' size='9 9 1'", "box": "type='box' size='9 9 .1' pos='0 0 -.1'"}


def standing(floor, number, apart=1.0):
    """Boxes in a row on a floor, a little above it, and all pairs of geoms."""
    bodies = "".join(
        f"<body pos='{apart * i} 0 {0.1 + NEAR_BOX_GAP / 2}'><freejoint/>"
        "<geom type='box' size='.1 .1 .1'/></body>"
        for i in range(number)
    )
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><geom {FLOOR[floor]}/>{bodies}</worldbody></mujoco>"
    )
    return model, np.array(list(itertools.combinations(range(model.ngeom), 2)))


def test_boxes_are_convex_pairs_and_planes_are_not():
    convex = convex_kinds()
    assert convex[Geom.mjGEOM_BOX, Geom.mjGEOM_BOX]
    assert convex[Geom.mjGEOM_CYLINDER, Geom.mjGEOM_BOX]
    assert not convex[Geom.mjGEOM_PLANE].any()
    assert not convex[Geom.mjGEOM_SPHERE, Geom.mjGEOM_BOX]


def test_there_is_room_for_twice_what_is_near():
    assert convex_contact_budget(*standing("plane", 8), contacts=40) == MIN_CONVEX_FRACTION * 40
    assert convex_contact_budget(*standing("box", 8), contacts=40) == 2 * 8
    assert convex_contact_budget(*standing("box", 8), contacts=12) == 12  # never more than contacts
    assert convex_contact_budget(*standing("plane", 8, apart=0.2), contacts=40) == 2 * 7  # side by side


def test_turned_geoms_have_boxes_about_all_of_them():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom type='box' size='1 .1 .1' pos='0 0 2' euler='0 0 90'/></worldbody></mujoco>"
    )
    low, high = world_boxes(model)
    np.testing.assert_allclose(
        high - low, [[0.2 + NEAR_BOX_GAP, 2 + NEAR_BOX_GAP, 0.2 + NEAR_BOX_GAP]], atol=1e-6
    )
    np.testing.assert_allclose((high + low) / 2, [[0, 0, 2]], atol=1e-6)


def test_an_engine_has_less_scratch_than_contacts():
    scene = build_scene("yellow", ["P2AT"] * 2)
    engine = WarpEngine(scene.spec, scene.physics, 3, scene.moved_geoms, scene.varied_bodies)
    data = engine._make_data()
    assert data._impl.naccdmax <= 0.4 * data._impl.naconmax
    assert data._impl.naccdmax % 3 == 0
