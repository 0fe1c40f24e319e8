"""Pictures of robots' cameras in worlds: every pixel against C MuJoCo, and what the batch does with them."""

import math
from dataclasses import replace
from functools import cache

import jax
import mujoco
import numpy as np
import pytest

from tests.dressed import dressed
from usarmjx.base.errors import SpecError, UnknownNameError, UsageError
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.victims import orientations, segment_poses, victim_table
from usarmjx.models.compile.visuals import VISUAL_SLOTS, drawn_bones, used_slots
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.kit import camera
from usarmjx.models.robots.pioneer import OMNI_P2DX, P2DX
from usarmjx.models.types.arena import ArenaSpec, Door, FalseAlarm, Light, LooseObject, StartPose, Victim
from usarmjx.models.types.robot import Mount, RobotSpec, options
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.cameras.lenses import MIRROR_DISTANCE
from usarmjx.sensors.cameras.mounts import camera_index, cameras_of, headlight_of
from usarmjx.sensors.cameras.paint import (
    ARENA_LABEL,
    DOOR_LABEL,
    FALSE_ALARM_LABEL,
    LOOSE_LABEL,
    OUTSIDE_LABEL,
    ROBOT_LABEL,
    SKY_LABEL,
    VICTIM_LABEL,
    camera_owners,
    robot_geom_owner,
)
from usarmjx.sensors.cameras.picture import Picture, pinhole_viewpoint, render_picture_jit
from usarmjx.sensors.cameras.shading import INDOOR_GAIN
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

WIDTH, HEIGHT = 48, 32
NEAR = 1e-4  # m, up to 10 m, and 1e-5 beyond: what the raycaster may differ from mj_ray by
EDGE = 0.01  # share of pixels on an edge, where a ray of single precision may meet the other side


def box(at: tuple, size: tuple, **more) -> Shape:
    return Shape(kind="box", at=at, size=size, **{"surface": "wall", **more})


ARENA_SPEC = ArenaSpec(
    name="set",
    floor=-1.0,
    shapes=(
        box((3.0, 0.0, 0.5), (0.1, 1.5, 0.5), rgba=(0.8, 0.2, 0.1, 1)),
        Shape(kind="cylinder", size=(0.2, 0.4), at=(1.2, 1.2, 0.4), surface="fixture"),
        Shape(kind="ellipsoid", size=(0.2, 0.3, 0.25), at=(2.0, 0.9, 0.4), surface="fixture"),
        Shape(kind="sphere", size=(0.15,), at=(1.6, -0.6, 0.6), surface="fixture"),
    ),
    starts=(StartPose(tag="A", at=(0.0, 0.0, 0.188)), StartPose(tag="B", at=(0.4, 1.6, 0.188), yaw=-0.6)),
    extent=((-3.0, 4.0), (-3.0, 3.0)),
    loose=(
        LooseObject(
            name="crate",
            at=(1.3, -0.4, 0.15),
            shapes=(box((0, 0, 0), (0.15, 0.15, 0.15), mass=1.0, surface="loose"),),
        ),
    ),
    doors=(Door(name="door", at=(2.4, -0.5, 0.0), yaw=-1.8),),
    victims=(Victim(name="one", at=(2.2, 0.0, 0.2)),),
    false_alarms=(FalseAlarm(part="Head", at=(1.5, 0.6, 0.2)),),
)
ROBOT_SPEC = replace(
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


@pytest.fixture(scope="module")
def batch() -> Batch:
    return Batch(build_scene(ARENA_SPEC, [ROBOT_SPEC] * 2), 2, engine="c")


@pytest.fixture(scope="module")
def moved(batch: Batch):
    """After driving differently in each world, heads turning; on their way down to the floor.

    Once they bounce on it, rounding decides what they see.
    """
    state = batch.reset()
    state = batch.drive(state, 0, {"Left": np.array([[1.0, 0.5], [-0.5, 1.0]]), "Right": 0.7})
    turn = {"CameraPanTilt_Link1": np.array([[0.3, -0.2], [-0.1, 0.2]]), "CameraPanTilt_Link2": 0.1}
    state = batch.move(state, 0, turn)
    for _ in range(18):
        state = batch.step(state)
    return state


def picture_of(batch: Batch, state, eye: int, world: int, robot: int) -> Picture:
    picture = batch.render(state, 0, eye, WIDTH, HEIGHT)
    return jax.tree.map(lambda x: np.asarray(x)[world, robot], picture)


@cache
def drawn_model() -> mujoco.MjModel:
    """The world whose solids are what is drawn of robots and victims."""
    bare = replace(ARENA_SPEC, victims=(), false_alarms=())
    spec = build_scene(bare, [dressed(ROBOT_SPEC)] * 2).spec
    table = victim_table(ARENA_SPEC.victims, ARENA_SPEC.false_alarms)
    (pos, quat), bones = segment_poses(table, 0.0), drawn_bones(table)
    for box, slot in zip(*np.nonzero(used_slots(table.part)), strict=True):
        offset, turn = bones.offset[box, slot], orientations(quat[box])
        spec.worldbody.add_geom(
            name=f"victim/{box}/{slot}",
            type=VISUAL_SLOTS[slot],
            size=bones.size[box, slot],
            pos=pos[box] + turn @ offset + (0.0, 0.0, ARENA_SPEC.floor),
            quat=quat[box],
        )
    return spec.compile()


def posed(batch: Batch, state, world: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The world as it is drawn, on C MuJoCo."""
    model = drawn_model() if batch.scene.arena is ARENA_SPEC else batch.scene.model
    data = mujoco.MjData(model)
    data.qpos[:] = np.asarray(batch.physics(state).qpos)[world]
    mujoco.mj_kinematics(model, data)
    return model, data


def expected_label(name: str) -> int:
    if name.startswith("victim/"):
        return VICTIM_LABEL if int(name.split("/")[1]) < 11 else FALSE_ALARM_LABEL
    starts = {"floor": ARENA_LABEL, "arena/": ARENA_LABEL, "loose/": LOOSE_LABEL, "door/": DOOR_LABEL}
    starts |= {"r0/": ROBOT_LABEL, "r1/": ROBOT_LABEL + 1}
    return next(label for start, label in starts.items() if name.startswith(start))


def eye_of(model, data, mount: Mount, slot: int) -> tuple[np.ndarray, np.ndarray]:
    """Place and axes (x forward, y left, z up) of a camera that is not turned on its part."""
    name = f"r{slot}/" + ("chassis" if mount.parent == "HARD" else mount.parent)
    names = [model.body(i).name for i in range(model.nbody)]
    body = names.index(name) if name in names else names.index(f"r{slot}/{mount.parent}")
    mat = data.xmat[body].reshape(3, 3)
    return data.xpos[body] + mat @ (np.array(mount.at) * (1, -1, -1)), mat


def traced(model, data, hidden: list[int], eye: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """What C MuJoCo's rays meet: distances, and names of geoms, "" for none."""
    kept = model.geom_rgba.copy()
    model.geom_rgba[hidden, 3] = 0.0  # its rays pass what is invisible
    found, hit = [], np.zeros(1, np.int32)
    for ray in rays:
        distance = mujoco.mj_ray(model, data, eye, ray, None, 1, -1, hit)
        found.append((distance, model.geom(int(hit[0])).name if hit[0] >= 0 else ""))
    model.geom_rgba[:] = kept
    return np.array([d for d, _ in found]), [name for _, name in found]


def hidden_geoms(batch: Batch, slot: int, eye: int) -> list[int]:
    model, index = drawn_model(), batch.scene.groups[0].indices[slot]
    own = [g for g in range(model.ngeom) if model.geom_bodyid[g] in index.body_ids]
    return [g for g, hides in zip(own, cameras_of(ROBOT_SPEC)[eye].hidden_geoms, strict=True) if hides]


@pytest.mark.oracle
@pytest.mark.parametrize(("world", "robot"), [(0, 0), (1, 0), (1, 1)])
def test_depth_and_segmentation_of_every_pixel_are_mj_rays(batch, moved, world, robot):
    picture = picture_of(batch, moved, 0, world, robot)
    model, data = posed(batch, moved, world)
    eye, mat = eye_of(model, data, ROBOT_SPEC.cameras[0], robot)
    focal = WIDTH / 2 / math.tan(0.8727 / 2)
    column, row = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    x, y = column + 0.5 - WIDTH / 2, HEIGHT / 2 - row - 0.5
    local = np.stack([np.full(x.shape, focal), -x, y], -1).reshape(-1, 3)
    local /= np.linalg.norm(local, axis=-1, keepdims=True)
    distance, names = traced(model, data, hidden_geoms(batch, robot, 0), eye, local @ mat.T)
    depth = np.where(distance >= 0, distance * local[:, 0], np.inf)
    label = np.array([expected_label(name) if name else SKY_LABEL for name in names])
    same = picture.segmentation.ravel() == label
    assert same.mean() > 1 - EDGE
    hit = same & np.isfinite(depth)
    error = np.abs(picture.depth.ravel()[hit] - depth[hit])
    # Rays that graze the floor: an attitude rounded by 6e-8, over eyes some 0.3 m above it.
    assert (error <= np.maximum(NEAR, 6e-8 / 0.3 * depth[hit] ** 2)).all()
    assert np.isinf(picture.depth[picture.segmentation == SKY_LABEL]).all()
    assert len(set(label.tolist())) > 2


@pytest.mark.thorough
def test_the_pictures_of_the_test_show_everything_there_is(batch, moved):
    """Else labels of doors and victims would not have been compared."""
    seen = np.unique(np.asarray(batch.render(moved, 0, 0, WIDTH, HEIGHT).segmentation))
    seen = {*seen, *np.unique(np.asarray(batch.render(moved, 0, "mirror", WIDTH, HEIGHT).segmentation))}
    wanted = {
        SKY_LABEL,
        ARENA_LABEL,
        LOOSE_LABEL,
        DOOR_LABEL,
        VICTIM_LABEL,
        FALSE_ALARM_LABEL,
        ROBOT_LABEL,
        ROBOT_LABEL + 1,
        OUTSIDE_LABEL,
    }
    assert wanted <= seen


@pytest.mark.thorough
@pytest.mark.oracle
def test_an_omnidirectional_picture_is_what_mj_ray_meets_from_the_mirrors_focus(batch, moved):
    picture = picture_of(batch, moved, 2, 0, 0)
    model, data = posed(batch, moved, 0)
    eye, mat = eye_of(model, data, ROBOT_SPEC.cameras[2], 0)
    eye = eye + MIRROR_DISTANCE * mat[:, 0]
    column, row = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    x, y = (column + 0.5 - WIDTH / 2).ravel(), (HEIGHT / 2 - row - 0.5).ravel()
    radius = np.hypot(x, y)
    angle = 2 * np.arctan(radius / (HEIGHT / 2) * math.tan(math.radians(105) / 2))
    local = np.stack([-np.cos(angle), -np.sin(angle) * x / radius, np.sin(angle) * y / radius], -1)
    distance, names = traced(model, data, hidden_geoms(batch, 0, 2), eye, local @ mat.T)
    label = np.array([expected_label(name) if name else SKY_LABEL for name in names])
    inside = radius < HEIGHT / 2
    assert (picture.segmentation.ravel() == OUTSIDE_LABEL).tolist() == (~inside).tolist()
    same = (picture.segmentation.ravel() == label) & inside
    assert same.sum() > (1 - EDGE) * inside.sum()
    hit = same & (distance >= 0) & (distance < 10)
    assert (np.abs(picture.depth.ravel() - distance)[hit] < NEAR).mean() > 1 - EDGE
    assert not picture.rgb.reshape(-1, 3)[~inside].any()


WALL_AHEAD = replace(
    ARENA_SPEC,
    shapes=(box((3.0, 1.0, 1.0), (0.1, 1.0, 1.0)),),
    victims=(),
    false_alarms=(),
    loose=(),
    doors=(),
)
EYES, WIDE = 0.1, 400
"""Distance of two eyes [m]; width of what each sees."""


def check_disparity(batch: Batch, state, mount: Mount, fov: float, left: Picture, right: Picture) -> None:
    """Two eyes see the edge of a wall f B / z pixels apart."""
    edges = [int(np.flatnonzero(np.asarray(eye.segmentation)[0] != SKY_LABEL)[-1]) for eye in (left, right)]
    place, _ = eye_of(*posed(batch, state, 0), mount, 0)
    depth, focal = 2.9 - place[0], WIDE / 2 / math.tan(fov / 2)
    assert edges[0] - edges[1] == pytest.approx(focal * EYES / depth, abs=1.01)  # whole pixels
    assert edges[0] - edges[1] > 10
    assert left.depth[0, edges[0] - 5] == pytest.approx(depth, abs=5e-3)  # it settles on its wheels


@pytest.mark.thorough
@pytest.mark.oracle
def test_stereo_eyes_see_things_apart_by_focal_length_times_distance_of_eyes_over_depth():
    """Manual 3.2.6.2: B = 2 StereoSpacing; the left eye's picture is in the left half."""
    one = Batch(build_scene(WALL_AHEAD, [ROBOT_SPEC]), 1, engine="c")
    state = one.reset()
    pair = one.render_robot(state, 0, 0, "Stereo", 2 * WIDE, 2)
    halves = (jax.tree.map(lambda x, i=i: np.split(np.asarray(x), 2, 1)[i], pair) for i in range(2))
    check_disparity(one, state, ROBOT_SPEC.cameras[1], 1.0, *halves)
    with pytest.raises(UsageError, match="even"):
        one.render_robot(state, 0, 0, "Stereo", 33, 16)


@pytest.mark.thorough
@pytest.mark.oracle
def test_the_two_cameras_of_a_stereo_p2at_do_so_too():
    """Manual 12.2.1."""
    one = Batch(build_scene(WALL_AHEAD, ["StereoP2AT"]), 1, engine="c")
    state, mounts = one.reset(), ROBOTS.get("StereoP2AT").cameras
    before = render_picture_jit._cache_size()
    left, right = (one.render_robot(state, 0, 0, mount.name, WIDE, 2) for mount in mounts)
    assert render_picture_jit._cache_size() <= before + 1, "one compilation for both"
    check_disparity(one, state, mounts[0], cameras_of(ROBOTS.get("StereoP2AT"))[0].default_fov, left, right)


@pytest.mark.thorough
def test_a_robots_picture_is_the_same_alone_and_in_a_batch(batch, moved):
    many = jax.tree.map(np.asarray, batch.render(moved, 0, None, WIDTH, HEIGHT))
    for world, robot in ((0, 0), (1, 1)):
        alone = jax.tree.map(np.asarray, batch.render_robot(moved, world, robot, "camera", WIDTH, HEIGHT))
        for one, among in zip(jax.tree.leaves(alone), jax.tree.leaves(many), strict=True):
            assert one.dtype == among.dtype
            # Another program may round an edge or half a colour step the other way.
            close = np.isclose(one.astype(float), among[world, robot].astype(float), rtol=1e-5, atol=1.0)
            assert close.mean() > 1 - EDGE
    assert many.rgb.shape == (2, 2, HEIGHT, WIDTH, 3)
    assert many.rgb.dtype == np.uint8
    assert many.depth.dtype == np.float32
    assert many.segmentation.dtype == np.int32
    assert np.abs(many.rgb[0, 0].astype(int) - many.rgb[1, 0]).max() > 30, "the worlds differ"


@pytest.mark.oracle
def test_zoom_is_held_within_limits_and_0_is_the_default(batch, moved):
    """Manual 9.4; and what is twice as near to the axis as before has twice the focal length."""
    told = np.array([[5.0, 0.1], [0.0, 0.6]])
    state = batch.zoom(moved, 0, "CAMERA", told)
    expected = [[2.0944, 0.3491], [0.8727, 0.6]]
    np.testing.assert_allclose(state.worlds.groups[0].fov[..., 0], expected, rtol=1e-6)
    np.testing.assert_allclose(state.worlds.groups[0].fov[..., 1], 1.0)
    some = batch.zoom(state, 0, 0, 1.0, np.array([[True, False], [False, False]]))
    np.testing.assert_allclose(some.worlds.groups[0].fov[..., 0], [[1.0, 0.3491], [0.8727, 0.6]], rtol=1e-6)
    wide, narrow = (
        picture_of(batch, batch.zoom(moved, 0, 0, fov), 0, 1, 0)
        for fov in (1.2, 2 * math.atan(math.tan(0.6) / 2))
    )
    # The middle of every other pixel of the wide picture lies between pixels of the narrow one.
    middle = wide.depth[HEIGHT // 4 : -HEIGHT // 4, WIDTH // 4 : -WIDTH // 4]
    zoomed = narrow.depth.reshape(HEIGHT // 2, 2, WIDTH // 2, 2)
    low, high = zoomed.min((1, 3)), zoomed.max((1, 3))
    within = (middle >= low - 1e-4) & (middle <= high + 1e-4)
    assert within[np.isfinite(high)].mean() > 0.95


def test_a_camera_with_one_field_of_view_cannot_zoom():
    """Manual 10.14.2: with equal limits it is a camera of a fixed field of view."""
    fixed = options(CameraDefFov=0.9, CameraMinFov=0.9, CameraMaxFov=0.9)
    (one,) = cameras_of(replace(ROBOT_SPEC, cameras=(replace(ROBOT_SPEC.cameras[0], options=fixed),)))
    np.testing.assert_allclose(one.clamp(np.array([0.0, 0.3, 2.0, np.inf, np.nan])), 0.9)


def test_a_reset_takes_the_zoom_back(batch):
    state = batch.zoom(batch.reset(), 0, None, 0.5)
    fresh = batch.reset_where(state, np.array([True, False]))
    np.testing.assert_allclose(fresh.worlds.groups[0].fov[..., 0], [[0.8727] * 2, [0.5] * 2], rtol=1e-6)


def test_the_headlight_of_a_robot_lights_what_is_before_it_until_its_battery_is_empty(batch, moved):
    dark = picture_of(batch, moved, 0, 0, 0)
    lit_state, _ = batch.operate(
        moved, 0, "Lamp", "Activate", where=np.array([[True, False], [False, False]])
    )
    lit = picture_of(batch, lit_state, 0, 0, 0)
    gain = lit.rgb.astype(int).sum(-1) - dark.rgb.astype(int).sum(-1)
    assert (gain >= 0).all()
    assert (gain > 20).mean() > 0.2
    assert not gain[lit.segmentation == SKY_LABEL].any()
    other = picture_of(batch, lit_state, 0, 1, 0)
    np.testing.assert_array_equal(other.rgb, picture_of(batch, moved, 0, 1, 0).rgb)
    members = lit_state.worlds.groups[0]
    empty = batch.with_group(lit_state, 0, members.replace(battery_start=members.battery_start - 5_000_000))
    np.testing.assert_array_equal(picture_of(batch, empty, 0, 0, 0).rgb, dark.rgb)
    assert headlight_of(ROBOT_SPEC).pos.tolist() == pytest.approx([0.3, 0.0, 0.1])
    assert headlight_of(P2DX).pos.tolist() == pytest.approx([P2DX.dimensions[0] / 2, 0.0, 0.0])


@pytest.mark.every_run("warp")
@pytest.mark.parametrize("engine", ["jax", "warp"])
def test_pictures_do_not_depend_on_the_engine(engine, batch):
    """At the start, where all engines have the same poses."""
    other = Batch(batch.scene, 2, engine=engine)
    here, there = (
        jax.tree.map(np.asarray, b.render(b.reset(), 0, None, WIDTH, HEIGHT)) for b in (batch, other)
    )
    for one, two in zip(jax.tree.leaves(here), jax.tree.leaves(there), strict=True):
        np.testing.assert_array_equal(one, two)


def test_worlds_with_arenas_of_their_own_have_their_own_colours_and_light():
    red, blue = (0.8, 0.0, 0.0, 1.0), (0.0, 0.0, 0.8, 1.0)
    bare = {"floor": 0.0, "extent": ARENA_SPEC.extent, "starts": ARENA_SPEC.starts[:1]}
    arenas = [
        ArenaSpec(name="day", shapes=(box((1.5, 0, 0.5), (0.1, 3, 0.5), rgba=red),), **bare),
        ArenaSpec(
            name="night",
            shapes=(box((1.5, 0, 0.5), (0.1, 3, 0.5), rgba=blue),),
            lights=(Light(at=(0.0, 0.0, 2.0), brightness=0.1),),
            victims=(Victim(name="one", at=(1.0, 0.0, 0.2)),),
            **bare,
        ),
    ]
    many = Batch(build_scene(arenas, [ROBOT_SPEC]), 2, engine="c")
    pictures = jax.tree.map(np.asarray, many.render(many.reset(), 0, None, WIDTH, HEIGHT))
    colour = []
    for world in (0, 1):
        wall = (pictures.segmentation[world, 0] == ARENA_LABEL) & (pictures.depth[world, 0] < 1.6)
        colour.append(
            pictures.rgb[world, 0][wall & (np.ptp(pictures.rgb[world, 0].astype(int), axis=-1) > 20)]
        )
    assert len(colour[0]) > 50
    assert len(colour[1]) > 50
    assert not colour[0][:, 1:].any()
    assert not colour[1][:, :2].any()
    # Cameras brighten what is dark indoors (`light.tone_mapped`): the light itself is compared.
    night = colour[1].max() / 255
    light = night / (INDOOR_GAIN - (INDOOR_GAIN - 1) * night)
    assert 255 * light < colour[0][:, 0].min(), "night"
    assert (pictures.segmentation[1] == VICTIM_LABEL).any()
    assert not (pictures.segmentation[0] == VICTIM_LABEL).any()


def test_cameras_are_found_by_name_and_bad_ones_are_refused_by_name():
    assert camera_index(ROBOT_SPEC) == 0
    assert camera_index(ROBOT_SPEC, "MIRROR") == 2
    assert camera_index(ROBOT_SPEC, 1) == 1
    for bad in ("Periscope", 3, -1):
        with pytest.raises(UnknownNameError, match="it has: Camera, Stereo, Mirror"):
            camera_index(ROBOT_SPEC, bad)
    with pytest.raises(UnknownNameError, match="none"):
        camera_index(replace(ROBOT_SPEC, cameras=()))
    main = ROBOT_SPEC.cameras[0]
    for wrong, words in (
        (options(CameraDefFov=3.0), "CameraDefFov"),
        (options(CameraMinFov=-0.1), "0 < CameraMinFov"),
        (options(IsStereo=True, StereoSpacing=(("Y", 0.0),)), "StereoSpacing"),
    ):
        with pytest.raises(SpecError, match=words):
            cameras_of(replace(ROBOT_SPEC, cameras=(replace(main, options=wrong),)))


def test_pictures_of_impossible_sizes_are_refused(batch):
    for size in ((0, 10), (10, 5000)):
        with pytest.raises(UsageError, match="pixels"):
            batch.render(batch.reset(), 0, None, *size)


@pytest.mark.parametrize("name", [n for n in ROBOTS.names() if ROBOTS.get(n).cameras])
def test_no_camera_looks_into_its_own_robot(name):
    """Straight ahead there is nothing of the robot within 4 cm of the lens; mirrors are on their packages."""
    robot: RobotSpec = ROBOTS.get(name)
    drawn = kinematic_tree_of(robot).visuals.solids
    for one in cameras_of(robot):
        assert one.hidden_geoms.shape == drawn.kind.shape
        assert one.hidden_geoms[drawn.frame == one.body].all()
        assert not one.hidden_geoms.all() or len(set(drawn.frame)) == 1
        assert one.lens == ("omni" if one.mount.parent.startswith("OmniCam") else "pinhole")
        assert one.min_fov <= one.default_fov <= one.max_fov
    if robot is OMNI_P2DX:
        np.testing.assert_allclose(cameras_of(robot)[0].mat @ (1, 0, 0), (0, 0, 1), atol=1e-6)  # upwards


def test_a_viewpoint_of_no_robot_hides_nothing():
    """The arena's geoms have the owner -1, those of robots their slots."""
    owners = np.array([-1, robot_geom_owner(0, 0), robot_geom_owner(3, 7)])
    alone = pinhole_viewpoint(np.zeros(3, np.float32), np.eye(3, dtype=np.float32), 1.0)
    assert alone.slot not in camera_owners(owners, alone.slot, alone.hidden_geoms)
    seen = camera_owners(owners, 3, np.arange(9) == 7)
    assert seen.tolist() == [-1, -1, 3]
