"""The cameras of every robot class sit where its description says, and see what MuJoCo's rays meet there."""

from functools import cache

import jax
import mujoco
import numpy as np
import pytest

from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.cameras.mounts import cameras_of
from usarmjx.sensors.cameras.paint import ROBOT_LABEL
from usarmjx.sensors.cameras.picture import camera_viewpoint, render_picture_jit
from usarmjx.sensors.rays.targets import GeomBlock, Geoms
from usarmjx.sim.scene import build_scene
from usarmjx.sim.single_world import SingleWorld

NAMES = [name for name in ROBOTS.names() if ROBOTS.get(name).cameras]
WIDTH, HEIGHT = 32, 24
REACH = 1e-3
"""Depths against C MuJoCo [m]: single precision over some ten metres."""
TURNED = 0.2
"""Angle of all joints [rad]: of the packages that cameras sit on, too."""
WALL, FAR, TALL = 0.1, 12.0, 20.0

STUDIO = ArenaSpec(
    name="studio",
    floor=0.0,
    shapes=tuple(
        Shape(kind="box", at=at, size=size, surface="wall", rgba=rgba)
        for at, size, rgba in (
            ((FAR, 0, 0), (WALL, FAR, TALL), (0.8, 0.2, 0.2, 1)),
            ((-FAR, 0, 0), (WALL, FAR, TALL), (0.2, 0.8, 0.2, 1)),
            ((0, FAR, 0), (FAR, WALL, TALL), (0.2, 0.2, 0.8, 1)),
            ((0, -FAR, 0), (FAR, WALL, TALL), (0.8, 0.8, 0.2, 1)),
        )
    ),
    starts=(StartPose(tag="A", at=(0.0, 0.0, 2.0), yaw=0.3),),
    extent=((-FAR, FAR), (-FAR, FAR)),
)


@cache
def posed(name):
    """A robot that hangs in the studio with turned joints: its scene, state, and what there is to see."""
    scene = build_scene(STUDIO, [ROBOTS.get(name)])
    data = mujoco.MjData(scene.model)
    joints = [j for j in range(scene.model.njnt) if scene.model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
    data.qpos[scene.model.jnt_qposadr[joints]] = TURNED
    mujoco.mj_kinematics(scene.model, data)
    single = SingleWorld(build_scene(STUDIO, ()))
    slot = single.add(ROBOTS.get(name), name, [((0.0, 0.0, 2.0), np.array([1.0, 0, 0, 0]))])
    single.engine.data.qpos[:] = data.qpos
    return scene, data, single.render_scene(), single.sensor_input(slot).bodies


@cache
def room():
    """How many geoms of each sort any robot has, so that one compiled function takes all pictures."""
    counts = {}
    for name in NAMES:
        geoms = posed(name)[2].geoms
        for sort, block in zip(sorts(geoms), geoms.blocks, strict=True):
            counts[sort] = max(counts.get(sort, 0), len(block.owner))
    return dict(sorted(counts.items()))


def sorts(geoms):
    return list(zip(geoms.kinds, geoms.materials, geoms.compact, strict=True))


def padded(render_scene):
    """The same with as many geoms of each sort as any robot has; those too many are far away."""
    geoms, appearance = render_scene.geoms, render_scene.appearance
    ends = np.cumsum([len(block.owner) for block in geoms.blocks])
    there = {sort: (block, end) for sort, block, end in zip(sorts(geoms), geoms.blocks, ends, strict=True)}
    some, blocks, looks = geoms.blocks[0], [], []
    for sort, count in room().items():
        block, end = there.get(sort, (jax.tree.map(lambda x: x[:0], some), 0))
        missing = count - len(block.owner)
        first = end - len(block.owner)
        look = jax.tree.map(lambda x, a=first, b=end: x[a:b], appearance)
        far = GeomBlock(pos=1e6, mat=np.eye(3), size=0.0, owner=-1)
        blocks.append(jax.tree.map(lambda x, y, n=missing: filled(x, y, n), block, far))
        looks.append(jax.tree.map(lambda x, n=missing: filled(x, 0, n), look))
    kinds, materials, compact = zip(*room(), strict=True)
    return render_scene.replace(
        geoms=Geoms(blocks=tuple(blocks), kinds=kinds, materials=materials, compact=compact),
        appearance=jax.tree.map(lambda *parts: np.concatenate(parts), *looks),
    )


def filled(rows, value, missing):
    return np.concatenate([rows, np.full((missing, *rows.shape[1:]), value, rows.dtype)])


def picture(name, camera):
    """What a camera sees."""
    _, _, render_scene, bodies = posed(name)
    eye = camera_viewpoint(camera, bodies, 0, camera.default_fov)
    return jax.device_get(render_picture_jit(padded(render_scene), eye, WIDTH, HEIGHT))


def rolled(angles):
    """The matrix of USARSim's roll, pitch and yaw, in its axes: about x, then y, then z."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def ray(name, start, along):
    """How far MuJoCo's ray gets before it meets something other than the robot."""
    scene, data, *_ = posed(name)
    own, gone, geom = set(scene.groups[0].indices[0].body_ids), 0.0, np.zeros(1, np.int32)
    while True:
        hits = mujoco.mj_ray(scene.model, data, start + gone * along, along, None, 1, -1, geom)
        gone += hits
        if hits < 0:
            return np.inf
        if scene.model.geom_bodyid[geom[0]] not in own:
            return gone
        gone += 1e-6


@pytest.mark.every_run("AirRobot", "P2AT", "Talon")
@pytest.mark.oracle
@pytest.mark.parametrize("name", NAMES)
def test_a_camera_sees_what_c_mujoco_meets_from_its_mount(name):
    flip = np.diag([1.0, -1.0, -1.0])  # USARSim's y is to the right and its z down
    scene, data, *_ = posed(name)
    for camera in cameras_of(ROBOTS.get(name)):
        if camera.lens != "pinhole":
            continue  # mirrors: tests/sensors/cameras/test_lenses.py
        seen = picture(name, camera)
        part = scene.groups[0].plan.parts.index(camera.mount.parent)
        body = scene.groups[0].indices[0].body_ids[part]
        turn = data.xmat[body].reshape(3, 3)
        axes = turn @ flip @ rolled(np.array(camera.mount.direction)) @ flip
        wide = WIDTH // len(camera.eye_offsets)
        start = data.xpos[body] + turn @ flip @ np.array(camera.mount.at) + axes @ camera.eye_offsets[0]
        free = seen.segmentation[:, :wide] < ROBOT_LABEL
        assert free.mean() > 0.3, f"{camera.mount.name} looks at its own robot"
        for row in range(1, HEIGHT, 5):
            for column in range(1, wide, 5):
                if not free[row, column]:
                    continue
                left = np.tan(camera.default_fov / 2) * (1 - 2 * (column + 0.5) / wide)
                up = np.tan(camera.default_fov / 2) * (HEIGHT - 2 * (row + 0.5)) / wide
                along = axes @ np.array([1.0, left, up])
                length = np.linalg.norm(along)
                expected = ray(name, start, along / length) / length
                assert seen.depth[row, column] == pytest.approx(expected, abs=REACH), camera.mount.name
