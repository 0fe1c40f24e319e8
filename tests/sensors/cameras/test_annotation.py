"""Instances, normals and optical flow of pictures against closed forms."""

import math
from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.sensors.cameras.stages import PLANE, solid, stage_of
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.robots.pioneer import P2DX
from usarmjx.models.types.arena import ArenaSpec, Door, FalseAlarm, LooseObject, StartPose, Victim
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.cameras.paint import (
    ARENA_LABEL,
    DOOR_LABEL,
    FALSE_ALARM_LABEL,
    INSTANCES,
    LOOSE_LABEL,
    ROBOT_LABEL,
    SKY_LABEL,
    VICTIM_LABEL,
)
from usarmjx.sensors.cameras.picture import HIDDEN_GEOMS_MULTIPLE, Viewpoint, annotate
from usarmjx.sensors.rays.raycast import EXCLUDE_NONE
from usarmjx.sim.batch import Annotator, Batch
from usarmjx.sim.scene import build_scene

WIDTH, HEIGHT, FOV = 24, 16, 1.2
FOCAL = WIDTH / 2 / math.tan(FOV / 2)
PIXEL = 2e-3  # pixels: single precision of some metres, of which a pixel is a tenth
RED = (0.5, 0.0, 0.0)
_annotate = jax.jit(annotate, static_argnames=("width", "height"))


def eye(pos=(0.0, 0.0, 1.0), yaw=0.0, pitch=0.0, fov=FOV):
    return Viewpoint(
        pos=np.float32(pos),
        mat=mat_from_angles(0.0, pitch, yaw).astype(np.float32),
        eye_offsets=np.zeros((1, 3), np.float32),
        fov=np.float32(fov),
        default_fov=np.float32(fov),
        slot=np.asarray(EXCLUDE_NONE),
        hidden_geoms=np.zeros(HIDDEN_GEOMS_MULTIPLE, bool),
        lens="pinhole",
    )


def stage(ball=(3.0, 0.4, 1.0)):
    """A floor, a wall 5 m ahead and a box in between."""
    scene = stage_of(
        solid((0, 0, 0), (0, 0, 1), RED, kind=PLANE, label=ARENA_LABEL),
        solid((5.5, 0, 2), (0.5, 9, 9), RED, label=ARENA_LABEL),
        solid(ball, (0.2, 0.2, 0.2), RED, label=LOOSE_LABEL),
    )
    instance = np.int32(INSTANCES) * scene.appearance.label
    return scene.replace(appearance=scene.appearance.replace(instance=instance))


def shown(before, after=None, here=None, there=None):
    here = here or eye()
    seen = _annotate(before, here, after or before, there or here, WIDTH, HEIGHT)
    return jax.tree.map(np.asarray, seen)


def columns_and_rows():
    """To the right and down of the middle [pixels] (height, width)."""
    return np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)


@pytest.mark.oracle
@pytest.mark.parametrize("yaw", [0.0, 0.3])
def test_normals_are_in_the_cameras_axes(yaw):
    seen = shown(stage(), here=eye(yaw=yaw))
    label = seen.instances // INSTANCES
    right, down = columns_and_rows()
    floor = (label == ARENA_LABEL) & (down > 6)  # of 1 m height: nearer than the wall
    np.testing.assert_allclose(seen.normals[floor], np.tile([0, 0, 1], (floor.sum(), 1)), atol=1e-6)
    wall = (label == ARENA_LABEL) & (down < -2)
    turned = [-math.cos(yaw), math.sin(yaw), 0.0]
    np.testing.assert_allclose(seen.normals[wall], np.tile(turned, (wall.sum(), 1)), atol=1e-6)
    assert min(floor.sum(), wall.sum(), (label == LOOSE_LABEL).sum()) > 3
    np.testing.assert_allclose(np.linalg.norm(seen.normals, axis=-1), 1.0, atol=1e-6)
    assert right.shape == label.shape


@pytest.mark.oracle
def test_a_step_sideways_moves_what_is_near_by_the_focal_length_over_its_depth():
    """0.1 m to the left: everything goes f 0.1 / depth to the right, and stays in its row."""
    seen = shown(stage(), there=eye(pos=(0.0, 0.1, 1.0)))
    label, (_, down) = seen.instances // INSTANCES, columns_and_rows()
    wall = (label == ARENA_LABEL) & (down < -2)
    np.testing.assert_allclose(
        seen.flow[wall], np.tile([FOCAL * 0.1 / 5.0, 0.0], (wall.sum(), 1)), atol=PIXEL
    )
    box = label == LOOSE_LABEL
    np.testing.assert_allclose(seen.flow[box], np.tile([FOCAL * 0.1 / 2.8, 0.0], (box.sum(), 1)), atol=PIXEL)


@pytest.mark.oracle
def test_a_turn_moves_everything_alike_however_far_away():
    """By 0.1 rad to the left: a pixel at the angle a to the right goes to f tan(a + 0.1)."""
    seen = shown(stage(), there=eye(yaw=0.1))
    right, down = columns_and_rows()
    angle = np.arctan(right / FOCAL)
    expected = FOCAL * np.tan(angle + 0.1) - right
    np.testing.assert_allclose(seen.flow[..., 0], expected, atol=PIXEL)
    stretch = np.cos(angle) / np.cos(angle + 0.1)
    np.testing.assert_allclose(seen.flow[..., 1], down * (stretch - 1), atol=PIXEL)


@pytest.mark.oracle
def test_what_moves_by_itself_flows_and_the_rest_stands():
    seen = shown(stage(), after=stage((3.0, 0.4, 1.2)))
    box = seen.instances // INSTANCES == LOOSE_LABEL
    np.testing.assert_allclose(seen.flow[box], np.tile([0.0, -FOCAL * 0.2 / 2.8], (box.sum(), 1)), atol=PIXEL)
    np.testing.assert_allclose(seen.flow[~box], 0.0, atol=PIXEL)
    zoomed = shown(stage(), there=eye(fov=2 * math.atan(math.tan(FOV / 2) / 2)))
    right, down = columns_and_rows()
    np.testing.assert_allclose(zoomed.flow, np.stack([right, down], -1), atol=PIXEL)


def test_what_is_nothing_or_behind_the_camera_then_has_no_flow():
    seen = shown(stage(), here=eye(pitch=-1.2), there=eye(pitch=-1.2))
    sky = seen.instances == SKY_LABEL
    assert sky.any()
    assert np.isnan(seen.flow[sky]).all()
    assert (seen.normals[sky] == 0).all()
    assert np.isnan(shown(stage(), there=eye(yaw=math.pi)).flow).all()


def box(at, size=(0.2, 0.2, 0.2), **more):
    return Shape(kind="box", at=at, size=size, **{"surface": "wall", **more})


CROWD = ArenaSpec(
    name="crowd",
    shapes=(box((9.0, 0.0, 1.0)),),
    starts=(StartPose(tag="A", at=(0.0, 0.0, 0.188)), StartPose(tag="B", at=(3.2, -0.6, 0.188), yaw=2.0)),
    extent=((-3.0, 10.0), (-5.0, 5.0)),
    loose=tuple(
        LooseObject(name=name, at=(2.5, y, 0.15), shapes=(box((0, 0, 0), mass=1.0, surface="loose"),))
        for name, y in (("left", 1.3), ("right", 0.6))
    ),
    doors=(Door(name="door", at=(5.0, -0.5, 0.0)),),
    victims=(Victim(name="one", at=(3.5, 0.0, 0.2)), Victim(name="two", at=(4.5, -1.7, 0.2))),
    false_alarms=(FalseAlarm(part="Head", at=(2.0, -0.2, 0.4)), FalseAlarm(part="Head", at=(2.0, -0.5, 0.4))),
)


def test_every_victim_object_and_robot_is_an_instance_of_its_own():
    """In a batch: classes are those of the segmentation, and each thing has one number in the picture."""
    batch = Batch(build_scene(CROWD, [replace(P2DX, name="Looker")] * 2), 1, engine="c")
    state = batch.reset()
    seen = jax.tree.map(lambda x: np.asarray(x)[0, 0], Annotator(batch).annotate(state, 0, None, 64, 40))
    found = {(int(one) // INSTANCES, int(one) % INSTANCES) for one in np.unique(seen.instances)}
    assert found >= {(SKY_LABEL, 0), (ARENA_LABEL, 0), (ROBOT_LABEL, 1), (DOOR_LABEL, 0)}
    for label in (LOOSE_LABEL, VICTIM_LABEL, FALSE_ALARM_LABEL):
        assert {which for kind, which in found if kind == label} == {0, 1}, label
    # The first of each is farther left than the second.
    for label in (LOOSE_LABEL, VICTIM_LABEL, FALSE_ALARM_LABEL):
        middles = [np.nonzero(seen.instances == label * INSTANCES + which)[1].mean() for which in (0, 1)]
        assert middles[0] < middles[1], label
    np.testing.assert_allclose(seen.flow[np.isfinite(seen.flow)], 0.0, atol=PIXEL)
    assert batch.scene.model.ngeom > 10
