"""Cylinder against box on MJX-JAX: every number is held against C MuJoCo.

The pose oracle is C with multiccd off. With it on (the default) C 3.17.0 gives a contact between a
cylinder's side and a box edge the normal of one of the two faces beside the edge, whatever the
true direction (`test_default_c_turns_edge_normals`); face contacts are the same either way.
"""

from importlib import metadata
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx
from mujoco.mjx._src import collision_driver

from usarmjx.base.errors import EngineError
from usarmjx.engines import cylinder_box as module

RADIUS, TRACK, WHEELBASE = 0.13, 0.47, 0.29  # m
HALF_WIDTH = 0.025  # m
KP, KV, TORQUE, TOP_SPEED = 100.0, 5.0, 4.0, 8.0  # N m/rad, N m s/rad, N m, rad/s
BAND = (TORQUE + KV * TOP_SPEED) / KP  # rad, how far the servo's target may lead the wheel
SUBSTEPS = 4
MULTICCD_OFF = int(mujoco.mjtDisableBit.mjDSBL_MULTICCD)

DEPTH_ATOL = 5e-5  # m: the rim search ends at 3e-4 rad (35 um at r 0.13), float32 adds some um
ANGLE_TOL = 1.0  # degrees: depth is flat around its minimum, C's own solver stops within 0.5
POSES = 400


class Geom(NamedTuple):
    pos: jax.Array
    mat: jax.Array
    size: jax.Array


class Poses(NamedTuple):
    """Cylinders against boxes: pos (n, 3), mat (n, 3, 3), size (n, 3) of each, C's deepest contact.

    C's distance is (n,), 1 without contact, its normal (n, 3) from cylinder to box.
    """

    cylinder: Geom
    box: Geom
    depth: np.ndarray
    normal: np.ndarray


collide = jax.jit(jax.vmap(module.cylinder_box))

C_PAIR = """<mujoco><option ccd_iterations="200" ccd_tolerance="1e-9"/><worldbody>
<body><freejoint/><geom name="cylinder" type="cylinder" size=".13 .025"/></body>
<body><freejoint/><geom name="box" type="box" size="1 1 1" margin="{margin}"/></body>
</worldbody></mujoco>"""


class CPair:
    """One cylinder and one box in C MuJoCo, placed at will."""

    def __init__(self, flags: int, margin: float = 0.0) -> None:
        self.model = mujoco.MjModel.from_xml_string(C_PAIR.format(margin=margin))
        self.model.opt.disableflags |= flags
        self.data = mujoco.MjData(self.model)

    def contacts(self, poses: list[np.ndarray], sizes: list[np.ndarray]) -> list[tuple]:
        """(distance, position, normal from cylinder to box) per contact, deepest first."""
        m, d = self.model, self.data
        for geom, (pose, size) in enumerate(zip(poses, sizes, strict=True)):
            d.qpos[7 * geom : 7 * geom + 7] = pose
            m.geom_size[geom] = size
            reach = size if geom else np.array([size[0], size[0], size[1]])
            m.geom_rbound[geom] = np.linalg.norm(reach)
            m.geom_aabb[geom] = [0, 0, 0, *reach]
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_collision(m, d)
        sign = [1 if c.geom1 == 0 else -1 for c in d.contact[: d.ncon]]
        found = [
            (c.dist, c.pos.copy(), s * c.frame[:3]) for c, s in zip(d.contact[: d.ncon], sign, strict=True)
        ]
        return sorted(found, key=lambda contact: contact[0])


def quat(axis: np.ndarray, angle: float) -> np.ndarray:
    out = np.zeros(4)
    mujoco.mju_axisAngle2Quat(out, axis / np.linalg.norm(axis), angle)
    return out


def multiply(*quats: np.ndarray) -> np.ndarray:
    out = np.array([1.0, 0, 0, 0])
    for factor in quats:
        mujoco.mju_mulQuat(out, out.copy(), factor)
    return out


def matrix(q: np.ndarray) -> np.ndarray:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, q)
    return out.reshape(3, 3)


LYING = quat(np.array([1.0, 0, 0]), np.pi / 2)
UPRIGHT = np.array([1.0, 0, 0, 0])


def separation(n: np.ndarray, center: np.ndarray, axis: np.ndarray, sizes: list) -> np.ndarray:
    """Gap along unit directions n (..., 3) by the definition of the support functions, float64."""
    (radius, half, _), box = sizes
    cosine = n @ axis
    sine = np.sqrt(np.maximum(1 - cosine**2, 0))
    return np.abs(n @ center) - half * np.abs(cosine) - radius * sine - np.abs(n) @ box


def random_pose(rng: np.random.Generator, directions: np.ndarray) -> tuple[list, list]:
    """A cylinder within -4 to 2 mm of a box: faces, edges, corners; lying, flat, any attitude."""
    boxes = [[0.5, 0.5, 0.05], [0.2, 0.18, 0.05], [2.0, 2.0, 0.1], rng.uniform(0.03, 0.4, 3)]
    box = np.array(boxes[rng.integers(4)])
    sizes = [np.array([RADIUS, rng.choice([0.0128, HALF_WIDTH]), 0.0]), box]
    attitude = rng.normal(size=4)
    if rng.random() < 0.7:
        tilt = 10 ** rng.uniform(-5, -0.5)
        attitude = multiply(
            quat(rng.normal(size=3), tilt),
            quat(np.eye(3)[rng.integers(3)], rng.uniform(0, 6.3) * rng.integers(2)),
            (LYING, UPRIGHT)[rng.integers(2)],
        )
    attitude = attitude / np.linalg.norm(attitude)
    axis = matrix(attitude)[:, 2]
    spot = rng.uniform(-1, 1, 3) * box
    side = rng.integers(3)
    for k in (side, (side + 1) % 3)[: 1 + (rng.random() < 0.4)]:
        spot[k] = np.copysign(box[k], spot[k])
    away = np.eye(3)[side] * np.sign(spot[side]) + 0.6 * rng.normal(size=3) * rng.integers(2)
    away /= np.linalg.norm(away)
    low, high, target = -0.3, 0.6, rng.uniform(-0.004, 0.002)
    for _ in range(30):
        middle = (low + high) / 2
        gap = separation(np.vstack([directions, axis]), spot + middle * away, axis, sizes).max()
        low, high = (middle, high) if gap < target else (low, middle)
    turn, shift = rng.normal(size=4), rng.uniform(-3, 3, 3)
    turn = UPRIGHT if rng.random() < 0.3 else turn / np.linalg.norm(turn)
    center = shift + matrix(turn) @ (spot + high * away)
    pose = np.concatenate([center, multiply(turn, attitude)])
    return [pose, np.concatenate([shift, turn])], sizes


def as_geoms(poses: list[list[np.ndarray]], sizes: list[list[np.ndarray]]) -> list[Geom]:
    return [
        Geom(
            jnp.array([p[k][:3] for p in poses], jnp.float32),
            jnp.array([matrix(p[k][3:]) for p in poses], jnp.float32),
            jnp.array([s[k] for s in sizes], jnp.float32),
        )
        for k in range(2)
    ]


@pytest.fixture(scope="module")
def poses() -> Poses:
    rng = np.random.default_rng(7)
    directions = rng.normal(size=(800, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions = np.vstack([directions, np.eye(3)])
    drawn = [random_pose(rng, directions) for _ in range(POSES)]
    pair = CPair(MULTICCD_OFF)
    deepest = [(pair.contacts(*one) or [(1.0, None, np.zeros(3))])[0] for one in drawn]
    cylinder, box = as_geoms([p for p, _ in drawn], [s for _, s in drawn])
    return Poses(cylinder, box, np.array([d[0] for d in deepest]), np.array([d[2] for d in deepest]))


def angles(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Angle between rows [degrees]; by the sine, exact for small ones."""
    sine = np.linalg.norm(np.cross(u, v), axis=-1)
    return np.degrees(np.arctan2(sine, np.sum(u * v, axis=-1)))


def test_deepest_contact_is_that_of_c(poses: Poses) -> None:
    dist, _, frame = map(np.asarray, collide(poses.cylinder, poses.box))
    touching = poses.depth < -DEPTH_ATOL
    assert touching.sum() > POSES // 3
    np.testing.assert_allclose(dist.min(axis=1)[touching], poses.depth[touching], atol=DEPTH_ATOL)
    off = angles(frame[:, 0, 0], poses.normal)[touching]
    assert off.max() < ANGLE_TOL
    assert np.percentile(off, 95) < 0.1


def test_contact_exactly_where_c_has_one(poses: Poses) -> None:
    dist = np.asarray(collide(poses.cylinder, poses.box)[0]).min(axis=1)
    assert np.all(dist[poses.depth > 0.5] > -DEPTH_ATOL)
    assert np.sum(poses.depth > 0.5) > POSES // 6
    assert np.all(dist[poses.depth < -DEPTH_ATOL] < 0)


def test_all_contacts_lie_between_the_surfaces(poses: Poses) -> None:
    dist, pos, frame = map(np.asarray, collide(poses.cylinder, poses.box))
    axis, sizes = np.asarray(poses.cylinder.mat)[:, None, :, 2], np.asarray(poses.cylinder.size)
    offset = pos - np.asarray(poses.cylinder.pos)[:, None]
    along = np.sum(offset * axis, axis=-1)
    radial = np.linalg.norm(offset - along[..., None] * axis, axis=-1)
    local = np.einsum("nji,nkj->nki", np.asarray(poses.box.mat), pos - np.asarray(poses.box.pos)[:, None])
    beyond = np.max(np.abs(local) - np.asarray(poses.box.size)[:, None], axis=-1)
    reach = np.maximum(np.abs(along) - sizes[:, 1:2], radial - sizes[:, 0:1])
    active = dist < 0
    assert np.all((reach < 1e-4)[active])
    assert np.all((beyond < 1e-4)[active])
    rotations = np.einsum("nkij,nklj->nkil", frame, frame)
    np.testing.assert_allclose(
        rotations, np.broadcast_to(np.eye(3), rotations.shape), atol=2e-6
    )  # float32 rounding of unit vectors


BIG = np.array([0.5, 0.5, 0.2])
AT_ORIGIN = np.array([0, 0, 0, 1.0, 0, 0, 0])


@pytest.mark.parametrize(
    ("center", "attitude"),
    [
        ([0, 0, 0.2 + RADIUS - 0.002], LYING),
        ([0, 0, 0.2 + RADIUS - 0.002], multiply(quat(np.array([0, 0, 1.0]), 0.4), LYING)),
        ([0, 0, 0.2 + RADIUS - 0.002], multiply(quat(np.array([1.0, 0, 0]), 0.01), LYING)),
        ([0, 0.51, 0.2 + RADIUS - 0.002], LYING),
        ([0.5 + RADIUS - 0.002, 0, 0.1], LYING),
    ],
    ids=["rolls", "yawed", "tilted", "half over the side", "pushes a wall"],
)
def test_lying_contacts_are_those_of_default_c(center: list, attitude: np.ndarray) -> None:
    pose, size = np.array([*center, *attitude]), np.array([RADIUS, HALF_WIDTH, 0])
    expected = CPair(0).contacts([pose, AT_ORIGIN], [size, BIG])
    dist, pos, frame = (np.asarray(x[0]) for x in collide(*as_geoms([[pose, AT_ORIGIN]], [[size, BIG]])))
    order = np.flatnonzero(dist < 0)
    assert len(order) == len(expected) == 2
    for wanted, point, normal in expected:
        nearest = order[np.argmin(np.linalg.norm(pos[order] - point, axis=1))]
        # C's clipping tolerance moves its points by up to 0.2 mm
        np.testing.assert_allclose(pos[nearest], point, atol=2e-4)
        np.testing.assert_allclose(dist[nearest], wanted, atol=2e-5)
        np.testing.assert_allclose(frame[nearest, 0], normal, atol=1e-5)


@pytest.mark.parametrize("center", [[0, 0], [0.45, 0], [0.55, 0.1], [0.55, 0.55]])
@pytest.mark.parametrize("tilt", [0.0, 1e-6, 1e-3])
def test_flat_disc_stands_on_three_points(center: list, tilt: float) -> None:
    attitude = quat(np.array([1.0, 0.3, 0]), tilt)
    pose = np.array([*center, 0.2 + HALF_WIDTH - 0.002, *attitude])
    size = np.array([RADIUS, HALF_WIDTH, 0])
    expected = CPair(MULTICCD_OFF).contacts([pose, AT_ORIGIN], [size, BIG])[0]
    dist, pos, frame = (np.asarray(x[0]) for x in collide(*as_geoms([[pose, AT_ORIGIN]], [[size, BIG]])))
    assert np.all(dist < 0)
    np.testing.assert_allclose(dist.min(), expected[0], atol=DEPTH_ATOL)
    np.testing.assert_allclose(frame[:, 0], np.broadcast_to([0, 0, -1], (3, 3)), atol=2e-3)
    area = np.linalg.norm(np.cross(pos[1] - pos[0], pos[2] - pos[0])) / 2
    overlap = (np.linspace(-RADIUS, RADIUS, 400)[:, None], np.linspace(-RADIUS, RADIUS, 400))
    inside = (overlap[0] ** 2 + overlap[1] ** 2 < RADIUS**2) & (
        (overlap[0] + center[0] < 0.5) & (overlap[1] + center[1] < 0.5)
    )
    patch = inside.mean() * (2 * RADIUS) ** 2
    assert area > 0.2 * patch  # 0.41 on a whole disc


@pytest.mark.parametrize("half_width", [0.0128, HALF_WIDTH])
@pytest.mark.parametrize("attitude", [LYING, UPRIGHT], ids=["lying", "flat"])
def test_deep_penetration_keeps_the_normal(half_width: float, attitude: np.ndarray) -> None:
    reach = RADIUS if attitude is LYING else half_width
    pose = np.array([0.1, 0.05, 0.2 + reach - half_width / 2, *attitude])
    size = np.array([RADIUS, half_width, 0])
    expected = CPair(MULTICCD_OFF).contacts([pose, AT_ORIGIN], [size, BIG])[0]
    dist, _, frame = collide(*as_geoms([[pose, AT_ORIGIN]], [[size, BIG]]))
    np.testing.assert_allclose(dist.min(), expected[0], atol=DEPTH_ATOL)
    np.testing.assert_allclose(frame[0, 0, 0], [0, 0, -1], atol=1e-6)


def test_degenerate_poses_give_numbers() -> None:
    centers = [[0, 0, 0], [0.5, 0.5, 0.2], [0.5, 0, 0], [0, 0, 0.2 + RADIUS], [9, 9, 9]]
    attitudes = [UPRIGHT, LYING, quat(np.array([0, 1.0, 0]), np.pi / 2), quat(np.ones(3), 1.0)]
    drawn = [[np.array([*c, *a]), AT_ORIGIN] for c in centers for a in attitudes]
    for size in ([RADIUS, HALF_WIDTH, 0], [RADIUS, 1e-6, 0], [1e-6, 0.1, 0]):
        geoms = as_geoms(drawn, [[np.array(size), BIG]] * len(drawn))
        for out in collide(*geoms):
            assert np.all(np.isfinite(out))
    dist, _, frame = collide(*as_geoms(drawn, [[np.array([RADIUS, 0.02, 0]), BIG]] * len(drawn)))
    np.testing.assert_allclose(np.linalg.norm(frame[:, 0, 0], axis=-1), 1, atol=1e-6)
    assert np.all(np.asarray(dist).reshape(5, 4, 3)[0].min(axis=1) < -0.2)  # centre inside
    assert np.all(np.asarray(dist).reshape(5, 4, 3)[4] > 0)


def test_default_c_turns_edge_normals() -> None:
    """Why the pose oracle runs without multiccd; if this fails, C was repaired: use it as it is."""
    direction = np.array([np.cos(np.radians(70)), 0, np.sin(np.radians(70))])
    pose = np.array([*(np.array([0.5, 0, 0.2]) + (RADIUS - 0.002) * direction), *LYING])
    size = np.array([RADIUS, HALF_WIDTH, 0])
    single = CPair(MULTICCD_OFF).contacts([pose, AT_ORIGIN], [size, BIG])[0]
    default = CPair(0).contacts([pose, AT_ORIGIN], [size, BIG])[0]
    dist, _, frame = collide(*as_geoms([[pose, AT_ORIGIN]], [[size, BIG]]))
    assert angles(single[2], -direction) < 0.2
    assert angles(np.asarray(frame)[0, 0, 0], -direction) < 0.2
    np.testing.assert_allclose(np.sort(dist[0])[:2], [-0.002, -0.002], atol=DEPTH_ATOL)
    assert angles(default[2], -direction) > 60


def test_driver_calls_it_and_registering_twice_changes_nothing() -> None:
    module.register_collision()
    key = (mjx.GeomType.CYLINDER, mjx.GeomType.BOX)
    first = collision_driver._COLLISION_FUNC[key]
    module.register_collision()
    assert collision_driver._COLLISION_FUNC[key] is first
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom type="box" size=".5 .5 .2"/><body pos="0 0 .328">
        <freejoint/><geom type="cylinder" size=".13 .025" euler="90 0 0"/></body></worldbody>
        </mujoco>"""
    )
    on_device = mjx.put_model(model)
    place = jax.jit(lambda data: mjx.collision(on_device, mjx.kinematics(on_device, data)))
    contact = place(mjx.make_data(model))._impl.contact
    assert contact.dist.shape == (module.CONTACTS,)
    np.testing.assert_allclose(np.sort(contact.dist)[:2], -0.002, atol=1e-6)


def test_registering_refuses_another_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metadata, "version", lambda name: "3.18.0")
    with pytest.raises(EngineError, match=r"3\.18\.0.*3\.17\.0"):
        module.register_collision()


def test_registering_names_a_missing_private_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(collision_driver, "_COLLISION_FUNC")
    with pytest.raises(EngineError, match="_COLLISION_FUNC"):
        module.register_collision()


# Behaviour. Euler, because MJX's implicitfast also damps an actuator whose force is clamped by
# forcerange, where C does not: that difference in the wheels would hide one in the contacts.
OPTION = """<option timestep="0.005" cone="pyramidal" impratio="2" solver="CG" iterations="16"
ls_iterations="15" integrator="Euler"/>"""
ALL = 'contype="3" conaffinity="3"'  # wheels meet everything but wheels: MJX is poor at that pair
TORQUE_AT_WALL = 3.0  # N m; with 4 C itself climbs the wall in some of 48 runs, with 3 in none


def robot_xml(name: str, place: str, torque: float) -> tuple[str, str]:
    wheels, actuators = "", ""
    for k, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)]):
        wheels += f"""<body pos="{x * WHEELBASE / 2} {y * TRACK / 2} {RADIUS}">
        <joint name="{name}{k}" axis="0 1 0" armature="0.02"/><geom type="cylinder" mass="1"
        size="{RADIUS} {HALF_WIDTH}" euler="90 0 0" contype="1" conaffinity="2"/></body>"""
        actuators += f"""<intvelocity joint="{name}{k}" kp="{KP}" kv="{KV}" actrange="-1e6 1e6"
        forcerange="-{torque} {torque}"/>"""
    chassis = f'<geom type="box" pos="0 0 .19" size=".2 .18 .05" mass="10" {ALL}/>'
    return f"<body name='{name}' {place}><freejoint/>{chassis}{wheels}</body>", actuators


def box_xml(center: tuple, size: tuple, pitch: float = 0.0, extra: str = "") -> str:
    return '<geom type="box" pos="{} {} {}" size="{} {} {}" euler="0 {} 0" {} {}/>'.format(
        *center, *size, pitch, ALL, extra
    )


def scene_xml(robots: list[tuple[str, str]], boxes: str, caps: str = "") -> str:
    bodies, actuators = ("".join(part) for part in zip(*robots, strict=True))
    return f"""<mujoco>{OPTION}<custom>{caps}</custom><worldbody>
    <geom type="plane" size="0 0 1" {ALL}/>{boxes}{bodies}</worldbody>
    <actuator>{actuators}</actuator></mujoco>"""


def caps_xml(pairs: int, points: int) -> str:
    """Broad-phase limits of MJX; C ignores them."""
    return f"""<numeric name="max_geom_pairs" data="{pairs}"/>
    <numeric name="max_contact_points" data="{points}"/>"""


SLIPPERY = 'priority="1" friction="0.3"'


def course_xml() -> str:
    """A ramp of 15 degrees onto a platform at y 0, three steps at y 10, a wall at y 20."""
    slope = np.radians(15)
    top = 2 * np.sin(slope)
    ramp = (0.6 + np.cos(slope) + 0.05 * np.sin(slope), 0, np.sin(slope) - 0.05 * np.cos(slope))
    boxes = box_xml(ramp, (1, 1, 0.05), -15)
    boxes += box_xml((0.6 + 2 * np.cos(slope) + 1.5, 0, top - 0.05), (1.5, 1, 0.05))
    boxes += "".join(box_xml((0.8 + 0.5 * k, 10, 0.025), (0.1, 1, 0.025)) for k in range(3))
    boxes += box_xml((1, 20, 0.25), (0.1, 2, 0.25), 0, SLIPPERY)
    return scene_xml([robot_xml("r", 'pos="0 0 0.001"', TORQUE_AT_WALL)], boxes, caps_xml(12, 32))


def room_xml() -> str:
    """Four robots in a room of 2.4 m."""
    sides = [(1.25, 0), (-1.25, 0), (0, 1.25), (0, -1.25)]
    boxes = "".join(
        box_xml((x, y, 0.25), (0.05 + abs(y), 0.05 + abs(x), 0.25), 0, SLIPPERY) for x, y in sides
    )
    places = [(0.6, 0.4, 30), (-0.6, 0.45, 100), (-0.6, -0.4, 200), (0.6, -0.5, 300)]
    robots = [
        robot_xml(f"r{k}", f'pos="{x} {y} 0.001" euler="0 0 {yaw}"', TORQUE)
        for k, (x, y, yaw) in enumerate(places)
    ]
    return scene_xml(robots, boxes, caps_xml(24, 64))


class Drive(NamedTuple):
    """What a drive left: qpos (worlds, nq), top speed [m/s] and greatest height [m] (worlds,)."""

    qpos: np.ndarray
    speed: np.ndarray
    height: np.ndarray


def drive_jax(xml: str, starts: np.ndarray, commands: np.ndarray) -> Drive:
    """Drive worlds from qpos `starts` (worlds, nq) by wheel speeds (worlds, ticks, nu) [rad/s]."""
    module.register_collision()
    c_model = mujoco.MjModel.from_xml_string(xml)
    model, fresh = mjx.put_model(c_model), mjx.make_data(c_model)
    joints = jnp.array(c_model.jnt_qposadr[c_model.actuator_trnid[:, 0]])

    def tick(data: mjx.Data, ctrl: jax.Array) -> tuple[mjx.Data, tuple[jax.Array, jax.Array]]:
        angle = data.qpos[joints]
        data = data.replace(ctrl=ctrl, act=jnp.clip(data.act, angle - BAND, angle + BAND))
        data = jax.lax.fori_loop(0, SUBSTEPS, lambda _, d: mjx.step(model, d), data)
        speed = jnp.linalg.norm(data.qvel.reshape(-1, 10)[:, :3], axis=1).max()
        return data, (speed, data.qpos[2::11].max())

    @jax.jit
    @jax.vmap
    def drive(start: jax.Array, ctrl: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        data, (speed, height) = jax.lax.scan(tick, fresh.replace(qpos=start), ctrl)
        return data.qpos, speed.max(), height.max()

    return Drive(*map(np.asarray, drive(jnp.float32(starts), jnp.float32(commands))))


def drive_c(xml: str, starts: np.ndarray, commands: np.ndarray, flags: int) -> Drive:
    """The same on C MuJoCo with these disable flags."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.disableflags |= flags
    joints = model.jnt_qposadr[model.actuator_trnid[:, 0]]
    ends, speeds, heights = [], [], []
    for start, ctrls in zip(starts, commands, strict=True):
        data = mujoco.MjData(model)
        data.qpos[:] = start
        speed = height = 0.0
        for ctrl in ctrls:
            data.ctrl[:] = ctrl
            data.act[:] = np.clip(data.act, data.qpos[joints] - BAND, data.qpos[joints] + BAND)
            mujoco.mj_step(model, data, SUBSTEPS)
            speed = max(speed, np.linalg.norm(data.qvel.reshape(-1, 10)[:, :3], axis=1).max())
            height = max(height, data.qpos[2::11].max())
        ends.append(data.qpos.copy())
        speeds.append(speed)
        heights.append(height)
    return Drive(np.array(ends), np.array(speeds), np.array(heights))


@pytest.fixture(scope="module")
def course() -> tuple[Drive, Drive, Drive]:
    """Ramp, steps straight, steps at 20 degrees, wall straight and at 3 degrees: jax, C, default C.

    5 s at 5 rad/s each.
    """
    places = [(0, 0), (10, 0), (10, 20), (20, 0), (20, 3)]  # y [m], yaw [degrees]
    starts = np.zeros((len(places), 11))
    starts[:, 2] = 0.001
    starts[:, 1] = [y for y, _ in places]
    starts[:, 3:7] = [quat(np.array([0, 0, 1.0]), np.radians(yaw)) for _, yaw in places]
    commands = np.full((len(places), 250, 4), 5.0)
    args = course_xml(), starts, commands
    return drive_jax(*args), drive_c(*args, MULTICCD_OFF), drive_c(*args, 0)


@pytest.mark.thorough
def test_climbs_a_ramp_as_c(course: tuple[Drive, Drive, Drive]) -> None:
    ours, single, default = (drive.qpos[0] for drive in course)
    assert default[2] > 0.5  # on the platform
    for reference in (single, default):
        np.testing.assert_allclose(ours[[0, 2]], reference[[0, 2]], atol=0.02)  # m after 3.1 m
        np.testing.assert_allclose(ours[1], reference[1], atol=0.05)


@pytest.mark.thorough
@pytest.mark.parametrize("world", [1, 2], ids=["straight", "at 20 degrees"])
def test_crosses_steps_as_c(course: tuple[Drive, Drive, Drive], world: int) -> None:
    ours, single, default = (drive.qpos[world] for drive in course)
    assert single[0] > 2.2  # past the third step
    np.testing.assert_allclose(ours[0], single[0], atol=0.06)  # m after 3 m and six edges
    # the turned normals of default C brake the wheels at every edge: no reference here
    assert default[0] < ours[0]


@pytest.mark.thorough
@pytest.mark.parametrize("world", [3, 4], ids=["straight", "at 3 degrees"])
def test_pushes_a_wall_as_c(course: tuple[Drive, Drive, Drive], world: int) -> None:
    ours, _, default = course
    assert default.height[world] < 0.03
    assert ours.height[world] < 0.03
    np.testing.assert_allclose(ours.qpos[world, 0], default.qpos[world, 0], atol=0.015)


@pytest.mark.slow
def test_colliding_robots_stay_as_slow_as_in_c() -> None:
    xml = room_xml()
    start = mujoco.MjModel.from_xml_string(xml).qpos0
    rng = np.random.default_rng(5)
    commands = np.repeat(rng.uniform(-8, 8, (3, 8, 16)), 25, axis=1)  # 4 s, new every 0.5 s
    starts = np.tile(start, (3, 1))
    ours = drive_jax(xml, starts, commands)
    c = drive_c(xml, starts, commands, MULTICCD_OFF)
    assert np.all(np.isfinite(ours.qpos))
    assert c.speed.max() > 0.7  # they do drive
    assert ours.speed.max() < 1.25 * c.speed.max()
    assert ours.height.max() < c.height.max() + 0.05
    room = np.abs(ours.qpos.reshape(3, 4, 11)[..., :2])
    assert room.max() < 1.2
