"""A bench for sensors that look for victims and tags: one robot in a room of boxes, all of which is data."""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.clock import clock_at
from usarmjx.base.transforms import mat_from_angles, quat_from_angles
from usarmjx.models.compile.kinematic_tree import forward_kinematics, kinematic_tree_of
from usarmjx.models.compile.tags import tag_table
from usarmjx.models.compile.victims import pad_table, segment_poses, victim_table
from usarmjx.models.drives.base import RobotState
from usarmjx.models.effecters import MAX_DROPPED_TAGS, DroppedTags
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount
from usarmjx.sensors.base import SensorInput
from usarmjx.sensors.rays.targets import PADDING_DISTANCE, make_geoms
from usarmjx.sensors.suite import SensorMemory, suite_of
from usarmjx.sensors.surroundings import Surroundings, surroundings_at

BOXES, VICTIMS, WALLS, TAGS = 34, 3, 6, 6
quick_jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})


@dataclass(frozen=True)
class Room:
    """Victims and false alarms, tags, walls (centre, half lengths, yaw), where tags were dropped."""

    victims: tuple = ()
    alarms: tuple = ()
    tags: tuple = ()
    walls: tuple = ()
    dropped: tuple = ()
    floor: float = 0.0

    @property
    def people(self) -> Any:
        return victim_table(self.victims, self.alarms)

    def around(self, time: float = 0.0) -> Surroundings:
        pos = np.zeros((MAX_DROPPED_TAGS, 3), np.float32)
        pos[: len(self.dropped)] = np.reshape(self.dropped, (-1, 3))
        dropped = DroppedTags(pos=pos, count=np.int32(len(self.dropped)))
        people = pad_table(self.people, BOXES, VICTIMS)
        return surroundings_at(
            people, tag_table(self.tags, TAGS), dropped, np.float32(time), np.float32(self.floor), np
        )

    def geoms(self, around: Surroundings) -> Any:
        """Floor, victims and walls as our rays see them."""
        away = ((PADDING_DISTANCE,) * 3, (1, 1, 1), 0.0)
        walls = [*self.walls, *[away] * (WALLS - len(self.walls))]
        kinds = mujoco.mjtGeom
        kind = [kinds.mjGEOM_PLANE, *[kinds.mjGEOM_BOX] * (BOXES + WALLS)]
        pos = [(0, 0, self.floor), *around.box_pos, *(w[0] for w in walls)]
        size = [(0, 0, 1), *around.box_size, *(w[1] for w in walls)]
        mat = [np.eye(3), *around.box_mat, *(mat_from_angles(0.0, 0.0, w[2]) for w in walls)]
        as_float = (jnp.asarray(np.array(values, np.float32)) for values in (pos, mat, size))
        return make_geoms(np.array(kind, int), *as_float, jnp.full(len(kind), -1))

    def met(self, origin: Any, directions: Any, time: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """What C MuJoCo says: distances [m] (rays,), infinite without a hit, and boxes met, -1 for others."""
        spec = mujoco.MjSpec()
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1), pos=(0, 0, self.floor))
        people = self.people
        box = mujoco.mjtGeom.mjGEOM_BOX
        for pos, quat, size in zip(*segment_poses(people, time), people.size, strict=True):
            x, y, z = pos
            spec.worldbody.add_geom(type=box, pos=(x, y, z + self.floor), size=size, quat=quat)
        for centre, half, yaw in self.walls:
            turn = (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
            spec.worldbody.add_geom(type=box, pos=centre, size=half, quat=turn)
        model = spec.compile()
        data, geom = mujoco.MjData(model), np.zeros(1, np.int32)
        mujoco.mj_kinematics(model, data)
        far, which = [], []
        for along in np.asarray(directions, float):
            distance = mujoco.mj_ray(model, data, np.asarray(origin, float), along, None, 1, -1, geom)
            far.append(np.inf if distance < 0 else distance)
            part = int(geom[0]) - 1
            which.append(part if 0 <= part < people.num_boxes else -1)
        return np.array(far), np.array(which)


@dataclass
class Watch:
    """A robot with sensors whose suite is compiled once."""

    mounts: tuple[Mount, ...]
    name: str
    suite: Any = field(init=False)

    def __post_init__(self) -> None:
        self.robot = replace(P2AT, name=self.name, sensors=self.mounts)
        self.suite = suite_of(self.robot)
        self.joints = len(kinematic_tree_of(self.robot).parts) - 1
        self._start = quick_jit(self.suite.init_memory)
        self._read = quick_jit(self.suite.read)
        self._bodies = quick_jit(partial(forward_kinematics, kinematic_tree_of(self.robot)))
        self._cast = quick_jit(self.suite.cast_rays)

    def inputs(
        self, room: Room, at: Any = (0, 0, 0.26), angles: Any = (0, 0, 0), time: float = 0.0
    ) -> SensorInput:
        """What the robot senses in a room."""
        zeros = jnp.zeros(self.joints)
        state = RobotState(
            pos=jnp.asarray(at, jnp.float32),
            quat=jnp.asarray(quat_from_angles(*angles), jnp.float32),
            linear=jnp.zeros(3),
            angular=jnp.zeros(3),
            joint_pos=zeros,
            joint_vel=zeros,
        )
        bodies, around = self._bodies(state), room.around(time)
        hits = self._cast(room.geoms(around), bodies, jnp.int32(0), surroundings=around)
        return SensorInput(
            clock=clock_at(time, 1e-3), state=state, bodies=bodies, hits=hits, surroundings=around
        )

    def start(self, inputs: SensorInput) -> SensorMemory:
        return self._start(inputs, jax.random.key(0))

    def read(
        self, inputs: SensorInput, memory: SensorMemory, seed: int = 0
    ) -> tuple[SensorMemory, dict[str, np.ndarray]]:
        """The new memory, and the values of the sensors by name."""
        memory, readings = self._read(inputs, memory, jax.random.key(seed))
        names = [sensor.mounts[0].name for sensor in self.suite.sensors]
        return memory, {n: np.asarray(r.value) for n, r in zip(names, readings, strict=True)}

    def overlay(self, name: str, room: Room, seed: int = 0, **where: Any) -> Any:
        """What a sensor draws after a reading at one place."""
        inputs = self.inputs(room, **where)
        memory, _ = self.read(inputs, self.start(inputs), seed)
        place = [sensor.mounts[0].name for sensor in self.suite.sensors].index(name)
        assert self.suite.sensors[place].has_overlay
        return jax.device_get(self.suite.sensors[place].overlay(memory.own[place]))

    def once(self, room: Room, seed: int = 0, **where: Any) -> dict[str, np.ndarray]:
        """The values of the sensors at one place, just after the start."""
        inputs = self.inputs(room, **where)
        return self.read(inputs, self.start(inputs), seed)[1]
