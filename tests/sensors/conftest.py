"""A bench for sensors: one robot with every variant of every sensor, compiled once."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from usarmjx.base.clock import clock_at
from usarmjx.base.transforms import mat_from_angles, quat_from_angles
from usarmjx.models.compile.kinematic_tree import forward_kinematics, kinematic_tree_of
from usarmjx.models.drives.base import RobotState
from usarmjx.models.robots.pioneer import ENCODER_AXIS, P2AT, P2AT_SCANNER
from usarmjx.models.types.robot import Mount, RobotSpec, options
from usarmjx.sensors.base import SensorInput
from usarmjx.sensors.rays.targets import PADDING_DISTANCE, make_geoms
from usarmjx.sensors.suite import SensorMemory, Suite, suite_of

BOXES, POSTS = 6, 2
AHEAD = (0.24, 0.0, 0.0)
LEFTWARD = (0.0, 0.0, -np.pi / 2)
UPWARD = (0.0, np.pi / 2, 0.0)
CURVE = ((0.0, 0.0), (2.0, 1.0), (4.0, 5.0))


def sonar(name: str, **keys: object) -> Mount:
    """One that is deaf to the floor, by default."""
    return Mount(kind="Sonar", name=name, at=AHEAD, options=options(**{"MaxIncidence": 1.309} | keys))


def scanner(name: str, **keys: object) -> Mount:
    base = dict(MaxRange=20.0, Resolution=np.pi / 180, ScanFov=np.pi)
    return Mount(kind="RangeScanner", name=name, at=P2AT_SCANNER, options=options(**base | keys))


def encoder(name: str, parent: str, direction: tuple, **keys: object) -> Mount:
    return Mount(kind="Encoder", name=name, parent=parent, direction=direction, options=options(**keys))


# Rear wheels further out than the front ones, so that left-most is not simply the first.
PARTS = tuple(replace(w, at=(w.at[0], w.at[1] * 1.3, w.at[2])) if w.at[0] < 0 else w for w in P2AT.parts)
BENCH = replace(
    P2AT,
    name="Bench",
    parts=PARTS,
    sensors=(
        *(m for m in P2AT.sensors if m.kind == "Sonar"),
        sonar("Clean", Noise=0.0),
        sonar("Noisy", Noise=0.3, MinRange=1.0, MaxRange=3.0),
        sonar("Curved", Noise=0.0, OutputCurve=CURVE),
        Mount(kind="Sonar", name="Keen", at=AHEAD, options=options(Noise=0.0)),
        scanner("Clean", ScanInterval=0.5),
        scanner("Tilted", bYaw=False, bPitch=True, ScanInterval=0.02),
        scanner("Manual", ScanInterval=0.0),
        scanner("Noisy", Noise=0.1, MinRange=1.0, MaxRange=3.0, ScanInterval=0.02),
        Mount(kind="Odometry", name="Timed"),
        Mount(kind="Odometry", name="Odometry", options=options(ScanInterval=0.0)),
        Mount(
            kind="Odometry",
            name="Widest",
            options=options(ScanInterval=0.0, LeftTire="", RightTire=""),
        ),
        Mount(kind="INS", name="Quiet", options=options(ScanInterval=0.0, Sigma=0.0)),
        Mount(kind="INS", name="Loud", options=options(ScanInterval=0.0, Sigma=0.3, Mean=0.05)),
        Mount(
            kind="INS",
            name="Drifter",
            options=options(ScanInterval=0.0, Sigma=0.0, Drifting=True, Precision=10.0),
        ),
        encoder("Right", "LeftFWheel", ENCODER_AXIS, Noise=0.0),
        encoder("Left", "LeftFWheel", LEFTWARD, Noise=0.0),
        encoder("Pan", "CameraPanTilt_Link1", UPWARD, Noise=0.0, Resolution=0.001),
        encoder("Noisy", "RightRWheel", LEFTWARD, Noise=0.1, Resolution=0.001),
        Mount(kind="GroundTruth", name="Chassis"),
        Mount(
            kind="GroundTruth",
            name="Head",
            parent="CameraPanTilt_Link2",
            at=(0.1, 0.2, -0.3),
            direction=(0.1, 0.2, 0.3),
            options=options(ScanInterval=0.0),
        ),
        *(
            Mount(kind="INS", name=name, options=options(ScanInterval=0.0, PolarStep=True, **noise))
            for name, noise in (("Polar", {"Sigma": 0.3, "Mean": 0.05}), ("QuietPolar", {"Sigma": 0.0}))
        ),
    ),
)


# Each function runs a few times: XLA's optimiser would take longer than it saves.
quick_jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})


def arena(boxes: tuple = (), posts: tuple = (), floor: float = 0.0) -> Any:
    """A floor, boxes (centre, half lengths, yaw) and upright posts (centre, radius, half height).

    Always as many geoms, the rest parked, so that nothing is compiled twice.
    """
    away = (PADDING_DISTANCE,) * 3
    boxes = [*boxes, *[(away, (1, 1, 1), 0.0)] * (BOXES - len(boxes))]
    posts = [*posts, *[(away, 1, 1)] * (POSTS - len(posts))]
    kinds = mujoco.mjtGeom
    kind = [kinds.mjGEOM_PLANE, *[kinds.mjGEOM_BOX] * BOXES, *[kinds.mjGEOM_CYLINDER] * POSTS]
    pos = [(0, 0, floor), *(b[0] for b in boxes), *(p[0] for p in posts)]
    size = [(0, 0, 1), *(b[1] for b in boxes), *((p[1], p[2], 0) for p in posts)]
    mat = [np.eye(3), *(mat_from_angles(0.0, 0.0, b[2]) for b in boxes), *[np.eye(3)] * POSTS]
    as_float = (jnp.asarray(np.array(values, np.float32)) for values in (pos, mat, size))
    return make_geoms(np.array(kind, int), *as_float, jnp.full(len(kind), -1))


@dataclass
class Bench:
    """A robot class whose suite is compiled once; poses are plain numbers."""

    robot: RobotSpec

    def __post_init__(self) -> None:
        self.suite: Suite = suite_of(self.robot)
        self.joints = len(kinematic_tree_of(self.robot).parts) - 1
        self._start = quick_jit(self.suite.init_memory)
        self._read = quick_jit(self.suite.read)
        self._bodies = quick_jit(partial(forward_kinematics, kinematic_tree_of(self.robot)))
        self._cast = quick_jit(self.suite.cast_rays)
        self.open = arena()

    def inputs(
        self, time=0.0, at=(0.0, 0.0, 0.26), angles=(0.0, 0.0, 0.0), wheels=(), geoms=None
    ) -> SensorInput:
        """What the robot senses at a pose, with its joints in `wheels`' positions and then zero."""
        joints = np.zeros(self.joints, np.float32)
        joints[: len(wheels)] = wheels
        state = RobotState(
            pos=jnp.asarray(at, jnp.float32),
            quat=jnp.asarray(quat_from_angles(*angles), jnp.float32),
            linear=jnp.zeros(3),
            angular=jnp.zeros(3),
            joint_pos=jnp.asarray(joints),
            joint_vel=jnp.zeros(self.joints),
        )
        bodies = self._bodies(state)
        hits = self._cast(self.open if geoms is None else geoms, bodies, jnp.int32(0))
        return SensorInput(clock=clock_at(time, 1e-3), state=state, bodies=bodies, hits=hits)

    def start(self, inputs: SensorInput, seed: int = 0) -> SensorMemory:
        return self._start(inputs, jax.random.key(seed))

    def read(self, inputs: SensorInput, memory: SensorMemory, seed: int = 0) -> tuple[SensorMemory, tuple]:
        return self._read(inputs, memory, jax.random.key(seed))

    def once(self, kind: str, name: str, seed: int = 0, **where: Any) -> np.ndarray:
        """One sensor's value at one place, just after the start; for groups that of one mount."""
        inputs = self.inputs(**where)
        _, readings = self.read(inputs, self.start(inputs, seed), seed)
        return self.value(readings, kind, name)

    def value(self, readings: tuple, kind: str, name: str) -> np.ndarray:
        place = self.suite.find(kind, name)
        assert place is not None
        sensor, value = self.suite.sensors[place], np.asarray(readings[place].value)
        return value[[m.name for m in sensor.mounts].index(name)] if sensor.grouped else value


@pytest.fixture(scope="session")
def bench() -> Bench:
    return Bench(BENCH)


@pytest.fixture(scope="session")
def make_bench() -> type[Bench]:
    return Bench


@pytest.fixture(scope="session")
def make_arena():
    return arena
