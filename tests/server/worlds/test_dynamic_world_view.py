"""A served world on C MuJoCo sees what the same world of a batch sees."""

from dataclasses import replace

import jax
import mujoco
import numpy as np

from usarmjx.base.transforms import mat_from_angles
from usarmjx.cameras.mounts import cameras_of
from usarmjx.cameras.paint import SKY_LABEL
from usarmjx.cameras.picture import camera_viewpoint, render_picture_jit
from usarmjx.models.build.body_plan import BodyPoses
from usarmjx.models.build.materials import materials_of
from usarmjx.models.build.pieces import ray_primitives_of
from usarmjx.models.robots.pioneer import P2DX
from usarmjx.models.spec.arena import ArenaSpec, FalseAlarm, Light, LooseObject, StartPose, Victim, Water
from usarmjx.models.spec.shapes import Mesh, Shape
from usarmjx.sensors.rays.targets import indices_by_key
from usarmjx.server.worlds.dynamic_world_view import dynamic_render_scene
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

CORNERS = np.array([(0, 0, 0), (0.4, 0, 0), (0, 0.4, 0), (0, 0, 0.6)], float)


def box(at: tuple, size: tuple, **more) -> Shape:
    return Shape(kind="box", at=at, size=size, **{"surface": "wall", **more})


POND = ArenaSpec(
    name="pond",
    floor=-0.5,
    shapes=(
        box((2.5, 0.8, 0.5), (0.05, 0.6, 0.5), material="glass", rgba=(0.2, 0.8, 0.4, 1)),
        box((3.0, -0.8, 0.5), (0.05, 0.6, 0.5), material="mirror"),
        Shape(kind="mesh", mesh=Mesh(CORNERS), at=(1.5, 0.5, 0.0), surface="wall", rgba=(0.2, 0.2, 0.9, 1)),
    ),
    starts=(StartPose(tag="A", at=(0.0, 0.0, 0.188)), StartPose(tag="B", at=(1.5, -0.6, 0.188), yaw=2.0)),
    extent=((-3.0, 4.0), (-3.0, 3.0)),
    loose=(
        LooseObject(
            name="crate",
            at=(2.0, 0.3, 0.15),
            shapes=(box((0, 0, 0), (0.15, 0.15, 0.15), mass=1.0, surface="loose"),),
        ),
    ),
    waters=(Water(low=(1.0, -0.3, 0.0), high=(1.4, 0.3, 0.25)),),
    victims=(Victim(name="one", at=(3.5, 0.5, 0.2)),),
    false_alarms=(FalseAlarm(part="Head", at=(1.9, -0.2, 0.2)),),
    lights=(Light(at=(0.5, 0.5, 2.0), brightness=3.0, rgb=(1.0, 0.9, 0.8)),),
)


def test_a_served_world_sees_what_a_batch_sees():
    scene = build_scene(POND, [P2DX] * 2)
    batch = Batch(scene, 1, engine="c")
    state = batch.reset()
    members = state.worlds.groups[0]
    lit = members.replace(command=members.command.replace(light=np.array([[False, True]])))
    state = batch.with_group(state, 0, lit)
    wanted = jax.tree.map(np.asarray, batch.render_robot(state, 0, 0, None, 56, 40))

    model, data = scene.model, mujoco.MjData(scene.model)
    physics = jax.tree.map(lambda x: np.asarray(x)[0], batch.physics(state))
    data.qpos[:] = physics.qpos
    mujoco.mj_kinematics(model, data)
    pieces = ray_primitives_of(model, np.arange(model.ngeom), materials_of(model, POND))
    places = indices_by_key(pieces.kind, pieces.material.tolist())
    room = {sort: len(members) + 5 for sort, members in places.items()}
    index = dict(enumerate(scene.groups[0].indices))
    stage = dynamic_render_scene(POND, data, pieces, places, room, index, {1: P2DX})
    body = list(index[0].body_ids)
    bodies = BodyPoses(pos=data.xpos[body], mat=data.xmat[body].reshape(-1, 3, 3))
    eye = camera_viewpoint(cameras_of(P2DX)[0], bodies, 0, 0.8727)
    seen = jax.device_get(render_picture_jit(stage, eye, 56, 40))

    # Another program rounds differently: at edges a ray may meet the other side.
    assert (seen.segmentation == wanted.segmentation).mean() > 0.99
    assert np.isclose(seen.depth, wanted.depth, atol=1e-4).mean() > 0.99
    assert (np.abs(seen.rgb.astype(int) - wanted.rgb) <= 1).mean() > 0.99
    assert len(np.unique(seen.segmentation)) >= 5
    before = render_picture_jit._cache_size()
    other = eye.replace(pos=eye.pos + 0.1, mat=mat_from_angles(*map(np.array, (0.1, 0.2, 0.3))))
    render_picture_jit(
        stage,
        other.replace(fov=1.2, default_fov=np.float32(1.0), slot=1, hidden_geoms=~eye.hidden_geoms),
        56,
        40,
    )
    assert render_picture_jit._cache_size() == before, "another camera costs no compilation"
    dark = dynamic_render_scene(POND, data, pieces, places, room, index, {})
    unlit = jax.device_get(render_picture_jit(dark, eye, 56, 40))
    assert (seen.rgb != unlit.rgb).any()
    dry = dynamic_render_scene(replace(POND, waters=()), data, pieces, places, room, index, {})
    without = jax.device_get(render_picture_jit(dry, eye, 56, 40))
    assert (without.rgb != unlit.rgb).any(-1)[seen.segmentation != SKY_LABEL].any(), "water tints"
