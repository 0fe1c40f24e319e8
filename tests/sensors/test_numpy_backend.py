"""Sensors on NumPy read what they read on JAX; nothing is traced or compiled for it."""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.listening import compilations
from tests.sensors.people import Room
from usarmjx.base import random
from usarmjx.base.backend import numpy_backend, xp
from usarmjx.base.clock import Clock
from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.compile.kinematic_tree import forward_kinematics
from usarmjx.models.compile.tags import tag_table
from usarmjx.models.drives.base import RobotState
from usarmjx.models.effecters import MAX_DROPPED_TAGS, DroppedTags
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import ENCODER_AXIS, P2AT
from usarmjx.models.types.arena import FalseAlarm, HelpSound, SegmentMotion, Tag, Victim
from usarmjx.models.types.robot import Mount, options
from usarmjx.sensors.base import ROBOT_FIELDS, SENSORS, SensorInput, is_vectorized
from usarmjx.sensors.rays.raycast import Hits, RayQuery
from usarmjx.sensors.suite import Suite, suite_of
from usarmjx.sensors.surroundings import surroundings_at

# XLA fuses products and sums, and its logarithms and angles differ in the last places: some units of single
# precision, as a share of what is measured ...
SHARE = 1e-5
# ... and of positions about 10 m from the origin, which the INS adds up over four measurements [m, rad].
NEAR = 2e-5
SEED = 11
TIMES = np.float32([0.0, 0.2, 0.4, 0.6])  # s
CURVE = ((0.0, 0.0), (1.0, 1.5), (6.0, 5.0))
AHEAD = (0.1, 0.0, -0.1)
# Of what no robot class has, and of every option that `read` looks at.
KEYS: dict[str, tuple[dict[str, Any], ...]] = {
    "Sonar": ({}, {"Sigma": 0.05, "OutputCurve": CURVE}),
    "RangeScanner": ({"Resolution": 0.1, "MaxRange": 20.0, "Noise": 0.05}, {"ScanInterval": 0.0}),
    "IRScanner": ({"Resolution": 0.1, "MaxRange": 20.0, "Sigma": 0.05, "Mean": 0.1},),
    "RangeScanner3D": ({"ScanInterval": 0.4},),
    "Lidar": (
        {"VerticalResolution": 0.2, "HorizontalResolution": 0.5, "Dropout": 0.2, "IntensityNoise": 0.1},
    ),
    "Kinect": ({"VerticalResolution": 0.01, "HorizontalResolution": 0.1},),
    "IMU": ({"ScanInterval": 0.0},),
    "Magnetometer": ({"HardIron": (("X", 3.0), ("Y", -2.0), ("Z", 1.0))},),
    "INS": ({"Drifting": True, "Precision": 10.0}, {"Sigma": 0.0, "ScanInterval": 0.0}),
    "Odometry": ({"LeftTire": "", "RightTire": "", "EncoderResolution": 0.001, "Sigma": 0.1},),
    "VictSensor": ({"ScanInterval": 0.2}, {"bShowResults": True, "HorizontalStep": 0.2, "ScanInterval": 0.2}),
    "RFID": (
        {"bTraceRFIDs": True},
        {"SensingMode": "Radius"},
        {"SensingMode": "Obstacle", "bTraceRFIDs": True},
    ),
    "Touch": ({}, {"Diameter": 0.05}, {}),
    "Sound": ({"OutputCurve": CURVE},),
}
EVERYTHING = replace(
    P2AT,
    name="Everything",
    sensors=tuple(
        Mount(
            kind=kind,
            name=f"{kind}{i}",
            parent=P2AT.wheels[0].name if kind == "Encoder" else "HARD",
            at=AHEAD,
            direction=ENCODER_AXIS if kind == "Encoder" else (0.1, -0.2, 0.3),
            options=options(**keys),
        )
        for kind, _ in SENSORS
        for i, keys in enumerate(KEYS.get(kind, ({},)))
    ),
)


def classes():
    """Every class; those with the sensors of one before them take a compiler's time for little."""
    met = set()
    for robot in (EVERYTHING, *(robot for _, robot in ROBOTS)):
        kinds = tuple(sensor.kind for sensor in suite_of(robot).sensors)
        yield pytest.param(robot, id=robot.name, marks=pytest.mark.slow if kinds in met else ())
        met.add(kinds)


ROOM = Room(
    victims=(
        Victim(
            name="Ada",
            at=(1.5, 0.4, 0.12),
            posture="sitting",
            help_sound=HelpSound(loudness=3.0, duration=5.0),
        ),
        Victim(
            name="Bob",
            at=(2.0, -0.6, 0.12),
            posture="sitting",
            segments=(SegmentMotion(name="LeftArm", final=(0.0, 0.0, 1.2), rates=(0.0, 0.0, 1.0)),),
        ),
    ),
    alarms=(FalseAlarm(part="RightLeg", at=(2.0, 1.5, 0.1)),),
    tags=(Tag(at=(1.0, 0.0, 0.0)), Tag(at=(-1.0, 1.0, 0.0), single_shot=True), Tag(at=(7.0, 0.0, 0.0))),
)
PEOPLE, TAGS = ROOM.people, tag_table(ROOM.tags)
ROBOT_SLOT = np.int32(0)


class Moment(NamedTuple):
    """What a robot is given at a time; of a course with an axis over moments."""

    time: Any
    state: Any
    hits: Any
    around: Any
    noise: Any = None


def around_at(time, people=PEOPLE, tags=TAGS):
    """The room, with a tag that was dropped."""
    pos = np.zeros((MAX_DROPPED_TAGS, 3), np.float32)
    pos[0] = 0.5, 0.3, 0.0
    dropped = DroppedTags(pos=pos, count=np.int32(1))
    return surroundings_at(people, tags, dropped, time, np.float32(0.0))


def met(origin, direction, around, rng):
    """Half of the rays end anywhere, a few of them at once, and those near the middle of a box end there."""
    lot, far = rng.random(len(origin)), rng.uniform(0.05, 8.0, len(origin))
    reach = np.select([lot < 0.04, lot < 0.5], [0.01, far], np.inf)
    for box in around.box_pos:
        t = ((box - origin) * direction).sum(-1)
        aside = np.linalg.norm(origin + t[:, None] * direction - box, axis=-1)
        reach = np.where((aside < 0.04) & (t > 0), np.minimum(reach, t), reach)
    return Hits(distance=np.float32(reach), cosine=np.float32(rng.uniform(0.0, 1.0, len(origin))))


def course_of(suite: Suite) -> Moment:
    """Four moments of a robot that wanders among victims, upright enough to have a yaw."""
    rng = np.random.default_rng(SEED)
    joints, moments = len(suite.plan.parts) - 1, []
    angle, turn, at = rng.uniform(-2, 2, joints), rng.uniform(-0.4, 0.4, 3), rng.uniform(-0.3, 0.3, 3)
    for time in TIMES:
        angle, turn = angle + rng.uniform(0, 0.4, joints), turn + rng.uniform(-0.1, 0.1, 3)
        at = at + rng.uniform(0, 0.1, 3)
        numbers = (at, quat_from_angles(*turn), np.zeros(3), np.zeros(3), angle, np.zeros(joints))
        names = ("pos", "quat", "linear", "angular", "joint_pos", "joint_vel")
        state = RobotState(**dict(zip(names, map(np.float32, numbers), strict=True)))
        with numpy_backend():
            around = around_at(time)
            rays = suite.rays(forward_kinematics(suite.plan, state), around)
        moments.append(Moment(time, state, met(*rays, around, rng), around))
    return jax.tree.map(lambda *rows: np.stack(rows), *moments)


def sensed(suite: Suite, moment: Moment) -> SensorInput:
    bodies = forward_kinematics(suite.plan, moment.state)
    given = dict(zip(("state", "hits", "surroundings", "noise_factor"), moment[1:], strict=True))
    clock = Clock(step=xp.round(moment.time / 0.02).astype(xp.int32), period=0.02)
    return SensorInput(clock=clock, bodies=bodies, **given)


def start(suite: Suite, moment: Moment):
    return suite.init_memory(sensed(suite, moment), random.key(SEED))


def look(suite: Suite, memory, moment: Moment, number):
    """One step of a course: the memory after it, and everything that came out."""
    inputs = sensed(suite, moment)
    memory, readings = suite.read(inputs, memory, random.fold_in(random.key(SEED), number))
    return memory, (inputs.bodies, suite.rays(inputs.bodies, moment.around), memory, readings)


def jax_results(suite: Suite, course: Moment):
    """The memory at the start, and results with an axis over moments; one compilation."""

    @partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
    def run(course):
        first = start(suite, jax.tree.map(lambda rows: rows[0], course))
        steps = jnp.arange(len(TIMES))
        return first, jax.lax.scan(lambda memory, now: look(suite, memory, *now), first, (course, steps))[1]

    return jax.device_get(run(course))


def numpy_results(suite: Suite, course: Moment):
    moments = [jax.tree.map(lambda rows, i=i: rows[i], course) for i in range(len(TIMES))]
    with numpy_backend():
        first = memory = start(suite, moments[0])
        results = []
        for i, moment in enumerate(moments):
            memory, result = look(suite, memory, moment, i)
            results.append(result)
    return first, jax.tree.map(lambda *rows: np.stack(rows), *results)


def assert_same(ours, theirs):
    assert jax.tree.structure(ours) == jax.tree.structure(theirs)
    for (path, one), other in zip(jax.tree.leaves_with_path(ours), jax.tree.leaves(theirs), strict=True):
        name = jax.tree_util.keystr(path)
        assert not isinstance(one, jax.Array), name
        assert one.dtype == other.dtype, name
        np.testing.assert_allclose(one, other, rtol=SHARE, atol=NEAR, err_msg=name)


@pytest.mark.every_run("Everything", "P2AT", "AirRobot", "Submarine")
@pytest.mark.oracle
@pytest.mark.parametrize("robot", list(classes()))
def test_a_class_reads_on_numpy_what_it_reads_on_jax(robot):
    suite = suite_of(robot)
    course = course_of(suite)
    ours, theirs = numpy_results(suite, course), jax_results(suite, course)
    assert_same(ours, theirs)
    for sensor, mine, other in zip(suite.sensors, ours[1][3], theirs[1][3], strict=True):
        np.testing.assert_array_equal(mine.fresh, other.fresh)
        intervals = (TIMES[-1] + 1e-3) / max(sensor.settings[0].scan_interval, 0.2)
        assert mine.fresh.sum() == (0 if sensor.on_command else 1 + int(intervals)), sensor.kind


@pytest.mark.oracle
def test_more_noise_is_as_much_more_on_numpy():
    """Of a robot whose noise varies (`SensorInput.noise_factor`)."""
    kinds = ("Sonar", "IRScanner", "INS", "Odometry", "GPS", "Encoder")
    sensors = tuple(mount for mount in EVERYTHING.sensors if mount.kind in kinds)
    suite = suite_of(replace(EVERYTHING, name="Shaky", sensors=sensors))
    course = course_of(suite)
    shaken = course._replace(noise=np.full(len(TIMES), 1.7, np.float32))
    ours, plain = numpy_results(suite, shaken), numpy_results(suite, course)
    assert_same(ours, jax_results(suite, shaken))
    same = [
        sensor.mounts[0].name
        for sensor, mine, other in zip(suite.sensors, ours[1][3], plain[1][3], strict=True)
        if (mine.value == other.value).all()
    ]
    assert same == ["INS1"], "the one without any"


def test_the_course_shows_the_sensors_something():
    """Else the comparison would be one of zeros."""
    suite = suite_of(EVERYTHING)
    readings = numpy_results(suite, course_of(suite))[1][3]
    values = {sensor.mounts[0].name: one.value for sensor, one in zip(suite.sensors, readings, strict=True)}
    assert values["VictSensor0"][..., 0].any(), "a part of a victim is met"
    assert values["HumanMotion0"].any()
    assert values["Sound0"][:, 0].all()
    assert values["CO2Sensor0"].all()
    assert (values["GPS0"][:, 2] >= 4).any(), "a position"
    assert all(values[f"RFID{i}"][..., 0].any() for i in range(3))
    assert 0 < values["Touch0"].mean() < 1
    assert values["Odometry0"][2:].all()


@pytest.mark.oracle
def test_surroundings_on_numpy_are_those_on_jax():
    with numpy_backend():
        ours = around_at(np.float32(3.7))
    theirs = jax.jit(around_at)(np.float32(3.7), PEOPLE, TAGS)
    assert_same(ours, jax.device_get(theirs))


COMMANDS = (
    ("RangeScanner", "RangeScanner1", "SCAN", ()),
    ("RangeScanner", "RangeScanner1", "RESET", ()),
    ("Odometry", "Odometry0", "RESET", ()),
    ("Encoder", "Encoder0", "RESET", ()),
    ("INS", "INS0", "POSE", (1.0, -2.0, 0.5, 0.1, -0.2, 3.0)),
    ("INS", "INS0", "POSE", (1.0,)),
    ("RFID", "RFID0", "Read", (1001.0,)),
    ("RFID", "RFID0", "Read", (999.0,)),
    ("GPS", "GPS0", "RESET", ()),
)


@pytest.mark.oracle
def test_commands_change_on_numpy_what_they_change_on_jax():
    suite = suite_of(EVERYTHING)
    course = course_of(suite)
    _, results = numpy_results(suite, course)
    bodies, _, memories, _ = jax.tree.map(lambda rows: rows[-1], results)
    last = jax.tree.map(lambda rows: rows[-1], course)
    inputs = sensed(suite, last).replace(bodies=bodies)
    answers = []
    for kind, name, opcode, params in COMMANDS:
        place = suite.find(kind, name)
        with numpy_backend():
            ours = suite.handle_set(place, opcode, params, inputs, memories)
        theirs = suite.handle_set(place, opcode, params, *jax.tree.map(jnp.asarray, (inputs, memories)))
        answers.append(ours is not None)
        assert_same(ours, jax.device_get(theirs))
    assert answers == [True, False, True, True, True, False, True, False, False]


# --- nothing is traced ------------------------------------------------------------------------


def test_nothing_is_traced_or_compiled_and_no_array_of_jax_is_made():
    robot = replace(EVERYTHING, name="Unseen", sensors=EVERYTHING.sensors[::-1])
    # A guard against arrays of JAX too: what it has compiled before would be no event.
    with compilations() as events, jax.transfer_guard("disallow_explicit"), numpy_backend():
        suite = suite_of(robot)
        course = course_of(suite)
        numpy_results(suite, course)
        moment = jax.tree.map(lambda rows: rows[0], course)
        memory, inputs = start(suite, moment), sensed(suite, moment)
        suite.hits(
            lambda *rays: met(*rays[:2], moment.around, np.random.default_rng(0)), inputs.bodies, ROBOT_SLOT
        )
        for kind, name, opcode, params in COMMANDS:
            suite.handle_set(suite.find(kind, name), opcode, params, inputs, memory)
    assert events == []
    with compilations() as events:
        jax.jit(lambda x: x + len(events))(1.0)
    assert {event.rsplit("/", 1)[1] for event in events} >= {
        "jaxpr_trace_duration",
        "backend_compile_duration",
    }


# --- rays ---------------------------------------------------------------------------------------


def test_a_caster_of_ones_own_is_asked_for_the_rays_of_sensors_that_are_due_only():
    suite = suite_of(EVERYTHING)
    moment = jax.tree.map(lambda rows: rows[0], course_of(suite))
    asked: list[tuple[RayQuery, int]] = []

    def cast(origin, direction, query, fans):
        asked.append((query, len(origin)))
        if fans is not None:
            np.testing.assert_array_equal(fans.rays()[1], direction)
        return Hits(
            distance=np.full(len(origin), len(asked), np.float32), cosine=np.ones(len(origin), np.float32)
        )

    due = np.arange(len(suite.sensors)) % 2 == 0
    with numpy_backend():
        bodies = forward_kinematics(suite.plan, moment.state)
        hits = suite.hits(cast, bodies, ROBOT_SLOT, due, moment.around)
        aimed = np.split(suite.rays(bodies, moment.around)[1].any(-1), np.cumsum(suite.ray_counts)[:-1])
    assert any(0 < rays.sum() < len(rays) for rays in aimed), (
        "some aim at what is near, of more that could be"
    )
    casting = [i for i, rays in enumerate(aimed) if due[i] and rays.any()]
    assert [n for _, n in asked] == [aimed[i].sum() for i in casting]
    assert [q.max_distance for q, _ in asked] == [suite.sensors[i].max_distance for i in casting]
    assert len(hits.distance) == len(hits.cosine) == sum(suite.ray_counts)
    expected = []
    for i, rays in enumerate(aimed):
        turn = casting.index(i) + 1 if i in casting else np.inf
        expected += list(np.where(rays, turn, np.inf))
    np.testing.assert_array_equal(hits.distance, expected)
    np.testing.assert_array_equal(hits.cosine, np.isfinite(expected))


# --- several robots at once ---------------------------------------------------------------------


def test_several_robots_read_and_look_at_once_as_each_would_alone():
    suite = suite_of(EVERYTHING)
    course = course_of(suite)
    with numpy_backend():
        around = around_at(np.float32(TIMES[-1]))
    slots = np.arange(len(TIMES), dtype=np.int32)

    def cast(origin, direction, query, fans):
        assert fans is None
        return met(origin, direction, around, np.random.default_rng(int(query.exclude_owner)))

    with numpy_backend():
        keys = random.fold_in(random.key(SEED), slots)
        moments = [jax.tree.map(lambda rows, i=i: rows[i], course) for i in slots]
        memories = [start(suite, moment) for moment in moments]
        # Each has other sensors that are not due yet.
        turns = [np.arange(len(suite.sensors)) % (i + 1) == 0 for i in slots]
        memories = [
            memory.replace(due=np.where(turn, 0.0, TIMES[-1] + 1).astype(np.float32))
            for memory, turn in zip(memories, turns, strict=True)
        ]
        now = [moment._replace(time=np.float32(TIMES[-1]), around=around) for moment in moments]
        inputs = [sensed(suite, moment) for moment in now]
        alone = [
            (suite.hits(cast, one.bodies, slot, turn, around), suite.read(one, memory, key))
            for one, slot, turn, memory, key in zip(inputs, slots, turns, memories, keys, strict=True)
        ]
        own = [{name: getattr(one, name) for name in ROBOT_FIELDS} for one in inputs]
        team = inputs[0].replace(**jax.tree.map(lambda *rows: np.stack(rows), *own))
        memory = jax.tree.map(lambda *rows: np.stack(rows), *memories)
        together = (
            suite.hits(cast, team.bodies, slots, np.stack(turns), around),
            suite.read(team, memory, keys),
        )
    expected = jax.tree.map(lambda *rows: np.stack(rows), *alone)
    assert jax.tree.structure(together) == jax.tree.structure(expected)
    jax.tree.map(np.testing.assert_array_equal, together, expected)
    kinds = {sensor.kind for sensor in suite.sensors if is_vectorized(sensor.read)}
    assert kinds >= {"Sonar", "IR", "RangeScanner", "Odometry", "INS", "Encoder", "GroundTruth", "RFID"}
