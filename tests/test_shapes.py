"""The docstrings' shapes against a built world: `name: Meaning [unit] (dims).` must be what is there."""

import inspect
import re
from functools import partial

import jax
import jax.numpy as jnp
import pytest

from usarmjx.engines.base import Inputs, PhysicsState
from usarmjx.models.build.body_plan import BodyPoses, forward_kinematics, kinematic_tree_of
from usarmjx.models.drives.state import RobotState
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.sensors.base import Reading, SensorInput
from usarmjx.sensors.motion import InsMemory
from usarmjx.sensors.rays.raycast import Hits, cast_rays
from usarmjx.sensors.rays.targets import GeomBlock, make_geoms
from usarmjx.sensors.suite import SensorMemory
from usarmjx.sim.batch import Batch
from usarmjx.sim.control import ActuatorInputs, DriveConditions, RobotCommand, compute_actuation, idle_command
from usarmjx.sim.scene import build_scene
from usarmjx.sim.world import (
    FaultCounts,
    GroupState,
    World,
    compute_inputs,
    observe,
    robot_states,
    sense,
    time_of,
)

ROBOTS, WORLDS = 2, 3
JOINTS, BODIES, SENSORS = 6, 7, 6  # of a P2AT: four wheels, two links; plus the chassis
DIMS = re.compile(r"\((\.\.\.|[\w., ]*)\)$")


def documented(kind: type) -> dict[str, str | None]:
    """The dims of each attribute, None where it has none, by the class docstring."""
    doc = inspect.getdoc(kind) or ""
    summary, _, attributes = doc.partition("Attributes:")
    entries = re.split(r"\n {4}(?=\w+: )", attributes)
    dims: dict[str, str | None] = {}
    for entry in filter(str.strip, entries):
        name, _, text = " ".join(entry.split()).partition(": ")
        found = DIMS.search(re.sub(r"\.$|(?<=\)); [^()]*$", "", text.rstrip(".")))
        dims[name] = found and found.group(1)
    common = DIMS.search(summary.strip().splitlines()[0].rstrip("."))
    shared = common and common.group(1)
    return {name: shared if found is None else found for name, found in dims.items()}


def is_array(value) -> bool:
    return hasattr(value, "shape") and hasattr(value, "dtype")


def check(node, lead: tuple[int, ...], known: dict[str, int]) -> None:
    """Compare every array of a node with its docstring; `lead` are axes that the node's holder added."""
    dims = documented(type(node))
    assert set(dims) == set(vars(node)), f"{type(node).__name__}: documented are {sorted(dims)}"
    sizes = dict(known)
    for name, value in vars(node).items():
        where = f"{type(node).__name__}.{name}"
        if not is_array(value):
            assert dims[name] is None, f"{where} is no array, but has dims ({dims[name]})"
            continue
        assert dims[name] is not None, f"{where} has no dims; it is {value.shape}"
        assert value.shape[: len(lead)] == lead, f"{where}: leading axes"
        shape = value.shape[len(lead) :]
        words = [word.strip() for word in dims[name].split(",") if word.strip()]
        if words[-1:] == ["..."]:
            words, shape = words[:-1], shape[: len(words) - 1]
        assert len(words) == len(shape), f"{where}: ({dims[name]}) is {shape}"
        for word, size in zip(words, shape, strict=True):
            expected = int(word) if word.isdecimal() else sizes.setdefault(word, size)
            assert size == expected, f"{where}: ({dims[name]}) is {shape}, with {sizes}"


@pytest.fixture(scope="module")
def scene():
    return build_scene("yellow", ["P2AT"] * ROBOTS)


@pytest.fixture(scope="module")
def built(scene):
    """A world and what is made from it; traced, not compiled: shapes are the same."""
    batch = Batch(scene, WORLDS, engine="c")
    state = jax.eval_shape(batch._init, batch._keys, batch._numbers, None)[0]
    world = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), state)
    physics = PhysicsState(
        qpos=jax.ShapeDtypeStruct((scene.model.nq,), jnp.float32),
        qvel=jax.ShapeDtypeStruct((scene.model.nv,), jnp.float32),
        act=jax.ShapeDtypeStruct((scene.model.na,), jnp.float32),
    )
    return batch, world, physics


def test_the_physics_of_a_real_batch(scene, built):
    batch, _, _ = built
    model = scene.model
    sizes = {"worlds": WORLDS, "nq": model.nq, "nv": model.nv, "na": model.na}
    check(batch.engine.state(batch.engine.start()), (), sizes)


def test_world_team_and_status(scene, built):
    _, world, _ = built
    check(world, (), {})
    check(world.faults, (), {})
    (group,) = world.groups
    assert isinstance(world, World)
    assert isinstance(group, GroupState)
    assert isinstance(world.faults, FaultCounts)
    check(group, (), {"n": ROBOTS})
    check(group.command, (ROBOTS,), {"joints": JOINTS, "keys": 2})
    check(group.memory, (ROBOTS,), {"sensors": SENSORS})
    assert isinstance(group.command, RobotCommand)
    assert isinstance(group.memory, SensorMemory)


def test_robot_state_bodies_and_sight(scene, built):
    _, world, physics = built
    (group,) = scene.groups
    states = jax.eval_shape(partial(robot_states, group), physics)
    assert isinstance(states, RobotState)
    check(states, (ROBOTS,), {"joints": JOINTS})
    one = jax.eval_shape(lambda p: jax.tree.map(lambda x: x[0], robot_states(group, p)), physics)
    bodies = jax.eval_shape(partial(forward_kinematics, group.plan), one)
    assert isinstance(bodies, BodyPoses)
    check(bodies, (), {"bodies": BODIES})
    (sensor_input,) = jax.eval_shape(partial(sense, scene), world, physics)
    assert isinstance(sensor_input, SensorInput)
    assert sensor_input.time.shape == jax.eval_shape(partial(time_of, scene), world).shape == ()
    check(sensor_input.bodies, (ROBOTS,), {"bodies": BODIES})
    check(sensor_input.hits, (ROBOTS,), {"rays": sum(group.suite.ray_counts)})


def test_readings_and_memories(scene, built):
    _, world, physics = built
    after, (readings,) = jax.eval_shape(partial(observe, scene), world, physics)
    assert len(readings) == SENSORS
    for reading in readings:
        assert isinstance(reading, Reading)
        check(reading, (ROBOTS,), {})
    expected = {"Sonar": (16,), "RangeScanner": (181,), "Odometry": (3,), "INS": (6,), "GroundTruth": (6,)}
    expected["RFID"] = (16, 5)
    for sensor, reading in zip(scene.groups[0].suite.sensors, readings, strict=True):
        assert reading.value.shape == (ROBOTS, *expected[sensor.kind])
    ins = after.groups[0].memory.own[scene.groups[0].suite.index("INS")]
    assert isinstance(ins, InsMemory)
    check(ins, (ROBOTS,), {})


def test_what_the_engine_is_told(scene, built):
    _, world, physics = built
    _, inputs = jax.eval_shape(partial(compute_inputs, scene), world, physics)
    assert isinstance(inputs, Inputs)
    model = scene.model
    sizes = {"nu": model.nu, "na": model.na, "nbody": model.nbody, "nq": model.nq, "nv": model.nv}
    batched = jax.tree.map(lambda x: jax.ShapeDtypeStruct((WORLDS, *x.shape), x.dtype), inputs)
    check(batched, (), {"worlds": WORLDS, **sizes})


def test_a_robots_drive():
    plan = kinematic_tree_of(P2AT)
    state = RobotState(
        pos=jnp.zeros(3),
        quat=jnp.array([1.0, 0, 0, 0]),
        linear=jnp.zeros(3),
        angular=jnp.zeros(3),
        joint_pos=jnp.zeros(JOINTS),
        joint_vel=jnp.zeros(JOINTS),
    )
    now = DriveConditions(time=jnp.zeros(()), powered=jnp.ones((), bool), depth=jnp.zeros(()))
    told = jax.eval_shape(
        lambda s: compute_actuation(plan, idle_command(P2AT), s, jnp.zeros(JOINTS), now, 0.02), state
    )
    assert isinstance(told, ActuatorInputs)
    check(told, (), {"actuators": JOINTS})


def test_blocks_and_hits(scene):
    geoms, n = scene.fixed_geoms, len(scene.fixed_geoms.kind)
    sorted_geoms = make_geoms(geoms.kind, geoms.pos, geoms.mat, geoms.size, jnp.zeros(n))
    assert sum(len(block.pos) for block in sorted_geoms.blocks) == n
    for block in sorted_geoms.blocks:
        assert isinstance(block, GeomBlock)
        check(block, (), {})
    rays = jnp.ones((5, 3))
    hits = jax.eval_shape(cast_rays, sorted_geoms, rays, rays, jnp.int32(0))
    assert isinstance(hits, Hits)
    check(hits, (), {"rays": 5})


def test_a_stale_docstring_is_noticed():
    class Stale:
        """Something.

        Attributes:
            one: A thing [m] (things, 3).
            two: Another, which takes
                two lines (things,).
            many: Not an array.
        """

    assert documented(Stale) == {"one": "things, 3", "two": "things,", "many": None}
    good = {"one": jnp.zeros((4, 3)), "two": jnp.zeros(4), "many": ()}
    node = Stale()
    vars(node).update(good)
    check(node, (), {})
    for name, wrong in (("two", jnp.zeros(5)), ("one", jnp.zeros((4, 2))), ("many", jnp.zeros(1))):
        vars(node).update(good | {name: wrong})
        with pytest.raises(AssertionError, match=f"Stale.{name}"):
            check(node, (), {})
