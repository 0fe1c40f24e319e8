"""Every sensor in a batch, on every engine: a world alone reads what it reads among others."""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.engines import make_engine
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots.pioneer import ENCODER_AXIS, P2DX
from usarmjx.models.types.arena import ArenaSpec, FalseAlarm, SegmentMotion, StartPose, Tag, Victim
from usarmjx.models.types.robot import Mount, options
from usarmjx.models.types.shapes import GLASS, Shape
from usarmjx.sensors.base import SENSORS
from usarmjx.sim.control import set_drive
from usarmjx.sim.reset import init_world
from usarmjx.sim.scene import build_scene
from usarmjx.sim.world import compute_inputs, observe

WALL = Shape(kind="box", size=(0.1, 4.0, 1.0), at=(3.0, 0.0, 1.0), surface="wall")
PANE = Shape(kind="box", size=(0.02, 1.0, 1.0), at=(2.0, 0.0, 1.0), surface="wall", material=GLASS)
WAVING = Victim(
    name="Ada",
    at=(0.5, 1.2, 0.12),
    posture="sitting",
    segments=(SegmentMotion(name="LeftArm", final=(0.0, 0.0, 1.2), rates=(0.0, 0.0, 1.0)),),
)
ARENA = ArenaSpec(
    name="ward",
    starts=tuple(StartPose(tag=f"S{i}", at=(0.1 * i, 0.0, 0.188), yaw=0.7 - 0.1 * i) for i in range(3)),
    extent=((-4, 4), (-4, 4)),
    shapes=(WALL, PANE),
    victims=(WAVING,),
    false_alarms=(FalseAlarm(part="RightLeg", at=(2.0, 1.5, 0.1)),),
    tags=(Tag(at=(1.0, 0.0, 0.0)), Tag(at=(-1.0, 1.0, 0.0))),
)
AHEAD = (0.1, 0.0, -0.1)
KEYS = {
    "RangeScanner": options(Resolution=0.1, MaxRange=20.0, Noise=0.05),
    "IRScanner": options(Resolution=0.1, MaxRange=20.0, Sigma=0.05),
    "RangeScanner3D": options(VerticalResolution=0.2, HorizontalResolution=0.2),
    "Kinect": options(VerticalResolution=0.01, HorizontalResolution=0.1),
    "INS": options(Drifting=True, Precision=10.0),
    "Odometry": options(LeftTire="", RightTire="", EncoderResolution=0.001),
    "Encoder": options(Resolution=0.001),
    "VictSensor": options(HorizontalStep=0.2, VerticalStep=0.2),
}
ROBOT = replace(
    P2DX,
    name="EverySensor",
    cameras=(),
    sensors=tuple(
        Mount(
            kind=kind,
            name=kind,
            parent=P2DX.wheels[0].name if kind == "Encoder" else "HARD",
            at=AHEAD,
            direction=ENCODER_AXIS if kind == "Encoder" else (0.0, 0.0, 0.0),
            options=KEYS.get(kind, ()),
        )
        for kind, _ in SENSORS
    ),
)
ENGINES = ("c", pytest.param("jax", marks=pytest.mark.slow), "warp")
WORLDS, STEPS = 3, 5
SPEEDS = jnp.array([[1.0], [2.0], [3.0]])  # rad/s of the left wheel of each world's robot
SCENE = build_scene(ARENA, [ROBOT], Physics(iterations=30, ls_iterations=20))
KINDS = tuple(sensor.kind for sensor in SCENE.groups[0].suite.sensors)
ALONE = 2e-5  # m and rad; as a share of ranges and counts: sums in another order in other batch sizes
# Engines place the robot within 2e-4 m and rad of each other after 0.1 s (`GroundTruth`). A beam that meets
# a wall askew, or an edge, makes more of it: of every sensor all but a few numbers are within ...
APART, FEW = 5e-3, 0.05


def quick_jit(function):
    """Without XLA's optimiser, which would take longer than it saves."""
    options = {"xla_backend_optimization_level": 0}
    return jax.jit(jax.default_matmul_precision("highest")(function), compiler_options=options)


FIRST = quick_jit(jax.vmap(partial(init_world, SCENE)))
CONTROL = quick_jit(jax.vmap(partial(compute_inputs, SCENE)))
OBSERVE = quick_jit(jax.vmap(partial(observe, SCENE)))


@cache
def driven(kind):
    """Worlds on an engine after 0.1 s of driving a curve, and what their physics is then."""
    engine = make_engine(kind, SCENE.spec, SCENE.physics, WORLDS, SCENE.moved_geoms, SCENE.varied_bodies)
    advance = jax.jit(engine.advance) if engine.traceable else engine.advance
    numbers = jnp.arange(WORLDS)
    worlds, qpos = FIRST(jax.vmap(partial(jax.random.fold_in, jax.random.key(5)))(numbers), numbers)
    team = worlds.groups[0]
    told = set_drive(ROBOT, team.command, {"Left": SPEEDS, "Right": jnp.ones((WORLDS, 1))})
    worlds = worlds.replace(groups=(team.replace(command=told),))
    own = engine.reset(engine.start(), jnp.ones(WORLDS, bool), qpos)
    for _ in range(STEPS):
        worlds, inputs = CONTROL(worlds, engine.state(own))
        own = advance(own, inputs)
        worlds = worlds.replace(step=worlds.step + 1)
    physics = jax.tree.map(jnp.asarray, engine.state(own))
    memory = worlds.groups[0].memory
    due_now = worlds.groups[0].replace(memory=memory.replace(due=0 * memory.due))
    return worlds.replace(groups=(due_now,)), physics


@cache
def readings(kind):
    """What all worlds read (worlds, ...), by sensor."""
    _, (told,) = OBSERVE(*driven(kind))
    return {name: np.asarray(reading.value)[:, 0] for name, reading in zip(KINDS, told, strict=True)}


@pytest.mark.thorough
def test_the_robot_has_every_sensor_and_each_has_something_to_say():
    assert set(KINDS) == {kind for kind, _ in SENSORS}
    silent = {name for name, value in readings("c").items() if not np.any(value)}
    assert silent <= {"Touch", "Sound", "HumanMotion", "MissionTime", "Kinect"}, (
        "nothing to feel or hear, no minute yet, and no SCAN"
    )


@pytest.mark.thorough
@pytest.mark.parametrize("engine", ENGINES)
def test_every_sensor_reads_alone_what_it_reads_in_a_batch(engine):
    last = jax.tree.map(lambda x: x[-1:], driven(engine))
    _, (told,) = OBSERVE(*last)
    together = readings(engine)
    for name, reading in zip(KINDS, told, strict=True):
        alone = np.asarray(reading.value)[0, 0]
        np.testing.assert_allclose(alone, together[name][-1], atol=ALONE, rtol=ALONE, err_msg=name)


@pytest.mark.thorough
def test_worlds_of_a_batch_read_their_own():
    for name in ("GroundTruth", "RangeScanner", "Odometry", "INS", "GPS"):
        value = readings("c")[name]
        assert np.any(value[0] != value[1]), name


@pytest.mark.thorough
@pytest.mark.parametrize("engine", [pytest.param("jax", marks=pytest.mark.slow), "warp"])
def test_every_sensor_reads_on_every_engine_what_it_reads_on_c_mujoco(engine):
    if engine == "warp":
        pytest.importorskip("warp", reason="needs warp-lang")
    mine, reference = readings(engine), readings("c")
    np.testing.assert_allclose(mine["GroundTruth"], reference["GroundTruth"], atol=2e-4)
    for name in KINDS:
        close = np.isclose(mine[name], reference[name], atol=APART, rtol=APART)
        assert (~close).mean() <= FEW, name
