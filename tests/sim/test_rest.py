"""The start of an episode is a state of rest: first readings are those of the same robot standing still."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.arenas import FLAT
from usarmjx.base.backend import numpy_backend
from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.compile.compose import add_robot, index_robot, new_spec
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.parts import parts_of
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import DomainRandomization, RandomizedValues, max_wheel_radius
from usarmjx.models.compile.standing import MAX_SINKING, MAX_TILT, START_GAP, stance_of, stances_in
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec, StartPose, Water
from usarmjx.models.types.robot import Mount, manual_keys
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.base import NOISE_SETTINGS, SENSORS
from usarmjx.server.worlds.batch_world import BatchWorld
from usarmjx.sim.batch import Batch
from usarmjx.sim.control import CommandUpdate, update_command
from usarmjx.sim.scene import RosterEntry, build_scene, start_height
from usarmjx.sim.single_world import SingleWorld

FIRST, SECOND, STANDING = 5, 50, 150
"""Control steps of 20 ms: the first ones, of a second, and when it stands for sure."""
MOTION = ("IMU", "AHRS", "INS", "INU", "GroundTruth", "MagneticCompass", "Magnetometer", "AltitudeSensor")
"""Types of sensors that every robot gets beside its own: all that feel its motion or its attitude."""
SHAKING = 5e-3
"""Acceleration [m/s2, rad/s2] and rate [rad/s] that the solver's residual makes of a robot that stands: it is
below 2.4e-3 for all classes. A fall of 0.1 mm gives 0.5, a servo that begins to give way 0.1."""
RESIDUAL = {"IMU": SHAKING, "AHRS": SHAKING, "Magnetometer": 1e-3}
"""Tolerances of types of sensors; 50 uT turned by `CREEP` are 1e-3 uT."""
CREEP = 2e-5
"""Soft contacts creep: distance and angle in three seconds [m, rad]. All classes are below 1.5e-5."""
MANY = 4
"""Classes above which a test has `EVERY` class."""
NOISE = {("warp", True): 10.0}
"""Factors on the tolerances, by engine and whether every class is there. On MuJoCo Warp, whose solver is
capped, joints of the ERS settle by 1.4e-4 rad."""


def quiet(kind):
    known = manual_keys(SENSORS.get(kind).settings_class)
    return tuple(
        {**{known[name]: 0.0 for name in known if name in NOISE_SETTINGS}, "ScanInterval": 0.0}.items()
    )


def attentive(name):
    """The class, with its sensors and those of `MOTION` without noise, which all measure in every step."""
    spec = ROBOTS.get(name)
    own = [replace(mount, options=(*mount.all_options, *quiet(mount.kind))) for mount in spec.sensors]
    more = [Mount(kind=kind, name=f"My{kind}", options=quiet(kind)) for kind in MOTION]
    return replace(spec, cameras=(), sensors=(*own, *more))


def room(spec):
    """Four walls; divers have water, as a dry floor is no place of rest for them."""
    sides = (((0.1, 4.0, 1.0), (4.0, 0.0, 1.0)), ((4.0, 0.1, 1.0), (0.0, 4.0, 1.0)))
    walls = [(size, tuple(sign * x for x in at[:2]) + at[2:]) for size, at in sides for sign in (1, -1)]
    dives = spec.drive.vehicle == "NauticVehicle"
    return ArenaSpec(
        name="room",
        starts=(StartPose(tag="S", at=(0.0, 0.0, 1.188 if dives else 0.188), yaw=0.4),),
        extent=((-4, 4), (-4, 4)),
        shapes=tuple(Shape(kind="box", size=size, at=at, surface="wall") for size, at in walls),
        waters=(Water(low=(-4.0, -4.0, 0.0), high=(4.0, 4.0, 3.0)),) if dives else (),
    )


class Served:
    """A served world with one robot, what its sensors read and where it is, step by step."""

    def __init__(self, name):
        self.spec = attentive(name)
        arena = room(self.spec)
        self.world = SingleWorld(build_scene(arena, ()), seats=1)
        (start,) = arena.starts
        pos = (*start.at[:2], start_height(arena, start, self.spec))
        self.slot = self.world.add(self.spec, name, [(pos, quat_from_angles(0.0, 0.0, start.yaw))])
        self.kinds = [sensor.kind for sensor in self.world.scene.groups[0].suite.sensors]

    def run(self, steps):
        """Readings by sensor (steps + 1, n), qpos and qvel after each step."""
        rows, states = [], []
        for step in range(steps + 1):
            if step:
                self.world.step()
            rows.append([np.ravel(one.value) for one in self.world.observe([self.slot])[self.slot]])
            data = self.world.engine.data
            states.append((data.qpos.copy(), data.qvel.copy()))
        readings = [np.array(values, float) for values in zip(*rows, strict=True)]
        return readings, *map(np.array, zip(*states, strict=True))

    def drive(self):
        """Let it drive straight on, a third as fast as it can."""
        ahead = {key: top / 3 for key, top in self.spec.drive.full_scale.items() if "Steer" not in key}
        plan, command = self.world.scene.groups[0].plan, self.world.state_of(self.slot).command
        with numpy_backend():
            told = update_command(plan, command, CommandUpdate(drive=ahead))
        self.world.edit(self.slot, command=told)


def check(kinds, first, standing, noise=1.0):
    """First readings (steps, n) of each sensor are those of a robot that stands (n,)."""
    assert set(MOTION) <= set(kinds)
    for kind, now, later in zip(kinds, first, standing, strict=True):
        wanted = np.broadcast_to(later, now.shape)
        atol = noise * RESIDUAL.get(kind, CREEP)
        np.testing.assert_allclose(now, wanted, rtol=0, atol=atol, err_msg=kind)


@pytest.mark.parametrize("name", ROBOTS.names())
def test_first_readings_of_every_class_are_those_of_a_robot_that_stands(name):
    served = Served(name)
    readings, qpos, qvel = served.run(STANDING)
    check(served.kinds, [one[: FIRST + 1] for one in readings], [one[-1] for one in readings])
    assert np.abs(qpos[: SECOND + 1] - qpos[0]).max() < CREEP, "nothing drops, tilts or gives way"
    assert np.abs(qvel[: SECOND + 1]).max() < SHAKING, "nothing jumps"


@pytest.mark.parametrize("name", ["P2AT", "Hummer", "Talon"])
def test_after_a_reset_a_driven_robot_stands_as_it_began(name):
    """On rigid wheels, on springs, and on tracks with an arm."""
    served = Served(name)
    before, start, _ = served.run(FIRST)
    served.drive()
    _, there, _ = served.run(SECOND)
    assert np.linalg.norm((there - start[0])[-1, :2]) > 0.1, "it has gone somewhere"
    served.world.reset()
    after, again, _ = served.run(FIRST)
    np.testing.assert_allclose(again, start, rtol=0, atol=CREEP)
    check(served.kinds, after, [one[-1] for one in before])


CLASSES = ("P2DX", "Hummer", "Talon", "AirRobot")
"""The largest tilt on wheels, springs, tracks with an arm, and a flyer."""
EVERY = [name for name, spec in ROBOTS if spec.drive.vehicle != "NauticVehicle"]
"""Divers have no place of rest on a dry floor."""
ON_JAX = ("Soryu",)
"""Class of every run on `jax`, where each takes as long to compile: the long chain that trembled most, by
0.4 rad/s2, while MJX integrated forces."""
PLANAR = [name for name in EVERY if name not in ("ERS", "QRIO")]
"""Those that do not walk on legs."""


def batch_of(names, engine, parked=False, vary=None):
    """One robot of each class, 6 m apart, with the sensors of `MOTION`: rays take long to compile."""
    starts = tuple(StartPose(tag=f"S{i}", at=(6.0 * i, 0.0, 0.188), yaw=0.4) for i in range(len(names)))
    arena = replace(FLAT, starts=starts, extent=((-3, 6 * len(names) + 3), (-3, 3)))
    specs = [attentive(name) for name in names]
    feeling = [replace(spec, sensors=spec.sensors[-len(MOTION) :]) for spec in specs]
    roster = [RosterEntry(robot=spec, parked=parked) for spec in feeling]
    return Batch(build_scene(arena, roster, vary=vary), worlds=1, engine=engine)


def stand_from_their_start_on(batch, state, noise):
    """Assert it for a second, and that robots read first what they read when they have stood for one."""
    first = []
    before = np.asarray(batch.physics(state).qpos)
    for step in range(SECOND + 1):
        if step <= FIRST or step == SECOND:
            state, readings = batch.observe(state)
            values = [[np.ravel(one.value) for one in group] for group in readings]
            first.append(values)
        physics = batch.physics(state)
        np.testing.assert_allclose(physics.qpos, before, rtol=0, atol=noise * CREEP)
        assert np.abs(physics.qvel).max() < noise * SHAKING, "nothing jumps"
        state = batch.step(state)
    *early, late = first
    for i, group in enumerate(batch.scene.groups):
        kinds = [sensor.kind for sensor in group.suite.sensors]
        now = [np.stack(values) for values in zip(*(one[i] for one in early), strict=True)]
        check(kinds, now, late[i], noise)
    return state


def stand_from_each_reset_on(batch):
    """Assert that robots stand still after a reset, and after another one once they have driven."""
    groups = batch.scene.groups
    noise = NOISE.get((batch.engine.name, len(groups) > MANY), 1.0)
    state = stand_from_their_start_on(batch, batch.reset(0), noise)
    for group in range(len(groups)):
        ahead = dict.fromkeys(groups[group].robot.drive.keys, 1.0)
        state = batch.drive(state, group, ahead)
    for _ in range(FIRST):
        state = batch.step(state)
    stand_from_their_start_on(batch, batch.reset_where(state, np.array([True])), noise)


@pytest.mark.parametrize(
    ("engine", "names"),
    [
        ("c", CLASSES[:2]),
        ("planar", CLASSES),
        pytest.param("c", EVERY, marks=pytest.mark.thorough, id="c-every"),
        pytest.param("planar", PLANAR, marks=pytest.mark.thorough, id="planar-every"),
        *(
            pytest.param(
                "jax", (name,), marks=() if name in ON_JAX else pytest.mark.thorough, id=f"jax-{name}"
            )
            for name in EVERY
        ),
        pytest.param("warp", ("P2DX", "Hummer"), marks=pytest.mark.thorough),
        pytest.param("warp", EVERY, marks=pytest.mark.thorough, id="warp-every"),
    ],
)
def test_robots_of_batches_stand_still_from_each_reset_on(engine, names):
    stand_from_each_reset_on(batch_of(names, engine))


VARIED = {
    "small": DomainRandomization(wheel=(0.82, 0.86)),
    "large": DomainRandomization(wheel=(1.14, 1.18), mass=(1.2, 1.25)),
}


@pytest.mark.parametrize(
    ("engine", "names", "vary"),
    [
        ("c", ("P2AT", "P2DX", "Hummer"), "large"),
        pytest.param("c", ("P2AT", "P2DX", "Hummer"), "small", marks=pytest.mark.thorough),
        *(
            pytest.param("planar", ("P2AT", "P2DX", "Hummer"), vary, marks=pytest.mark.thorough)
            for vary in VARIED
        ),
        *(pytest.param("jax", ("P2DX",), vary, marks=pytest.mark.thorough) for vary in VARIED),
        *(pytest.param("warp", ("P2DX", "Hummer"), vary, marks=pytest.mark.thorough) for vary in VARIED),
    ],
)
def test_robots_whose_wheels_and_mass_vary_stand_still_from_each_reset_on(engine, names, vary):
    """On wheels of one size, on wheels and a caster, on springs."""
    stand_from_each_reset_on(batch_of(names, engine, vary=VARIED[vary]))


@pytest.mark.parametrize("engine", ["c", "planar"])
@pytest.mark.parametrize("wheel", [0.8, 1.25])
def test_on_wheels_of_another_size_axles_are_a_radius_above_the_floor(engine, wheel):
    """In closed form: the axle of a wheel that sinks in as before is higher by the change of its radius."""
    batch = batch_of(("P2AT",), engine, vary=DomainRandomization(wheel=(wheel, wheel)))
    group = batch.scene.groups[0]
    height = np.asarray(batch.physics(batch.reset(0)).qpos)[0, group.root_qposadr[0, 2]]
    axles = [height - part.at[2] for part in group.robot.wheels]
    sunk = kinematic_tree_of(group.robot).clearance - stance_of(group.robot).height
    assert 0.0 < sunk < 5e-4
    np.testing.assert_allclose(axles, wheel * group.robot.wheel_radius - sunk, rtol=0, atol=CREEP)


def lone(spec, wheel, mass):
    """A robot of a class on level ground, its wheels and chassis not those of the class."""
    ground = new_spec(ArenaSpec(name="ground", starts=(), extent=((-2, 2), (-2, 2))), Physics())
    add_robot(ground, spec, "", (0.0, 0.0, 0.0))
    model = ground.compile()
    index = index_robot(model, spec, "")
    rolls = [body for body, part in zip(index.body_ids[1:], parts_of(spec), strict=True) if part.is_wheel]
    wheels = np.isin(model.geom_bodyid, rolls)
    model.geom_size[wheels, 0] *= wheel
    model.geom_aabb[wheels, 3:5] *= wheel
    model.geom_rbound[wheels] *= max(wheel, 1.0)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    model.body_mass[index.body_ids[0]] *= mass
    model.body_inertia[index.body_ids[0]] *= mass
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model, index


ROLLING = [name for name, spec in ROBOTS if max_wheel_radius(spec) > 0.0 and not spec.drive.applies_wrench]


@pytest.mark.oracle
@pytest.mark.parametrize(("wheel", "mass"), [(0.83, 1.0), (1.21, 1.1)])
@pytest.mark.parametrize("name", ROLLING)
def test_every_class_stands_on_wheels_of_another_size(name, wheel, mass):
    """By C MuJoCo, between the entries of the table: it keeps its height and its tilt for a second."""
    spec = ROBOTS.get(name)
    vary = DomainRandomization(wheel=(0.8, 1.25), mass=(0.8, 1.25))
    values = RandomizedValues(wheel=np.float32([wheel]), mass=np.float32([mass]))
    with numpy_backend():
        own = stances_in(vary, values, spec, [0])
    model, index = lone(spec, wheel, mass)
    data, root = mujoco.MjData(model), index.root_qposadr
    data.qpos[root + 2 : root + 7] = stance_of(spec).height + own.lift[0], *own.tilt[0]
    data.qpos[list(index.qposadr)] = own.joints[0]
    data.ctrl[list(index.hold_actuator_ids)] = 1.0
    before = data.qpos.copy()
    for _ in range(200):
        mujoco.mj_step(model, data)
        assert np.abs(data.qpos - before)[root + 2 : root + 6].max() < 2 * CREEP


def test_a_class_that_does_not_vary_stands_as_ever():
    """And so does one of which nothing varies that moves a robot that stands."""
    values = RandomizedValues(wheel=np.ones(1, np.float32), mass=np.ones(1, np.float32))
    p2at = ROBOTS.get("P2AT")
    assert stances_in(None, None, p2at, [0]) is None
    assert stances_in(DomainRandomization(wheel=(0.8, 0.9), classes=("P2DX",)), values, p2at, [0]) is None
    assert stances_in(DomainRandomization(torque=(0.8, 1.0)), values, p2at, [0]) is None


def test_a_parked_robot_on_other_wheels_that_a_client_claims_stands_still():
    """The P2DX tilts, the springs of the Hummer give way."""
    world = BatchWorld(batch_of(("P2DX", "Hummer"), "c", parked=True, vary=VARIED["large"]), 0)
    for group, start in zip(world.scene.groups, world.arena.starts, strict=True):
        pos = (*start.at[:2], start_height(world.arena, start, group.robot))
        world.spawn_at(group.robot, f"My{group.robot.name}", [(pos, (0.0, 0.0, start.yaw))])
    before = world.one_world()[1].qpos
    for _ in range(SECOND):
        world.step()
        np.testing.assert_allclose(world.one_world()[1].qpos, before, rtol=0, atol=CREEP)


def test_a_parked_robot_that_a_client_claims_stands_still():
    """Talon's arm has given way where it was parked, so that it does not move when it is in use."""
    world = BatchWorld(batch_of(("Talon",), "c", parked=True), 0)
    spec, start = world.scene.groups[0].robot, world.arena.starts[0]
    pos = (*start.at[:2], start_height(world.arena, start, spec))
    world.spawn_at(spec, "Me", [(pos, (0.0, 0.0, start.yaw))])
    before = world.one_world()[1].qpos
    for _ in range(SECOND):
        world.step()
        np.testing.assert_allclose(world.one_world()[1].qpos, before, rtol=0, atol=CREEP)


def test_the_stance_of_a_class_is_that_of_its_contacts():
    """A P2AT sinks by what its weight needs; what flies starts clear of the floor; wheels have not turned."""
    tree = kinematic_tree_of(ROBOTS.get("P2AT"))
    assert 0.0 < tree.clearance - stance_of(tree.robot).height < 5e-4
    for name, spec in ROBOTS:
        stance, clearance = stance_of(spec), kinematic_tree_of(spec).clearance
        assert not stance.joints[[part.is_wheel for part in parts_of(spec)]].any(), name
        if spec.drive.applies_wrench:
            assert stance.height - clearance == pytest.approx(START_GAP)
            np.testing.assert_array_equal(stance.tilt, (1.0, 0.0, 0.0, 0.0))
        else:
            assert -MAX_SINKING < stance.height - clearance <= 0.0, name
            assert 0.0 < stance.sinking < MAX_SINKING, name
            assert 0.0 <= 2 * np.hypot(*stance.tilt[1:3]) < MAX_TILT, name
