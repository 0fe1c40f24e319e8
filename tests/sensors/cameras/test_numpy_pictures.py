"""Pictures on NumPy, with the rays of C MuJoCo, against those of the same renderer on JAX."""

import math
from dataclasses import replace
from unittest import mock

import jax
import numpy as np
import pytest

from tests.lands import hills
from tests.server.worlds.test_dynamic_world_view import POND, box
from tests.sim.on_numpy import nothing_compiled
from tests.viewpoints import viewpoint_at
from usarmjx.models.arenas.yellow import YELLOW
from usarmjx.models.robots.kit import camera
from usarmjx.models.robots.pioneer import P2AT, P2DX
from usarmjx.models.types.arena import ArenaSpec, Door
from usarmjx.models.types.robot import Mount, options
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.cameras import casters, shading
from usarmjx.sensors.cameras import picture as picture_module
from usarmjx.sensors.cameras.mounts import cameras_of
from usarmjx.sensors.cameras.paint import (
    ARENA_LABEL,
    DOOR_LABEL,
    FALSE_ALARM_LABEL,
    LOOSE_LABEL,
    OUTSIDE_LABEL,
    ROBOT_LABEL,
    SKY_LABEL,
    VICTIM_LABEL,
)
from usarmjx.sensors.cameras.picture import render_picture
from usarmjx.sensors.cameras.programs import pad_render_scene
from usarmjx.sensors.cameras.shading import SUN_DIRECTION
from usarmjx.sensors.rays.raycast import nearest_hits
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.served_world import CameraRequest, ViewpointRequest
from usarmjx.sim.control import CommandUpdate

SIZE = (80, 64)
EDGE = 0.01
"""Share of pixels on an edge, where a ray of single precision may meet the other side."""
NEAR = 1e-4
"""Error of a depth, as a share of it: single precision, and rays that graze what they meet."""
LEVELS = 2
"""Difference of a colour, of 255: both round half a level, and light that falls off steeply another one."""
LOOKER = replace(
    P2DX,
    name="Looker",
    cameras=(
        camera(),
        replace(
            camera("Stereo", at=(0.2, 0.0, -0.3), parent="HARD"),
            options=options(CameraDefFov=1.0, IsStereo=True, StereoSpacing=(("Y", 0.05),)),
        ),
        replace(camera("Mirror", at=(0.0, 0.0, -0.3), parent="HARD"), options=options(Omni=True)),
    ),
    effecters=(Mount(kind="Headlight", name="Lamp", at=(0.3, 0.0, -0.1)),),
)
EYES = [camera.eye_offsets.copy() for camera in cameras_of(LOOKER)]
GARDEN = replace(
    POND,
    shapes=(
        *POND.shapes,
        box((1.2, -0.9, 0.3), (0.05, 0.3, 0.3), material="fender"),
        box((5.0, 0.0, 1.0), (0.1, 6.0, 3.0), material="sky"),
        Shape(kind="ellipsoid", size=(0.2, 0.3, 0.25), at=(2.2, 1.2, 0.4), surface="fixture"),
        Shape(kind="cylinder", size=(0.15, 0.3), at=(1.0, 1.0, 0.3), surface="fixture"),
        Shape(kind="capsule", size=(0.1, 0.2), at=(-1.0, 0.8, 0.4), surface="fixture"),
    ),
    doors=(Door(name="door", at=(1.9, -1.0, 0.0), yaw=-1.8),),
)
"""All there is to see, by a lamp and headlights."""
DAY = replace(
    POND,
    lights=(),
    waters=(),
    shapes=(*POND.shapes[1:], hills(np.random.default_rng(3), at=(1.5, -1.5, 0.2))),
)
"""Terrain, a mirror and a mesh in the sun, which throw shadows."""


def inhabited(arena, *robots):
    """A world with robots at its first start poses, their headlights on, that have come to rest."""
    world = DynamicWorld(arena, seed=1)
    for robot, start in zip(robots, world.arena.starts, strict=False):
        made = world.spawn(robot, start.tag, (*start.at[:2], world.arena.floor + 0.3), (0.0, 0.0, start.yaw))
        world.update_command(made, CommandUpdate(light=True))
    for _ in range(40):
        world.step()
    return world


@pytest.fixture(scope="module")
def garden():
    return inhabited(GARDEN, LOOKER, LOOKER)


_nearest_hits = jax.jit(nearest_hits)


def _change_now(needed, change, value):
    return change(value) if needed else value


def both(world, slot, name):
    """A picture on NumPy, and that of JAX: with room for more robots, as in programs for accelerators.

    One program of this scene has each cast seven times and takes 25 s to compile: only casts are programs.
    """
    robot = world.robots[slot]
    request = CameraRequest(robot, robot.camera_index(name), *SIZE)
    (picture,) = world.snapshot([request])()
    scene, viewpoint = pad_render_scene(world._single.render_scene()), world.viewpoint(request)
    with (
        mock.patch.object(casters, "nearest_hits", _nearest_hits),
        mock.patch.object(shading, "_change_if", _change_now),
    ):
        compiled = render_picture(scene, viewpoint, *SIZE)
    return picture, jax.device_get(compiled)


def assert_same(picture, compiled):
    assert (picture.segmentation == compiled.segmentation).mean() > 1 - EDGE
    assert np.isclose(picture.depth, compiled.depth, rtol=NEAR, atol=0.0).mean() > 1 - EDGE
    off = np.abs(picture.rgb.astype(int) - compiled.rgb).max(-1)
    assert (off <= LEVELS).mean() > 1 - EDGE
    for ours, theirs in zip(jax.tree.leaves(picture), jax.tree.leaves(compiled), strict=True):
        assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape)


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["Camera", "Stereo", "Mirror"])
def test_all_lenses_show_what_they_show_on_jax(garden, name):
    for slot in (0, 1):
        assert_same(*both(garden, slot, name))


def looks(world):
    """What all cameras of its two robots see."""
    return [
        world.snapshot([CameraRequest(world.robots[slot], i, *SIZE)])()[0]
        for slot in (0, 1)
        for i in range(3)
    ]


def test_there_is_everything_to_compare(garden):
    labels = {label for picture in looks(garden) for label in np.unique(picture.segmentation).tolist()}
    assert labels == {
        OUTSIDE_LABEL,
        SKY_LABEL,
        ARENA_LABEL,
        LOOSE_LABEL,
        DOOR_LABEL,
        VICTIM_LABEL,
        FALSE_ALARM_LABEL,
        ROBOT_LABEL,
        ROBOT_LABEL + 1,
    }


CHANGES = {
    "glass": {"shapes": GARDEN.shapes[1:]},
    "a mirror": {"shapes": (GARDEN.shapes[0], *GARDEN.shapes[2:])},
    "a fender": {"shapes": (*GARDEN.shapes[:3], *GARDEN.shapes[4:])},
    "water": {"waters": ()},
    "a lamp": {"lights": ()},
}


@pytest.mark.parametrize("what", CHANGES)
def test_all_of_it_makes_a_difference(garden, what):
    """Else the comparison above would compare nothing."""
    without = inhabited(replace(GARDEN, **CHANGES[what]), LOOKER, LOOKER)
    pairs = zip(looks(garden), looks(without), strict=True)
    assert sum((np.abs(a.rgb.astype(int) - b.rgb).max(-1) > 5).sum() for a, b in pairs) > 20


@pytest.mark.every_run("day")
@pytest.mark.oracle
@pytest.mark.parametrize(("arena", "robot"), [(DAY, LOOKER), (YELLOW, P2AT)], ids=["day", "yellow"])
def test_sun_shadows_and_terrain_are_those_on_jax(arena, robot):
    world = inhabited(arena, robot, robot)
    slot = 0 if arena is DAY else 1  # who does not stand in front of a wall
    picture, compiled = both(world, slot, robot.cameras[0].name)
    assert_same(picture, compiled)
    assert {SKY_LABEL, ARENA_LABEL} <= set(np.unique(picture.segmentation).tolist())


def test_what_stands_in_the_sun_throws_a_shadow_as_long_as_it_says():
    """A wall of 1 m that faces the sun's azimuth darkens the floor behind it for 1 m over the tangent."""
    sun = np.array(SUN_DIRECTION) / np.linalg.norm(SUN_DIRECTION)
    yaw, length = math.atan2(sun[1], sun[0]), math.hypot(*sun[:2]) / sun[2]
    wall = box((0.0, 0.0, 0.5), (0.01, 20.0, 0.5), rotation=(0.0, 0.0, yaw))
    world = DynamicWorld(ArenaSpec(name="wall", starts=(), extent=((-5, 5), (-5, 5)), shapes=(wall,)))
    behind = -np.array([math.cos(yaw), math.sin(yaw), 0.0])
    # Straight down on the line at right angles to the wall, a pixel to a centimetre.
    height, pixels = 20.0, 401
    middle = (0.01 + length) * behind
    view = viewpoint_at((*middle[:2], height), yaw + math.pi, math.pi / 2).replace(
        fov=np.float32(2 * math.atan(pixels * 0.01 / 2 / height))
    )
    (picture,) = world.snapshot([ViewpointRequest(view, pixels, pixels)])()
    column = picture.rgb[:, pixels // 2].astype(int).sum(-1)
    lit, edge = column[0], np.flatnonzero(np.abs(np.diff(column)) > 100)
    assert lit > column[pixels // 2 + 5]
    assert np.abs(edge - pixels // 2).min() <= 1  # a pixel


def test_a_snapshot_is_of_its_moment_whatever_becomes_of_the_world():
    world = inhabited(GARDEN, LOOKER, LOOKER)
    requests = [CameraRequest(world.robots[0], index, *SIZE) for index in range(3)]
    once, later = world.snapshot(requests), world.snapshot(requests)
    expected = once()
    world.update_command(world.robots[0], CommandUpdate(drive={"Left": 3.0, "Right": -3.0}))
    for _ in range(30):
        world.step()
        world.observe(list(world.robots.values()))
    moved = world.snapshot(requests)()
    world.remove(world.robots[1])
    for before, after, now in zip(expected, later(), moved, strict=True):
        for one, same in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
            np.testing.assert_array_equal(one, same)
        assert (before.rgb != now.rgb).any()


def test_to_render_leaves_the_world_as_it_is(garden):
    """Rays are told by groups of geoms what they pass: of a model of their own."""
    engine = garden._single.engine
    garden.observe(list(garden.robots.values()))
    groups, qpos = engine.model.geom_group.copy(), engine.data.qpos.copy()
    garden.snapshot([CameraRequest(garden.robots[0], 0, *SIZE)])()
    np.testing.assert_array_equal(engine.model.geom_group, groups)
    np.testing.assert_array_equal(engine.data.qpos, qpos)
    assert all(
        np.array_equal(camera.eye_offsets, copy)
        for camera, copy in zip(cameras_of(LOOKER), EYES, strict=True)
    )


def test_nothing_is_compiled_for_a_picture(garden):
    with nothing_compiled():
        garden.snapshot([CameraRequest(garden.robots[0], index, 24, 16) for index in range(3)])()


def test_a_large_picture_is_rendered_in_parts(garden, monkeypatch):
    request = CameraRequest(garden.robots[0], 1, *SIZE)
    (whole,) = garden.snapshot([request])()
    monkeypatch.setattr(picture_module, "CHUNK", 640)
    (parts,) = garden.snapshot([request])()
    for one, same in zip(jax.tree.leaves(whole), jax.tree.leaves(parts), strict=True):
        # The point from which the sun's rays are cast is another one for each part.
        assert np.isclose(one.astype(float), same).mean() > 1 - EDGE
