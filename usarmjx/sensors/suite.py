"""All sensors of a robot class, read together, each when it is due."""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UnknownNameError
from usarmjx.models.build.body_plan import BodyPoses, KinematicTree, kinematic_tree_of
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors import co2, gps, human_motion, motion, ranging, rfid, scanners, sound, touch, victim
from usarmjx.sensors.base import SENSORS, Reading, Sensor, SensorInput
from usarmjx.sensors.rays.raycast import NO_HITS, Hits, RayQuery, cast_rays
from usarmjx.sensors.rays.targets import Geoms
from usarmjx.sensors.settings import CameraSettings, resolve_settings
from usarmjx.sensors.surroundings import NO_SURROUNDINGS, Surroundings

SENSOR_MODULES = (co2, gps, human_motion, motion, ranging, rfid, scanners, sound, touch, victim)
"""The modules that fill `SENSORS`."""
CLOCK_SLACK = 1e-3
"""A scan that is due within this time is due now: sums of float32 steps do not meet exactly [s]."""


class SensorMemory(struct.PyTreeNode, kw_only=True):
    """What the sensors of one robot remember.

    Attributes:
        due: When each sensor measures next [s] (sensors,).
        own: Each sensor's own memory.
        last: Each sensor's last reading.
    """

    due: jax.Array
    own: tuple[Any, ...]
    last: tuple[jax.Array, ...]


NO_MEMORY = SensorMemory(due=jnp.zeros(0), own=(), last=())
"""Of a robot whose sensors have not started."""


@dataclass(frozen=True, eq=False)
class Suite:
    """The sensors of a robot class, in the order in which they report."""

    plan: KinematicTree
    sensors: tuple[Sensor, ...]

    @property
    def needs_surroundings(self) -> bool:
        """Whether any sensor asks for the surroundings."""
        return any(sensor.needs_surroundings for sensor in self.sensors)

    @cached_property
    def ray_counts(self) -> tuple[int, ...]:
        """How many rays each sensor casts."""
        n = len(self.plan.parts)
        bodies = BodyPoses(pos=jnp.zeros((n, 3)), mat=jnp.zeros((n, 3, 3)))
        return tuple(
            jax.eval_shape(sensor.aimed_rays, bodies, NO_SURROUNDINGS)[0].shape[0] for sensor in self.sensors
        )

    def rays(
        self, bodies: BodyPoses, surroundings: Surroundings = NO_SURROUNDINGS
    ) -> tuple[jax.Array, jax.Array]:
        """Return origins [m] and unit directions (rays, 3) of all sensors' rays, sensor by sensor."""
        pairs = [sensor.aimed_rays(bodies, surroundings) for sensor in self.sensors]
        return jnp.concatenate([origin for origin, _ in pairs]), jnp.concatenate(
            [along for _, along in pairs]
        )

    def due(self, time: Array, memory: SensorMemory) -> Array:
        """Return which sensors measure at a time [s] () (sensors,)."""
        return time >= memory.due - CLOCK_SLACK

    def cast_rays(
        self,
        geoms: Geoms,
        bodies: BodyPoses,
        slot: Array,
        due: Array | None = None,
        surroundings: Surroundings = NO_SURROUNDINGS,
    ) -> Hits:
        """Cast the rays of the robot in `slot` (); angles of incidence only where a sensor needs them.

        Rays of sensors that are not due (sensors,) are not cast and meet nothing; None: all are due.
        """
        hits: list[Hits] = []
        for i, (sensor, count) in enumerate(zip(self.sensors, self.ray_counts, strict=True)):
            if count:
                rays = sensor.aimed_rays(bodies, surroundings)
                query = RayQuery(
                    transparent=sensor.transparent,
                    bundle_size=sensor.bundle_size,
                    max_distance=sensor.max_distance,
                    incidence=sensor.needs_incidence,
                    exclude_owner=slot,
                    wanted=None if due is None else due[i],
                )
                with jax.named_scope(sensor.kind):
                    hits.append(cast_rays(geoms, *rays, query, sensor.fans(bodies)))
        return jax.tree.map(lambda *parts: jnp.concatenate(parts), *hits) if hits else NO_HITS

    def init_memory(self, inputs: SensorInput, key: jax.Array) -> SensorMemory:
        """Return the memory of a robot that starts now: everything but a manual scanner is due at once.

        No rays are cast for it: `inputs.hits` is not used.
        """
        sensors = self._as_noisy_as(inputs)
        own = tuple(s.init_memory(inputs, jax.random.fold_in(key, i)) for i, s in enumerate(sensors))
        rays = jnp.zeros(sum(self.ray_counts))
        seen = inputs.replace(hits=Hits(distance=rays, cosine=rays))
        blank = jax.eval_shape(self._read_all, seen, own, key)[1]
        for sensor, value in zip(self.sensors, blank, strict=True):
            sensor.check_value(value.shape)
        due = jnp.array([jnp.inf if sensor.on_command else 0.0 for sensor in self.sensors]) + inputs.time
        return SensorMemory(due=due, own=own, last=tuple(jnp.zeros(v.shape, v.dtype) for v in blank))

    def _as_noisy_as(self, inputs: SensorInput) -> tuple[Sensor, ...]:
        """Return the sensors of a robot whose noise may be more or less than usual."""
        factor = inputs.noise_factor
        return self.sensors if factor is None else tuple(s.with_noise(factor) for s in self.sensors)

    def _read_all(
        self, inputs: SensorInput, own: tuple[Any, ...], key: jax.Array
    ) -> tuple[tuple[Any, ...], tuple[jax.Array, ...]]:
        # Keys are folded by the sensor's place, so that adding one leaves the noise of the others alone.
        ends = np.cumsum(self.ray_counts)
        pairs: list[tuple[Any, jax.Array]] = []
        sensors = self._as_noisy_as(inputs)
        for i, (sensor, count, end) in enumerate(zip(sensors, self.ray_counts, ends, strict=True)):
            mine = jax.tree.map(lambda x, a=end - count, b=end: x[a:b], inputs.hits)
            with jax.named_scope(sensor.kind):
                pairs.append(sensor.read(inputs.replace(hits=mine), own[i], jax.random.fold_in(key, i)))
        return tuple(memory for memory, _ in pairs), tuple(value for _, value in pairs)

    def read(
        self, inputs: SensorInput, memory: SensorMemory, key: jax.Array
    ) -> tuple[SensorMemory, tuple[Reading, ...]]:
        """Measure what is due; the others keep their last reading, marked as not fresh."""
        interval = np.array([s.settings[0].scan_interval for s in self.sensors], np.float32)
        manual = np.array([sensor.on_command for sensor in self.sensors])
        fresh = self.due(inputs.time, memory)
        own, values = self._read_all(inputs, memory.own, key)

        def pick(i: int, new: Any, old: Any) -> Any:  # noqa: ANN401 - any PyTree
            return jax.tree.map(lambda a, b: jnp.where(fresh[i], a, b), new, old)

        own = tuple(pick(i, new, old) for i, (new, old) in enumerate(zip(own, memory.own, strict=True)))
        last = tuple(pick(i, new, old) for i, (new, old) in enumerate(zip(values, memory.last, strict=True)))
        # The next scan follows the schedule, not the moment it was read, so that the rate holds on average.
        late = inputs.time - memory.due >= interval
        following = jnp.where(manual, jnp.inf, jnp.where(late, inputs.time, memory.due) + interval)
        due = jnp.where(fresh, following, memory.due)
        readings = tuple(Reading(value=value, fresh=fresh[i]) for i, value in enumerate(last))
        return SensorMemory(due=due, own=own, last=last), readings

    def find(self, kind: str, name: str) -> int | None:
        """Return the place of the sensor that holds the mount of that type and name, case ignored."""
        for i, sensor in enumerate(self.sensors):
            names = {mount.name.lower() for mount in sensor.mounts}
            if sensor.kind.lower() == kind.lower() and name.lower() in names:
                return i
        return None

    def index(self, kind: str) -> int:
        """Return the place of the first sensor of a type.

        Raises:
            UnknownNameError: The robot has none; lists the types it has.
        """
        kinds = [sensor.kind.lower() for sensor in self.sensors]
        if kind.lower() not in kinds:
            known = ", ".join(sensor.kind for sensor in self.sensors)
            raise UnknownNameError(f"{self.plan.robot.name} has no sensor {kind!r}; it has: {known}")
        return kinds.index(kind.lower())

    def handle_set(
        self, i: int, opcode: str, params: tuple[float, ...], inputs: SensorInput, memory: SensorMemory
    ) -> SensorMemory | None:
        """Carry out a SET command on sensor `i`; None when it is not valid for that sensor."""
        own = self.sensors[i].handle_set(opcode, params, inputs, memory.own[i])
        if own is None:
            return None
        due = memory.due.at[i].set(inputs.time) if opcode.upper() == "SCAN" else memory.due
        return memory.replace(own=(*memory.own[:i], own, *memory.own[i + 1 :]), due=due)


@cache
def suite_of(robot: RobotSpec) -> Suite:
    """Return the sensors of a robot class; those of a grouped type share one place, at their first mount.

    Raises:
        UnknownNameError: A mount of an unknown type or with an unknown setting.
        SpecError: A mount that cannot be built.
    """
    plan = kinematic_tree_of(robot)
    for mount in robot.cameras:
        resolve_settings(CameraSettings, mount.options, f"{mount.kind} {mount.name}")
    groups: dict[str, list[int]] = {}
    for i, mount in enumerate(robot.sensors):
        grouped = SENSORS.get(mount.kind).grouped
        groups.setdefault(mount.kind if grouped else f"{mount.kind}#{i}", []).append(i)
    sensors: list[Sensor] = []
    for members in groups.values():
        mounts = tuple(robot.sensors[i] for i in members)
        kind = SENSORS.get(mounts[0].kind)
        settings: tuple[Any, ...] = tuple(
            resolve_settings(kind.settings_class, m.options, f"{m.kind} {m.name}") for m in mounts
        )
        sensor = kind(plan=plan, mounts=mounts, settings=settings)
        sensor.check()
        sensors.append(sensor)
    return Suite(plan=plan, sensors=tuple(sensors))
