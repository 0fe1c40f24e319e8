"""The docstrings' shapes against a built world: `name: Meaning [unit] (dims).` must be what is there."""

import ast
import inspect
import re
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest
from flax.struct import PyTreeNode

from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.mail import MessageSettings
from usarmjx.engines.base import Inputs, PhysicsState
from usarmjx.models.compile.kinematic_tree import BodyPoses, forward_kinematics, kinematic_tree_of
from usarmjx.models.compile.randomization import DomainRandomization
from usarmjx.models.drives.base import RobotState
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import ArenaSpec, Light, LooseObject, StartPose, Tag, Victim
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.base import Reading, SensorInput
from usarmjx.sensors.motion import InsMemory
from usarmjx.sensors.rays.raycast import Hits, cast_rays
from usarmjx.sensors.rays.targets import GeomBlock, make_geoms
from usarmjx.sim.batch import Batch, BatchState
from usarmjx.sim.control import ActuatorInputs, DriveConditions, compute_actuation, idle_command
from usarmjx.sim.scene import build_scene
from usarmjx.sim.world import compute_inputs, observe, robot_states, sense

ROBOTS, WORLDS = 2, 3
JOINTS, BODIES, SENSORS = 6, 7, 6  # of a P2AT: four wheels, two links; plus the chassis
PACKAGES = ("sim", "sensors", "comms", "cameras", "engines", "train")
ARRAY = re.compile(r"^(?!tuple|dict|Mapping|Callable).*\b(Array|ArrayLike|ndarray|Key)\b")
DIMS = re.compile(r"\((\.\.\.|[\w., ]*)\)$")


def documented(doc: str) -> dict[str, str | None]:
    """The dims of each attribute, None where it has none, by a class docstring."""
    summary, _, attributes = inspect.cleandoc(doc).partition("Attributes:")
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


def nodes_in(value) -> list:
    """The nodes that a field holds, itself or in tuples."""
    if isinstance(value, PyTreeNode) or hasattr(value, "_asdict"):
        return [value]
    return [node for one in value for node in nodes_in(one)] if isinstance(value, tuple) else []


def fields_of(node) -> dict:
    return node._asdict() if hasattr(node, "_asdict") else vars(node)


def check(node, lead: tuple[int, ...], known: dict[str, int]) -> set[str]:
    """Compare every array of a node with its docstring, and of the nodes that it holds; return their names.

    `lead` are axes that the node's holder added. A holder says so by dims that end with `...`: those before
    it are added to all arrays of what the field holds.
    """
    dims, sizes, met = documented(type(node).__doc__), dict(known), {type(node).__name__}
    assert set(dims) == set(fields_of(node)), f"{type(node).__name__}: documented are {sorted(dims)}"
    for name, value in fields_of(node).items():
        where = f"{type(node).__name__}.{name}"
        words = [word.strip() for word in (dims[name] or "").split(",") if word.strip()]
        if is_array(value):
            assert dims[name] is not None, f"{where} has no dims; it is {value.shape}"
            assert value.shape[: len(lead)] == lead, f"{where}: leading axes {lead}, it is {value.shape}"
            shape = value.shape[len(lead) :]
            if words[-1:] == ["..."]:
                words, shape = words[:-1], shape[: len(words) - 1]
            assert len(words) == len(shape), f"{where}: ({dims[name]}) is {shape}"
            for word, size in zip(words, shape, strict=True):
                expected = int(word) if word.isdecimal() else sizes.setdefault(word, size)
                assert size == expected, f"{where}: ({dims[name]}) is {shape}, with {sizes}"
        elif value is not None:
            held = nodes_in(value)
            whole = not words or (words[-1] == "..." and held)
            assert whole, f"{where} is no array, but has dims ({dims[name]})"
            for inner in held:
                first = jax.tree.leaves(inner)[0].shape[len(lead) :] if words else ()
                more = tuple(known.get(word, size) for word, size in zip(words[:-1], first, strict=False))
                met |= check(inner, (*lead, *more), known)
    return met


@pytest.fixture(scope="module")
def scene():
    return build_scene("yellow", ["P2AT"] * ROBOTS)


@pytest.fixture(scope="module")
def built(scene):
    """A world and what is made from it; traced, not compiled: shapes are the same."""
    batch = Batch(scene, WORLDS, engine="c")
    state = jax.eval_shape(batch._init, batch._keys_of(0), batch._numbers, None)[0]
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


SIZES = {"joints": JOINTS, "keys": 2, "sensors": SENSORS, "effecters": 0, "cameras": 1}
WORLD_NODES = {"BatchState", "World", "ArenaState", "VictimTable", "TagTable", "DroppedTags", "FaultCounts"}
GROUP_NODES = {"GroupState", "RobotCommand", "CommandHistory", "SensorMemory", "RandomizedValues"}
RADIO_NODES = {"Links", "Inboxes", "DropCounts"}


def test_the_world_of_a_plain_scene(built):
    _, world, _ = built
    met = check(world, (), {"robots": ROBOTS, **SIZES})
    assert met >= {"World", "GroupState", "RobotCommand", "SensorMemory", "FaultCounts"}


def test_a_batch_with_all_that_a_scene_can_have():
    """Several arenas, a radio with mail, and domain randomisation with latency."""
    wall = Shape(kind="box", size=(0.1, 0.5, 0.5), at=(3.0, 0.0, 0.5))
    lamp = Light(at=(0.0, 0.0, 2.0))
    block = Shape(kind="box", size=(0.1, 0.1, 0.1), mass=1.0)
    brick = LooseObject(name="brick", at=(2.0, 2.0, 0.1), shapes=(block,))
    starts = tuple(StartPose(tag=f"S{i}", at=(0.0, i, 0.188), yaw=0.0) for i in range(ROBOTS))
    parts = {"victims": (Victim(name="V", at=(4.0, 0.0, 0.0)),), "tags": (Tag(at=(1.0, 1.0, 0.0)),)}
    parts |= {"loose": (brick,), "lights": (lamp,)}
    arenas = [
        ArenaSpec(name=n, extent=((-5, 5), (-5, 5)), starts=starts, shapes=(wall,), **parts) for n in "ab"
    ]
    vary = DomainRandomization(mass=(0.9, 1.1), latency=(0, 3), radio_pdo=(-50.0, -40.0))
    options = {"radio": RadioSettings(), "mail": MessageSettings(numbers=5, capacity=7), "vary": vary}
    scene = build_scene(arenas, ["P2AT"] * ROBOTS, **options)
    batch = Batch(scene, WORLDS, engine="c")
    worlds = jax.eval_shape(batch._init, batch._keys_of(0), batch._numbers, scene.arenas.states)[0]
    state = BatchState(physics=None, worlds=worlds, arenas=scene.arenas.states)
    sizes = {"worlds": WORLDS, "arenas": 2, "robots": ROBOTS, "steps": 3, **SIZES}
    met = check(state, (), {**sizes, "numbers": 5, "capacity": 7})
    assert met >= WORLD_NODES | GROUP_NODES | RADIO_NODES


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
    assert sensor_input.clock.step.shape == ()
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
    now = DriveConditions(step=jnp.zeros((), jnp.int32), powered=jnp.ones((), bool), depth=jnp.zeros(()))
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
    hits = jax.eval_shape(cast_rays, sorted_geoms, rays, rays)
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

    assert documented(Stale.__doc__) == {"one": "things, 3", "two": "things,", "many": None}
    good = {"one": jnp.zeros((4, 3)), "two": jnp.zeros(4), "many": ()}
    node = Stale()
    vars(node).update(good)
    check(node, (), {})
    for name, wrong in (("two", jnp.zeros(5)), ("one", jnp.zeros((4, 2))), ("many", jnp.zeros(1))):
        vars(node).update(good | {name: wrong})
        with pytest.raises(AssertionError, match=f"Stale.{name}"):
            check(node, (), {})


def state_classes() -> dict[str, tuple[str, ast.ClassDef]]:
    """PyTreeNodes and NamedTuples of the packages that compute, by name: module and source."""
    found, bases = {}, {"PyTreeNode", "NamedTuple"}
    trees = [(path, ast.parse(path.read_text())) for path in sorted(Path("usarmjx").rglob("*.py"))]
    parsed = [(path, node) for path, tree in trees for node in ast.walk(tree)]
    classes = [(path, node) for path, node in parsed if isinstance(node, ast.ClassDef)]
    while True:
        more = [
            (path, node)
            for path, node in classes
            if node.name not in found and any(ast.unparse(b).split(".")[-1] in bases for b in node.bases)
        ]
        if not more:
            return {name: one for name, one in found.items() if one[0].split("/")[1] in PACKAGES}
        found |= {node.name: (str(path), node) for path, node in more}
        bases |= {node.name for _, node in more}


def test_every_array_of_a_state_class_has_its_shape_in_the_docstring():
    missing = []
    for name, (path, node) in state_classes().items():
        dims = documented(ast.get_docstring(node) or "")
        fields = [field for field in node.body if isinstance(field, ast.AnnAssign)]
        arrays = [f.target.id for f in fields if ARRAY.search(ast.unparse(f.annotation))]
        missing += [f"{path}: {name}.{field}" for field in arrays if dims.get(field) is None]
    assert not missing, f"no (shape) in the docstring of {len(missing)}:\n" + "\n".join(missing)
