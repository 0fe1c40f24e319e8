"""Sensor suite of a robot class: all its sensors, each read when it is due.

A batch maps `Suite.hits` and `Suite.read` of one robot over robots and worlds. On NumPy they also take
several robots, with a leading axis on all arrays: methods marked `vectorized` are then called once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache, partial
from itertools import accumulate
from typing import Any, TypeGuard

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, named_scope, numpy_backend, on_numpy, set_at, vmap, xp
from usarmjx.base.clock import Clock, intervals_in_steps, next_due
from usarmjx.base.errors import UnknownNameError
from usarmjx.base.nodes import Node
from usarmjx.models.compile.kinematic_tree import BodyPoses, KinematicTree, kinematic_tree_of
from usarmjx.models.types.robot import RobotSpec, resolve_settings
from usarmjx.sensors import gps, inertial, motion, power, ranging, rfid, swept, touch, victim
from usarmjx.sensors.base import SENSORS, Reading, Sensor, SensorInput, is_vectorized
from usarmjx.sensors.cameras.mounts import resolve_camera
from usarmjx.sensors.rays.raycast import NO_HITS, Hits, RayCaster, RayQuery, RobotsRayCaster, cast_rays
from usarmjx.sensors.rays.targets import Geoms
from usarmjx.sensors.surroundings import NO_SURROUNDINGS, Surroundings

__all__ = ["SENSORS", "SENSOR_MODULES"]

SENSOR_MODULES = (gps, inertial, motion, power, ranging, rfid, swept, touch, victim)
"""Modules whose import registers sensor types; a new module belongs here."""


class SensorMemory(Node, kw_only=True):
    """Memory of one robot's sensors.

    Attributes:
        due: Control step of each sensor's next measurement (sensors,).
        lead: By how much that is after its exact time, see `base.clock.next_due` (sensors,).
        armed: Whether each sensor measures when it is due; manual scanners only after a SCAN (sensors,).
        own: Each sensor's own memory.
        last: Each sensor's last value.
    """

    due: Array
    lead: Array
    armed: Array
    own: tuple[Any, ...]
    last: tuple[Array, ...]


NO_MEMORY = SensorMemory(
    due=np.zeros(0, np.int32), lead=np.zeros(0, np.int32), armed=np.zeros(0, bool), own=(), last=()
)
"""Memory of a robot whose sensors have not started."""


@dataclass(frozen=True, eq=False)
class Suite:
    """Sensors of a robot class, in the order of their reports."""

    plan: KinematicTree
    sensors: tuple[Sensor, ...]

    @property
    def needs_surroundings(self) -> bool:
        """Whether any sensor uses the surroundings."""
        return any(sensor.needs_surroundings for sensor in self.sensors)

    @property
    def needs_victims(self) -> bool:
        """Whether any sensor uses victims in the surroundings."""
        return any(sensor.needs_surroundings and sensor.needs_victims for sensor in self.sensors)

    @cached_property
    def needs_battery(self) -> bool:
        """Whether any sensor uses the battery time."""
        return any(sensor.needs_battery for sensor in self.sensors)

    @cached_property
    def ray_counts(self) -> tuple[int, ...]:
        """Number of rays of each sensor."""
        n = len(self.plan.parts)
        # Any poses do: the number of rays depends on neither poses nor surroundings.
        bodies = BodyPoses(pos=np.zeros((n, 3), np.float32), mat=np.zeros((n, 3, 3), np.float32))
        # On NumPy within a trace, too: the poses are constants, and nothing has to be compiled.
        with numpy_backend():
            return tuple(len(sensor.aimed_rays(bodies, NO_SURROUNDINGS)[0]) for sensor in self.sensors)

    @cached_property
    def _ray_ends(self) -> tuple[int, ...]:
        """Cumulative number of rays (sensors,)."""
        return tuple(accumulate(self.ray_counts))

    @cached_property
    def _intervals(self) -> tuple[float, ...]:
        """Time between two measurements of each sensor [s]."""
        return tuple(float(sensor.settings[0].scan_interval) for sensor in self.sensors)

    @cached_property
    def _automatic(self) -> np.ndarray:
        """Mask of the sensors that measure without a command (sensors,)."""
        return np.array([not sensor.on_command for sensor in self.sensors], bool)

    @cached_property
    def steers_rays(self) -> bool:
        """Whether the rays of any sensor depend on its memory."""
        return any(sensor.steers_rays for sensor in self.sensors)

    def rays(self, bodies: BodyPoses, surroundings: Surroundings = NO_SURROUNDINGS) -> tuple[Array, Array]:
        """Return origins [m] and unit directions (rays, 3) of all sensors' rays, sensor by sensor."""
        pairs = [sensor.aimed_rays(bodies, surroundings) for sensor in self.sensors]
        return xp.concatenate([origin for origin, _ in pairs]), xp.concatenate([along for _, along in pairs])

    def due(self, clock: Clock, memory: SensorMemory) -> Array:
        """Return which sensors are due at a moment () (sensors,)."""
        # By the difference: counts are 32-bit and wrap around.
        return memory.armed & (clock.step - memory.due >= 0)

    def _rays_of(self, i: int) -> slice:
        """Return the slice of sensor `i` in all rays."""
        return slice(self._ray_ends[i] - self.ray_counts[i], self._ray_ends[i])

    def cast_rays(
        self,
        geoms: Geoms,
        bodies: BodyPoses,
        slot: Array,
        due: Array | None = None,
        surroundings: Surroundings = NO_SURROUNDINGS,
    ) -> Hits:
        """Cast the rays of the robot in `slot` () at geoms, see `hits`."""
        return self.hits(partial(cast_rays, geoms), bodies, slot, due, surroundings)

    def hits(
        self,
        cast: RayCaster,
        bodies: BodyPoses,
        slot: Array | np.int32,
        due: Array | None = None,
        surroundings: Surroundings = NO_SURROUNDINGS,
        own: tuple[Any, ...] | None = None,
    ) -> Hits:
        """Return the hits of all sensors' rays of a robot, with incidence only for sensors that use it.

        Args:
            cast: Ray caster.
            bodies: Poses of the robot's bodies.
            slot: The robot's slot (); of several (robots,).
            due: Which sensors measure now (sensors,); rays of the others are not cast and hit nothing. None:
                all.
            surroundings: Victims and tags.
            own: Each sensor's own memory, for those that steer their rays; None: as at the start.
        """
        if on_numpy():
            return self._hits_on_numpy(cast, bodies, np.asarray(slot), due, surroundings, own)
        # Each sensor for itself: ranges, transparent materials and bundles of rays differ.
        hits = [
            self._hits_of(
                sensor,
                cast,
                bodies,
                slot,
                None if due is None else due[i],
                surroundings,
                own[i] if own is not None and sensor.steers_rays else None,
            )
            for i, sensor in enumerate(self.sensors)
            if self.ray_counts[i]
        ]
        if not hits:
            return NO_HITS
        return jax.tree.map(lambda *parts: xp.concatenate(parts), *hits)

    def _hits_of(
        self,
        sensor: Sensor,
        cast: RayCaster,
        bodies: BodyPoses,
        slot: Array | np.int32,
        wanted: Array | None,
        surroundings: Surroundings,
        memory: Any | None,  # noqa: ANN401 - the sensor's own
    ) -> Hits:
        """Return the hits of one sensor's rays, if they are wanted."""
        fans = sensor.fans(bodies)
        origin, direction = _rays(sensor, bodies, surroundings, memory) if fans is None else fans.rays()
        if fans is None:
            # A sensor that aims at nothing casts nothing, for instance an RFID reader far from all tags.
            wanted = (direction != 0).any() & (True if wanted is None else wanted)
        with named_scope(sensor.kind):
            return cast(origin, direction, query_of(sensor, slot, wanted), fans)

    def _hits_on_numpy(
        self,
        cast: RayCaster,
        bodies: BodyPoses,
        slot: np.ndarray,
        due: Array | None,
        surroundings: Surroundings,
        own: tuple[Any, ...] | None,
    ) -> Hits:
        """As `hits`, for one robot () or several (robots,)."""
        distance = np.full((*slot.shape, sum(self.ray_counts)), np.inf, np.float32)
        cosine = np.zeros(distance.shape, np.float32)
        for i, sensor in enumerate(self.sensors):
            wanted = np.ones(slot.shape, bool) if due is None else np.asarray(due[..., i])
            if not self.ray_counts[i] or not wanted.any():
                continue
            # One call of NumPy for all robots costs about as much as one for a single robot.
            together = _rays_of_robots(sensor, bodies, surroundings) if slot.ndim else None
            if together is not None and _casts_for_robots(cast):
                origin, direction = (part[wanted] for part in together)
                met = cast.of_robots(origin, direction, query_of(sensor, slot[wanted]))
                distance[wanted, self._rays_of(i)] = met.distance
                cosine[wanted, self._rays_of(i)] = met.cosine
                continue
            # Without an axis over robots, the empty index stands for the only one.
            for robot in zip(*np.nonzero(wanted), strict=True) if slot.ndim else [()]:
                if together is not None:
                    origin, direction = (part[robot] for part in together)
                else:
                    there = BodyPoses(pos=bodies.pos[robot], mat=bodies.mat[robot])
                    memory = None
                    if own is not None and sensor.steers_rays:
                        memory = jax.tree.map(lambda x, robot=robot: x[robot], own[i])
                    origin, direction = _rays(sensor, there, surroundings, memory)
                if len(aimed := np.flatnonzero(direction.any(-1))):
                    met = cast(origin[aimed], direction[aimed], query_of(sensor, slot[robot]), None)
                    at = (*robot, self._rays_of(i).start + aimed)
                    distance[at], cosine[at] = met.distance, met.cosine
        return Hits(distance=distance, cosine=cosine)

    def init_memory(self, inputs: SensorInput, key: Array) -> SensorMemory:
        """Return the memory of a robot that starts now: all sensors are due except manual scanners.

        No rays are cast: `inputs.hits` is not used.
        """
        sensors = self._with_noise(inputs)
        own = tuple(s.init_memory(inputs, own) for s, own in zip(sensors, self._keys(key), strict=True))
        # Distances of zero, not of infinity: nothing computed from them overflows.
        rays = xp.zeros(sum(self.ray_counts))
        seen = inputs.replace(hits=Hits(distance=rays, cosine=rays))

        def read_all() -> tuple[Array, ...]:
            keys = self._keys(key)
            return tuple(
                self._read_one(i, sensor, seen, own[i], keys[i])[1] for i, sensor in enumerate(sensors)
            )

        # Only the shapes are needed: JAX derives them without measuring, NumPy has to measure.
        blank = read_all() if on_numpy() else jax.eval_shape(read_all)
        for sensor, value in zip(self.sensors, blank, strict=True):
            sensor.check_value(value.shape)
        now = xp.broadcast_to(xp.asarray(inputs.clock.step, xp.int32), self._automatic.shape)
        return SensorMemory(
            due=now,
            lead=xp.zeros(now.shape, xp.int32),
            armed=xp.asarray(self._automatic),
            own=own,
            last=tuple(xp.zeros(v.shape, v.dtype) for v in blank),
        )

    def _with_noise(self, inputs: SensorInput) -> tuple[Sensor, ...]:
        """Return the sensors with the noise factor of a robot."""
        factor = inputs.noise_factor
        if factor is None:
            return self.sensors
        return (
            _scaled(self, float(factor)) if on_numpy() else tuple(s.with_noise(factor) for s in self.sensors)
        )

    def _keys(self, key: Array) -> Sequence[Array]:
        """Return a key for each sensor, folded by its index: an added sensor leaves other noise unchanged."""
        keys = random.fold_in(key, np.arange(len(self.sensors)))
        return np.moveaxis(keys, -2, 0) if on_numpy() else keys

    def _read_one(
        self,
        i: int,
        sensor: Sensor,
        inputs: SensorInput,
        memory: Any,  # noqa: ANN401 - the sensor's own
        key: Array,
    ) -> tuple[Any, Array]:
        """Return the new memory and the value of sensor `i`."""
        mine = (..., self._rays_of(i))
        hits = Hits(distance=inputs.hits.distance[mine], cosine=inputs.hits.cosine[mine])
        inputs = inputs.replace(hits=hits)
        with named_scope(sensor.kind):
            if not on_numpy():
                return sensor.read(inputs, memory, key)
            if random.axes(key) and not is_vectorized(sensor.read):
                # A method without the mark of `vectorized` knows one robot only.
                def of_robot(robot: int, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
                    return sensor.read(inputs.of(robot), memory, key)

                return vmap(of_robot)(np.arange(len(key)), memory, key)
            memory, value = sensor.read(inputs, memory, key)
            return memory, np.asarray(value)

    def read(
        self, inputs: SensorInput, memory: SensorMemory, key: Array
    ) -> tuple[SensorMemory, tuple[Reading, ...]]:
        """Read the due sensors; the others keep their last value, marked as not fresh."""
        fresh, keys = self.due(inputs.clock, memory), self._keys(key)
        kept = [
            self._read_if(i, sensor, fresh[..., i], inputs, memory, keys[i])
            for i, sensor in enumerate(self._with_noise(inputs))
        ]
        intervals = intervals_in_steps(self._intervals, inputs.clock.period)
        due, lead = next_due(inputs.clock.step, memory.due, memory.lead, intervals)
        # Only measured sensors move on: a manual scanner stays due at its SCAN.
        due, lead = xp.where(fresh, due, memory.due), xp.where(fresh, lead, memory.lead)
        own = tuple(own for own, _ in kept)
        armed = xp.where(fresh, self._stays_armed(own), memory.armed)
        last = tuple(value for _, value in kept)
        readings = tuple(Reading(value=value, fresh=fresh[..., i]) for i, value in enumerate(last))
        return SensorMemory(due=due, lead=lead, armed=armed, own=own, last=last), readings

    def _stays_armed(self, own: tuple[Any, ...]) -> Array:
        """Return which sensors measure again without a command (..., sensors), after a reading."""
        going = [sensor.goes_on(memory) for sensor, memory in zip(self.sensors, own, strict=True)]
        # By identity: a traced flag has no truth value.
        if all(one is False for one in going):
            return self._automatic
        going = xp.broadcast_arrays(*(xp.asarray(one, bool) for one in going))
        return self._automatic | xp.stack(going, -1)

    def _read_if(
        self, i: int, sensor: Sensor, fresh: Array, inputs: SensorInput, memory: SensorMemory, key: Array
    ) -> tuple[Any, Array]:
        """As `_read_one` for a due sensor, otherwise the old memory and value."""
        before = memory.own[i], memory.last[i]
        # NumPy can skip the work; traced code has to compute and select.
        if on_numpy() and not fresh.any():
            return before
        if on_numpy() and not fresh.all():
            old = jax.tree.map(lambda x: x[fresh], before[0])
            # Only those that are due: reading others would cost time and is thrown away anyway.
            after = self._read_one(i, sensor, inputs.of(fresh), old, key[fresh])
            return jax.tree.map(lambda new, old: set_at(old, fresh, new), after, before)
        after = self._read_one(i, sensor, inputs, before[0], key)
        if on_numpy():
            return after
        return jax.tree.map(lambda new, old: jnp.where(fresh, new, old), after, before)

    def find(self, kind: str, name: str) -> int | None:
        """Return the index of the sensor with a mount of that type and name, case ignored."""
        for i, sensor in enumerate(self.sensors):
            names = {mount.name.lower() for mount in sensor.mounts}
            if sensor.kind.lower() == kind.lower() and name.lower() in names:
                return i
        return None

    def index(self, kind: str) -> int:
        """Return the index of the first sensor of a type.

        Raises:
            UnknownNameError: The robot has none; lists its types.
        """
        kinds = [sensor.kind.lower() for sensor in self.sensors]
        if kind.lower() not in kinds:
            known = ", ".join(sensor.kind for sensor in self.sensors)
            raise UnknownNameError(f"{self.plan.robot.name} has no sensor {kind!r}; it has: {known}")
        return kinds.index(kind.lower())

    def handle_set(
        self, i: int, opcode: str, params: tuple[float, ...], inputs: SensorInput, memory: SensorMemory
    ) -> SensorMemory | None:
        """Execute a SET command on sensor `i`; None if it is invalid for that sensor."""
        own = self.sensors[i].handle_set(opcode, params, inputs, memory.own[i])
        if own is None:
            return None
        memory = memory.replace(own=(*memory.own[:i], own, *memory.own[i + 1 :]))
        if opcode.upper() != "SCAN":
            return memory
        return memory.replace(
            due=set_at(memory.due, i, inputs.clock.step),
            # The next interval counts from the command, not from the schedule before it.
            lead=set_at(memory.lead, i, 0),
            armed=set_at(memory.armed, i, True),
        )


def migrate_memory(before: Suite, after: Suite, memory: SensorMemory, fresh: SensorMemory) -> SensorMemory:
    """Return the memory of a robot's sensors after a change of settings; NumPy arrays.

    Args:
        before: Old sensors.
        after: The same sensors with other settings.
        memory: Memory of the old sensors.
        fresh: Initial memory of the new sensors: source of memories whose shape has changed, and of the next
            measurement of sensors whose settings have.
    """

    def same_shape(old: object, new: object) -> bool:
        return jax.tree.map(np.shape, old) == jax.tree.map(np.shape, new)

    # A setting may change the number of rays or lines, and old arrays no longer fit.
    pairs = zip(memory.own, fresh.own, strict=True), zip(memory.last, fresh.last, strict=True)
    own, last = (tuple(old if same_shape(old, new) else new for old, new in pair) for pair in pairs)
    both = zip(before.sensors, after.sensors, strict=True)
    changed = np.array([old.settings != new.settings for old, new in both], bool)
    return SensorMemory(
        due=np.where(changed, fresh.due, memory.due),
        lead=np.where(changed, fresh.lead, memory.lead),
        armed=np.where(changed, fresh.armed, memory.armed),
        own=own,
        last=last,
    )


def _rays(
    sensor: Sensor,
    bodies: BodyPoses,
    surroundings: Surroundings,
    memory: Any | None,  # noqa: ANN401 - the sensor's own
) -> tuple[Array, Array]:
    """Return origins [m] and unit directions (rays, 3) of a sensor's rays; steered by its memory if given."""
    if memory is not None:
        return sensor.steered_rays(bodies, memory)
    fans = sensor.fans(bodies)
    return sensor.aimed_rays(bodies, surroundings) if fans is None else fans.rays()


def _rays_of_robots(
    sensor: Sensor, bodies: BodyPoses, surroundings: Surroundings
) -> tuple[Array, Array] | None:
    """As `_rays`, for several robots (robots, rays, 3); None: the sensor supports only one at a time."""
    fans = sensor.fans(bodies) if is_vectorized(sensor.fans) else None
    if fans is not None:
        return fans.rays()
    return sensor.aimed_rays(bodies, surroundings) if is_vectorized(sensor.aimed_rays) else None


def _casts_for_robots(cast: RayCaster) -> TypeGuard[RobotsRayCaster]:
    return _is_robots_ray_caster(type(cast))


@cache
def _is_robots_ray_caster(kind: type) -> bool:
    # Looking up a protocol's methods takes as long as casting a few rays.
    return issubclass(kind, RobotsRayCaster)


def query_of(sensor: Sensor, slot: Array | np.int32, wanted: Array | None = None) -> RayQuery:
    """Return the ray query of a sensor of the robot in a slot (), if its hits are wanted ()."""
    return RayQuery(
        transparent=sensor.transparent,
        bundle_size=sensor.bundle_size,
        max_distance=sensor.max_distance,
        incidence=sensor.needs_incidence,
        exclude_owner=slot,
        wanted=wanted,
        least_cosines=sensor.least_cosines,
        kept_as=sensor.mounts[0].name if sensor.names_objects else "",
    )


# A served world asks for the same few factors at each step, and scaling makes new frozen sensors.
@lru_cache(maxsize=64)
def _scaled(suite: Suite, factor: float) -> tuple[Sensor, ...]:
    """Return a suite's sensors with scaled noise, cached."""
    return tuple(sensor.with_noise(factor) for sensor in suite.sensors)


@cache
def suite_of(robot: RobotSpec) -> Suite:
    """Return the sensors of a robot class; mounts of a grouped type share the first one's sensor.

    Raises:
        UnknownNameError: A mount has an unknown type or setting.
        SpecError: A mount cannot be built.
    """
    plan = kinematic_tree_of(robot)
    # Cameras are no sensors here, but a fault in one must show as early.
    for mount in robot.cameras:
        resolve_camera(mount, f"{mount.kind} {mount.name}")
    groups: dict[str, list[int]] = {}
    for i, mount in enumerate(robot.sensors):
        grouped = SENSORS.get(mount.kind).grouped
        # The order of the first mount of each type is that of the reports.
        groups.setdefault(mount.kind if grouped else f"{mount.kind}#{i}", []).append(i)
    sensors: list[Sensor] = []
    for members in groups.values():
        mounts = tuple(robot.sensors[i] for i in members)
        kind = SENSORS.get(mounts[0].kind)
        settings: tuple[Any, ...] = tuple(
            resolve_settings(kind.settings_class, m.all_options, f"{m.kind} {m.name}") for m in mounts
        )
        sensor = kind(plan=plan, mounts=mounts, settings=settings)
        sensor.check()
        sensors.append(sensor)
    return Suite(plan=plan, sensors=tuple(sensors))
