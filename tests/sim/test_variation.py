"""Domain randomisation: what the numbers do to the physics, alike on all engines, and how they are drawn."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.arenas import FLAT, STARTS
from usarmjx.base.clock import clock_at
from usarmjx.base.errors import SpecError
from usarmjx.comms.attenuation import RadioSettings, received_power
from usarmjx.engines.base import VariedModel
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import QUANTITY_RULES, DomainRandomization, RandomizedValues
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.base import SensorInput
from usarmjx.sim.batch import Batch
from usarmjx.sim.reset import init_world, reset
from usarmjx.sim.scene import RosterEntry, build_scene

CONVERGED = Physics(iterations=30, ls_iterations=20)
EVERYTHING = DomainRandomization(
    friction=(0.08, 0.18), mass=(0.8, 1.3), wheel=(0.9, 1.1), torque=(0.7, 1.0), speed=(0.8, 1.1)
)
LEAN = replace(ROBOTS.get("P2AT"), sensors=(), cameras=(), packages=())
"""A P2AT with nothing to see, which compiles faster."""
WORLDS = 3
SPIN = 4.5  # rad/s
RADIUS = 0.13  # of a P2AT's wheels [m]
MU = 0.8  # of wheels and ground
DRIVE, BRAKE = 75, 20  # control steps of 20 ms


class Trip:
    """A P2AT in each world speeds up, drives on and brakes with locked wheels."""

    def __init__(self, engine, vary=EVERYTHING, worlds=WORLDS):
        self.batch = Batch(build_scene(FLAT, [LEAN], CONVERGED, vary=vary), worlds, engine=engine, seed=3)
        self.dof, self.root = (
            getattr(self.batch.scene.groups[0], n)[0] for n in ("root_dofadr", "root_qposadr")
        )
        state = self.batch.drive(self.batch.reset(), 0, {"Left": SPIN, "Right": SPIN})
        self.varied = jax.tree.map(np.asarray, state.worlds.varied)
        self.speeds = []
        for step in range(DRIVE + BRAKE):
            if step == DRIVE:
                self.driven = state
                state = self.batch.drive(state, 0, {"Left": 0.0, "Right": 0.0})
            state = self.batch.step(state)
            self.speeds.append(np.asarray(self.batch.physics(state).qvel)[:, self.dof[0]])
        self.batch.check_overflow(state)
        self.end = np.asarray(self.batch.physics(state).qpos)[:, self.root]

    def of(self, name):
        return getattr(self.varied, name).reshape(len(self.end))


@pytest.fixture(scope="module")
def c():
    return Trip("c")


def check_sliding(trip):
    """A body that slides is slowed down by mu g, whatever its mass: so it stops after v^2 / (2 mu g)."""
    speeds = np.array(trip.speeds[DRIVE + 1 :])  # the first control step locks the wheels
    for world, friction in enumerate(trip.of("friction")):
        sliding = speeds[speeds[:, world] > 0.1, world]
        assert len(sliding) >= 4, "it slides for long enough to be measured"
        slowing = -np.polyfit(0.02 * np.arange(len(sliding)), sliding, 1)[0]
        # 3 %: the chassis rocks by 1 or 2 cm/s, while the robot loses some 30 cm/s.
        assert slowing == pytest.approx(MU * friction * 9.81, rel=0.03)


@pytest.mark.oracle
def test_a_braking_robot_is_slowed_down_by_its_worlds_friction(c):
    check_sliding(c)
    assert np.ptp(c.of("friction")) > 0.02


@pytest.mark.oracle
def test_speed_is_command_times_motors_times_wheels(c):
    asked = SPIN * RADIUS * c.of("speed") * c.of("wheel")
    np.testing.assert_allclose(c.speeds[DRIVE - 1], asked, rtol=5e-3)  # rolling in soft contacts
    assert np.ptp(asked) > 0.02


@pytest.mark.thorough
@pytest.mark.oracle
@pytest.mark.parametrize("engine", [pytest.param("jax", marks=pytest.mark.slow), "warp"])
def test_other_engines_do_to_varied_robots_what_c_does(c, engine):
    if engine == "warp":
        pytest.importorskip("warp", reason="needs warp-lang")
    trip = Trip(engine)
    for name in ("friction", "mass", "wheel", "torque", "speed"):
        np.testing.assert_array_equal(trip.of(name), c.of(name))
    check_sliding(trip)
    np.testing.assert_allclose(trip.end[:, :3], c.end[:, :3], atol=5e-3)  # as tests/engines/test_engines.py
    np.testing.assert_allclose(trip.speeds[DRIVE - 1], c.speeds[DRIVE - 1], atol=5e-3)


@pytest.mark.oracle
def test_weak_motors_accelerate_by_what_they_exert():
    """Far below traction: a = n T / r / (m + n (I + armature) / r^2), until the speed is reached."""
    batch = Batch(
        build_scene(FLAT, [LEAN], CONVERGED, vary=DomainRandomization(torque=(0.1, 0.3))), 3, engine="c"
    )
    dof, wheel = batch.scene.groups[0].root_dofadr[0], batch.scene.model.body("r0/LeftFWheel").id
    state = batch.reset()
    for _ in range(50):  # to rest on the floor
        state = batch.step(state)
    state = batch.drive(state, 0, {"Left": 5.0, "Right": 5.0})
    speeds = []
    for _ in range(12):
        state = batch.step(state)
        speeds.append(np.asarray(batch.physics(state).qvel)[:, dof[0]])
    torque = 4.0 * np.asarray(state.worlds.varied.torque)[:, 0]
    inertia = batch.scene.model.body_inertia[wheel].max() + 0.15  # the motor's armature
    mass = batch.scene.groups[0].plan.mass + 4 * inertia / RADIUS**2
    gained = (speeds[-1] - speeds[3]) / (8 * 0.02)
    np.testing.assert_allclose(gained, 4 * torque / RADIUS / mass, rtol=0.02)  # soft contacts slip a little


@pytest.mark.oracle
def test_masses_are_those_of_a_robot_that_is_built_so():
    """Oracle: MuJoCo's own numbers for a chassis of that many times the mass."""
    scene = build_scene(FLAT, [LEAN, "Zerg"], vary=DomainRandomization(mass=(0.7, 1.4), classes=("P2AT",)))
    assert scene.varied_bodies is not None
    factor = 1.13  # between two knots
    heavy = scene.spec.copy()
    for geom in heavy.body("r0/chassis").geoms:
        geom.mass *= factor
    model = heavy.compile()
    told = RandomizedValues(mass=jnp.array([[factor, 1.0], [1.0, 1.0]]))
    fields = VariedModel(scene.model, scene.varied_bodies, with_dof_m0=True).fields(told)
    assert set(fields) == {
        "body_mass", "body_inertia", "body_subtreemass", "body_invweight0", "dof_invweight0", "dof_M0"
    }  # fmt: skip
    for name, values in fields.items():
        # 1e-3: inverse weights are interpolated; the sums of all masses that the world has do not matter.
        ours, built, plain = values[:, 1:], getattr(model, name)[1:], getattr(scene.model, name)[1:]
        np.testing.assert_allclose(ours[0], built, rtol=1e-3, atol=1e-9, err_msg=name)
        np.testing.assert_allclose(ours[1], plain, rtol=1e-3, atol=1e-9, err_msg=name)


def test_fields_that_differ_already_stay_as_they_are():
    """Wheels change in size where the arena's walls do too: both are kept."""
    scene = build_scene(FLAT, [LEAN], vary=DomainRandomization(wheel=(0.9, 1.1)))
    assert scene.varied_bodies is not None
    wheel = scene.model.geom("r0/LeftFWheel/0").id
    sizes = jnp.broadcast_to(jnp.arange(scene.model.ngeom * 3.0).reshape(-1, 3), (2, scene.model.ngeom, 3))
    told = RandomizedValues(wheel=jnp.array([[1.1], [0.9]]))
    size = VariedModel(scene.model, scene.varied_bodies).fields(told, {"geom_size": sizes})["geom_size"]
    np.testing.assert_allclose(size[:, wheel, 0] / sizes[:, wheel, 0], [1.1, 0.9], rtol=1e-6)
    others = [g for g in range(scene.model.ngeom) if "Wheel" not in scene.model.geom(g).name]
    np.testing.assert_array_equal(size[:, others], sizes[:, others])


def test_worlds_with_arenas_of_their_own_keep_them():
    """Against a wall that each world has elsewhere; a wheel factor of 1 changes nothing but the path."""
    walls = [
        ArenaSpec(
            name=f"w{x}",
            starts=STARTS,
            extent=((-3, 3), (-3, 3)),
            shapes=(Shape(kind="box", size=(0.1, 1.0, 0.5), at=(x, 0.0, 0.5), surface="wall"),),
        )
        for x in (0.6, 0.9)
    ]
    ends = []
    for vary in (None, DomainRandomization(wheel=(1.0, 1.0))):
        batch = Batch(build_scene(walls, [LEAN], CONVERGED, vary=vary), 2, engine="c")
        state = batch.drive(batch.reset(), 0, {"Left": 5.0, "Right": 5.0})
        for _ in range(60):
            state = batch.step(state)
        ends.append(np.asarray(batch.physics(state).qpos)[:, batch.scene.groups[0].root_qposadr[0, 0]])
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-3)  # sizes are in single precision
    assert ends[0][1] - ends[0][0] == pytest.approx(0.3, abs=0.02)


def test_latency_delays_motion_by_whole_steps_exactly():
    """Bit-equal to robots without latency that are told so many steps later."""
    varied, plain = (
        Batch(build_scene(FLAT, [LEAN], vary=vary), 6, engine="c", seed=1)
        for vary in (DomainRandomization(latency=(0, 4)), None)
    )
    state, late = varied.reset(), plain.reset()
    latency = np.asarray(state.worlds.varied.latency)[:, 0]
    assert len(set(latency.tolist())) > 2
    state = varied.drive(state, 0, {"Left": 2.0, "Right": 1.0})
    for step in range(8):
        told = np.where(step >= latency, 1.0, 0.0)[:, None]
        late = plain.drive(late, 0, {"Left": 2.0 * told, "Right": 1.0 * told})
        state, late = varied.step(state), plain.step(late)
        np.testing.assert_array_equal(state.physics.qpos, late.physics.qpos)
    again = varied.reset_where(state, np.ones(6, bool))
    assert not np.asarray(again.worlds.groups[0].command_history.target).any(), (
        "a new episode has heard of nothing"
    )


def test_without_ranges_nothing_changes_bit_for_bit():
    ends = []
    for vary in (None, DomainRandomization()):
        batch = Batch(build_scene(FLAT, [LEAN], vary=vary), 2, engine="c", seed=1)
        state = batch.drive(batch.reset(), 0, {"Left": 2.0, "Right": 1.0})
        for _ in range(5):
            state = batch.step(state)
        assert jax.tree.leaves(state.worlds.varied) == []
        ends.append(state.physics.integration)
    np.testing.assert_array_equal(*ends)


# ---- how numbers are drawn

ALL = DomainRandomization(
    friction=(0.5, 1.0),
    mass=(0.8, 1.2),
    wheel=(0.9, 1.1),
    torque=(0.7, 1.1),
    speed=(0.9, 1.0),
    noise=(0.0, 2.0),
    latency=(1, 3),
    radio_pdo=(-55.0, -45.0),
    radio_n=(1.0, 3.0),
    radio_cutoff=(-95.0, -80.0),
    radio_atten_fac=(3.0, 9.0),
)


def drawn(vary, number, roster=(LEAN, LEAN), episodes=1, seed=0):
    """The numbers of a world in its first episodes."""
    scene = build_scene(FLAT, roster, radio=RadioSettings(), vary=vary)
    key = jax.random.fold_in(jax.random.key(seed), number)
    from usarmjx.models.compile.randomization import sample_values
    from usarmjx.sim.world import Stream

    stream = jax.random.fold_in(key, Stream.RANDOMIZATION)
    assert scene.varied_bodies is not None
    return [
        jax.tree.map(
            np.asarray, sample_values(vary, scene.varied_bodies.varies, jax.random.fold_in(stream, episode))
        )
        for episode in range(episodes)
    ]


def test_numbers_lie_in_their_ranges_and_differ_by_world_episode_and_robot():
    rows = [one for number in range(20) for one in drawn(ALL, number, episodes=2)]
    for name, rule in QUANTITY_RULES.items():
        low, high = ALL.range_of(name)
        values = np.stack([getattr(row, name) for row in rows])
        assert values.shape == ((40, 2) if rule.robots else (40,))
        assert (values >= low).all()
        assert (values <= high).all()
        if rule.whole:
            assert set(values.ravel().tolist()) == {1, 2, 3}
        else:
            assert len(np.unique(values)) == values.size, "no two alike"
            # The mean of n uniform numbers is off by more than 4 width / sqrt(12 n) once in 16000 times.
            assert abs(values.mean() - (low + high) / 2) < 4 * (high - low) / np.sqrt(12 * values.size)


def test_a_number_depends_on_world_episode_quantity_and_slot_alone():
    (everything,), (only,) = drawn(ALL, 5), drawn(DomainRandomization(torque=(0.7, 1.1)), 5)
    np.testing.assert_array_equal(everything.torque, only.torque)
    (more,) = drawn(ALL, 5, (LEAN, LEAN, LEAN))
    np.testing.assert_array_equal(everything.mass, more.mass[:2])
    (some,) = drawn(replace(ALL, classes=("Zerg",)), 5, ("P2AT", "Zerg"))
    np.testing.assert_array_equal(some.mass, [1.0, everything.mass[1]])
    np.testing.assert_array_equal(some.latency, [0, everything.latency[1]])


def test_ranges_that_are_data_are_drawn_from_as_if_the_scene_had_them():
    narrow = DomainRandomization(friction=(0.3, 0.4), latency=(2, 3), radio_cutoff=(-60.0, -60.0))
    scene = build_scene(FLAT, [LEAN, LEAN], radio=RadioSettings(), vary=replace(narrow, friction=(0.1, 9.0)))
    key = jax.random.fold_in(jax.random.key(0), 5)
    own = {"friction": jnp.array([0.3, 0.4]), "radio_cutoff": jnp.array([-60.0, -60.0])}
    blank = init_world(scene, key, jnp.int32(5))[0].replace(ranges=own, episode=jnp.int32(-1))
    world, _ = jax.jit(lambda world: reset(scene, world))(blank)
    (expected,) = drawn(narrow, 5)
    for a, b in zip(jax.tree.leaves(world.varied), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_batch_draws_what_its_worlds_draw():
    scene = build_scene(FLAT, [LEAN, LEAN], radio=RadioSettings(), vary=ALL)
    world, _ = init_world(scene, jax.random.fold_in(jax.random.key(0), 7), jnp.int32(7))
    (alone,) = drawn(ALL, 7)
    for a, b in zip(jax.tree.leaves(world.varied), jax.tree.leaves(alone), strict=True):
        np.testing.assert_array_equal(a, b)


# ---- what is not physics


def test_noise_is_multiplied_and_nothing_else():
    """All rays of a P2AT meet something at 2 m; each sensor draws the same numbers whatever the factor."""
    scene = build_scene(FLAT, ["P2AT"])
    suite, plan = scene.groups[0].suite, scene.groups[0].plan
    from usarmjx.models.compile.kinematic_tree import forward_kinematics, robot_state
    from usarmjx.sensors.rays.raycast import Hits

    state = robot_state(scene.groups[0].indices[0], scene.model.qpos0, np.zeros(scene.model.nv))
    state = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), state)
    hits = Hits(distance=jnp.full(sum(suite.ray_counts), 2.0), cosine=jnp.ones(sum(suite.ray_counts)))

    @jax.jit
    def read(noise):
        sensor_input = SensorInput(
            clock=clock_at(0.0, 0.02), state=state, bodies=forward_kinematics(plan, state), hits=hits
        )
        sensor_input = sensor_input.replace(noise_factor=noise)
        _, readings = suite.read(
            sensor_input, suite.init_memory(sensor_input, jax.random.key(1)), jax.random.key(2)
        )
        return [reading.value for reading in readings]

    silent, usual, double, same = (
        read(noise) for noise in (jnp.zeros(()), jnp.ones(()), jnp.full((), 2.0), None)
    )
    loud = []
    for sensor, none, one, two, off in zip(suite.sensors, silent, usual, double, same, strict=True):
        np.testing.assert_allclose(one, off, rtol=1e-6, err_msg=sensor.kind)
        if np.abs(one - none).max() > 0:
            loud.append(sensor.kind)
        if sensor.kind in ("Sonar", "RangeScanner"):
            np.testing.assert_allclose(none, 2.0, rtol=1e-6)
            np.testing.assert_allclose(two - none, 2 * (one - none), atol=1e-5)
    assert "Sonar" in loud


def test_each_world_has_its_own_radio():
    vary = DomainRandomization(radio_n=(1.0, 4.0), radio_pdo=(-60.0, -40.0), radio_cutoff=(-60.0, -50.0))
    usual = RadioSettings(n=2.0)
    batch = Batch(build_scene(FLAT, [LEAN, LEAN], radio=usual, vary=vary), 4, engine="c")
    state, links = batch.links(batch.reset())
    varied = jax.tree.map(np.asarray, state.worlds.varied)
    for world in range(4):
        pdo, n, cutoff = (float(getattr(varied, f"radio_{k}")[world]) for k in ("pdo", "n", "cutoff"))
        own = replace(usual, pdo=pdo, n=n, cutoff=cutoff)
        power = received_power(own, 2.0, 0)  # the starts are 2 m apart
        np.testing.assert_allclose(links.power[world, 0, 1], power, atol=1e-3)
        assert bool(links.in_range[world, 0, 1]) == bool(power >= cutoff)
    assert np.ptp(np.asarray(links.power)[:, 0, 1]) > 1.0


# ---- what is refused


@pytest.mark.parametrize(
    ("ranges", "words"),
    [
        ({"friction": (1.0, 0.5)}, r"friction is \(1.0, 0.5\), expected two numbers \(lowest, highest\)"),
        ({"friction": 0.5}, "friction is 0.5, expected a list of 2 numbers above 0 or none"),
        ({"friction": (0.0, 0.5)}, r"friction\[0\] is 0.0, expected a number above 0"),
        ({"mass": (float("nan"), 1.0)}, r"mass\[0\] is nan"),
        ({"noise": (-1.0, 1.0)}, "expected a number from 0"),
        ({"latency": (0.5, 2.0)}, r"latency\[0\] is 0.5, expected a whole number"),
        ({"latency": (0, 200)}, "expected a whole number from 0 to 100"),
        ({"radio_n": (-1.0, 2.0)}, "radio_n"),
    ],
)
def test_ranges_that_make_no_sense_are_refused(ranges, words):
    with pytest.raises(SpecError, match=words):
        DomainRandomization(**ranges)


@pytest.mark.parametrize(
    ("roster", "ranges", "words"),
    [
        (
            ["AirRobot"],
            {"mass": (0.9, 1.1)},
            "mass does not go with AirRobot, which is trimmed to its weight",
        ),
        (["P2AT", "ERS"], {"wheel": (0.9, 1.1)}, "wheel does not go with ERS, which has no wheels"),
        (["Submarine"], {"torque": (0.9, 1.0)}, "torque does not go with Submarine"),
        (["P2AT", "ComStation"], {"speed": (0.9, 1.0)}, "speed does not go with ComStation"),
        (["P2AT"], {"radio_n": (1.0, 2.0)}, "no radio"),
        (
            ["P2AT"],
            {"mass": (1.0, 2.0), "classes": ("Zerg",)},
            "no robots of class Zerg here; there are P2AT",
        ),
    ],
)
def test_what_a_quantity_cannot_be_about_is_refused_by_name(roster, ranges, words):
    entries = [RosterEntry(robot=name, parked=True) for name in roster]
    with pytest.raises(SpecError, match=words):
        build_scene(FLAT, entries, vary=DomainRandomization(**ranges))


def test_mixed_teams_vary_by_class():
    scene = build_scene(
        FLAT, ["AirRobot", "P2AT"], vary=DomainRandomization(mass=(0.9, 1.1), classes=("P2AT",))
    )
    assert scene.varied_bodies is not None
    assert scene.varied_bodies.varies.tolist() == [False, True]
    assert ROBOTS.get("P2AT") == scene.groups[1].robot
