"""Doors: where they stand, and what of it rays and the radio notice."""

import math
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from usarmjx.comms.attenuation import RadioSettings
from usarmjx.engines.base import check_features
from usarmjx.models.compile.compose import door_boxes
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec, Door, StartPose
from usarmjx.server.wireless.radio_channel import RadioChannel
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.batch import Batch
from usarmjx.sim.radio import update_links
from usarmjx.sim.scene import build_scene

P2AT = ROBOTS.get("P2AT")
SCANNING = replace(P2AT, cameras=(), sensors=tuple(m for m in P2AT.sensors if m.kind == "RangeScanner"))
OPEN = 1.5
"""Angle at which a door leaves the way free [rad]."""
ARENA = ArenaSpec(
    name="doorway",
    floor=-0.5,
    starts=(
        StartPose(tag="West", at=(-1.5, 0.0, 0.188)),
        StartPose(tag="East", at=(1.5, 0.0, 0.188), yaw=math.pi),
    ),
    extent=((-3, 3), (-3, 3)),
    doors=(
        Door(name="middle", at=(0.0, -0.45, 0.0), yaw=math.pi / 2),
        Door(name="aside", at=(0.5, 2.0, 0.1), yaw=-0.7, size=(0.8, 0.1, 2.0)),
    ),
)


@pytest.fixture(scope="module")
def batch():
    return Batch(build_scene(ARENA, [SCANNING, SCANNING], radio=RadioSettings()), engine="c")


@pytest.mark.oracle
def test_panels_are_where_c_mujoco_has_them(batch):
    model, angles = batch.scene.model, np.array([0.8, -1.1], np.float32)
    data = mujoco.MjData(model)
    data.qpos[batch.scene.door_qpos] = angles
    mujoco.mj_kinematics(model, data)
    geoms = [model.geom(f"door/{door.name}").id for door in ARENA.doors]
    for pos, mat, size in (door_boxes(ARENA, angles), door_boxes(ARENA, jnp.asarray(angles), jnp)):
        np.testing.assert_allclose(pos, data.geom_xpos[geoms], atol=1e-6)
        np.testing.assert_allclose(mat, data.geom_xmat[geoms].reshape(-1, 3, 3), atol=1e-6)
        np.testing.assert_allclose(size, model.geom_size[geoms], atol=1e-6)


def turned(batch, angle):
    """The batch's state with the first door at an angle."""
    state, scene = batch.reset(), batch.scene
    qpos = np.array(batch.physics(state).qpos)
    qpos[:, scene.door_qpos[0]] = angle
    pinned, dof = np.zeros((1, scene.model.nq), bool), np.zeros((1, scene.model.nv), bool)
    pinned[:, scene.door_qpos[0]] = True
    return state.replace(physics=batch.engine.set_qpos(state.physics, pinned, dof, qpos))


@pytest.mark.parametrize(("angle", "walls"), [(0.0, 1), (OPEN, 0), (-OPEN, 0)])
def test_a_closed_door_weakens_a_link_and_an_open_one_does_not(batch, angle, walls):
    state = turned(batch, angle)
    world, physics = jax.tree.map(lambda x: x[0], (state.worlds, batch.physics(state)))
    links = jax.jit(partial(update_links, batch.scene))(world, physics)
    assert int(links.walls[0, 1]) == walls


@pytest.mark.parametrize(("angle", "reach"), [(0.0, "door"), (OPEN, "robot")])
def test_a_scanner_sees_the_door_or_what_is_behind_it(batch, angle, reach):
    """The scanner is 0.144 m ahead of the origin (captured); the door 2 cm thick to either side."""
    _, readings = batch.observe(turned(batch, angle))
    place = batch.scene.groups[0].suite.index("RangeScanner")
    ahead = float(readings[0][place].value[0, 0, 90])
    door = 1.5 - 0.1439 - 0.02
    assert ahead == pytest.approx(door, abs=0.01) if reach == "door" else ahead > door + 0.5


def test_a_served_radio_counts_doors_where_they_stand():
    world = DynamicWorld(ARENA, Physics(), 0)
    ether = RadioChannel(world, RadioSettings())
    ends = ((-1.5, 0.0, 0.0), (1.5, 0.0, 0.0))
    assert ether.obstacles_between(*ends) == 1
    engine = world._single.engine
    engine.data.qpos[engine.model.joint("door/middle").qposadr[0]] = OPEN
    assert ether.obstacles_between(*ends) == 0
    robot = world.spawn(ROBOTS.get("ComStation"), "Base", (2.0, -2.0, 0.0), (0.0, 0.0, 0.0))
    assert world.door_angles()[0] == pytest.approx(OPEN), "a new robot leaves doors as they are"
    assert ether.has_robot(robot.name)


def test_all_engines_take_doors(batch):
    for engine in ("c", "jax", "warp"):
        check_features(batch.scene.model, engine)
