"""Sensor interface: frozen settings and pure functions over the arrays of one robot, and common noise.

The batch maps these functions over robots and worlds; this module depends on neither.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, ClassVar, TypeVar

import jax
import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, ArrayLike, on_numpy, xp
from usarmjx.base.clock import Clock
from usarmjx.base.errors import SpecError
from usarmjx.base.nodes import Node
from usarmjx.base.registry import Registry
from usarmjx.base.rotations import matmul, matvec
from usarmjx.base.settings import ANY_PARAMETERS, NOT_NEGATIVE, Parameters, Setting
from usarmjx.base.transforms import flip_angles, flip_vector, mat_from_angles
from usarmjx.models.compile.kinematic_tree import BodyPoses, KinematicTree
from usarmjx.models.drives.base import RobotState
from usarmjx.models.types.robot import Mount
from usarmjx.models.types.shapes import SKY
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.raycast import DEFAULT_BUNDLE_SIZE, Hits
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.sensors.surroundings import NO_SURROUNDINGS, Surroundings

FORMS = {"number": 1, "count": 1, "flag": 1, "yaw": 1, "vector": 3, "angles": 3}
"""Forms of quantities and their sizes. `count` is an integer, `flag` is 1 or 0, `yaw` an angle about the
vertical to the left [rad], `vector` has x, y, z, and `angles` are roll, pitch, yaw [rad]."""
NOISE_SETTINGS = (
    *("noise", "sigma", "max_noise", "min_noise", "field_noise", "intensity_noise"),
    *("gyro_noise", "gyro_bias", "gyro_bias_walk", "accel_noise", "accel_bias", "accel_bias_walk"),
)
"""Settings that are amplitudes of random errors; `precision` is the inverse of one."""
NO_RAYS = np.zeros((0, 3), np.float32)
"""Empty array of rays."""
ROBOT_FIELDS = ("state", "bodies", "hits", "battery")
"""Fields of the inputs of several robots that have a leading axis over robots."""
Method = TypeVar("Method", bound=Callable[..., Any])
OutputCurve = tuple[tuple[float, float], ...]
"""Points (input, output) of an OutputCurve, inputs ascending."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """Named part of a sensor's value.

    Attributes:
        key: Key in messages, one word.
        form: One of `FORMS`.
    """

    key: str
    form: str = "number"

    def __post_init__(self) -> None:
        """Check form and key.

        Raises:
            SpecError: An unknown form, or a key that is not one word.
        """
        if self.form not in FORMS:
            raise SpecError(f"{self.key} is a {self.form!r}, expected one of {', '.join(FORMS)}")
        if not self.key.isalnum():
            raise SpecError(f"the key of a quantity is {self.key!r}, expected one word")

    @property
    def size(self) -> int:
        """Number of values."""
        return FORMS[self.form]


def total_size(quantities: Sequence[Quantity]) -> int:
    """Return the total size of quantities."""
    return sum(quantity.size for quantity in quantities)


def vectorized(method: Method) -> Method:
    """Mark a sensor's `read`, `fans` or `aimed_rays` as accepting arrays with a leading axis over robots.

    On NumPy a marked method is called once for all robots of a class, others robot by robot. An overriding
    method needs its own mark.
    """
    # On the function itself, so that an override without the mark does not inherit it.
    vars(method)["vectorized"] = True
    return method


def is_vectorized(method: Callable[..., Any]) -> bool:
    """Return whether a sensor's method has the mark of `vectorized`."""
    return getattr(method, "vectorized", False)


class SensorInput(Node, kw_only=True):
    """Inputs of one robot's sensors at one moment.

    Attributes:
        clock: Simulated time, as a count of control steps ().
        state: State of the robot.
        bodies: Poses of its bodies.
        hits: Hits of the sensors' rays (rays,).
        surroundings: Victims and tags of the world; None: none.
        noise_factor: Factor on the noise of the sensors (); None: 1.
        battery: Remaining battery time [s] (); None: not needed.
    """

    clock: Clock
    state: RobotState
    bodies: BodyPoses
    hits: Hits
    surroundings: Surroundings | None = None
    noise_factor: Array | None = None
    battery: Array | None = None

    @property
    def time(self) -> Array:
        """Simulated time in single precision [s] (); for durations use `clock.since`."""
        return self.clock.seconds

    @property
    def surroundings_or_empty(self) -> Surroundings:
        """Surroundings, or `NO_SURROUNDINGS`."""
        return NO_SURROUNDINGS if self.surroundings is None else self.surroundings

    def of(self, robots: Array | int) -> "SensorInput":
        """Select one robot, or the masked ones (robots,), from the inputs of several."""
        # The other fields are the world's, one for all robots.
        own = {name: getattr(self, name) for name in ROBOT_FIELDS}
        return self.replace(**jax.tree.map(lambda x: x[robots], own))


class Reading(Node, kw_only=True):
    """Latest reading of a sensor.

    Attributes:
        value: Data as documented by the sensor [sensor's unit] (...,).
        fresh: Whether it was measured now, not at an earlier scan ().
    """

    value: Array
    fresh: Array


@dataclass(frozen=True)
class SensorSettings:
    """Settings common to all sensors (manual 10).

    Attributes:
        hidden_sensor: Whether the sensor's housing is invisible; see `models.compile.visuals`.
        with_time_stamp: Whether its messages carry the time.
        weight: Share of the payload [kg].
        scan_interval: Time between two measurements [s]; 0 measures at every request.
    """

    hidden_sensor: Annotated[bool, Setting(manual_key="HiddenSensor")] = True
    with_time_stamp: bool = False
    weight: Annotated[float, NOT_NEGATIVE] = 0.4
    scan_interval: Annotated[float, NOT_NEGATIVE] = 0.0

    def problem(self) -> str:
        """Return a conflict between settings, "" if there is none; single settings have limits."""
        return ""


@dataclass(frozen=True)
class NoisySensorSettings(SensorSettings):
    """Settings of sensors with noise, see `noisy`.

    Attributes:
        noise: Relative amplitude of the uniform noise.
        mean: Mean of the relative Gaussian noise.
        sigma: Standard deviation of the relative Gaussian noise (manual 10.6.2: any sensor may have it).
    """

    noise: Annotated[float, NOT_NEGATIVE] = 0.0
    mean: float = 0.0
    sigma: Annotated[float, NOT_NEGATIVE] = 0.0


@dataclass(frozen=True, eq=False)
class Sensor(ABC):
    """Sensor of one type on one robot class: a single mount, or all mounts that report together.

    Attributes:
        kind: Type as on the wire.
        grouped: Whether all mounts of the type share one message (bUseGroup).
        transparent: Materials that its rays pass.
        bundle_size: Number of consecutive rays with similar directions; see `raycast.nearest_hits`.
        needs_surroundings: Whether it uses the surroundings.
        needs_victims: Whether it uses victims, not only tags.
        needs_battery: Whether it uses the battery time.
        steers_rays: Whether its rays depend on its memory; see `steered_rays`.
        names_objects: Whether its message names what its rays meet.
        settings_class: Class of its settings.
        opcodes: Parameters of the operations of SET, by name in capitals; an operation that is not here may
            have any number of them.
        quantities: Parts of its value, of one mount if it is grouped; empty: undeclared. Messages are made
            from it, except for the manual's sensors, whose messages follow captures.
        plan: Kinematic tree of the robot class.
        mounts: The mounts.
        settings: Settings of each mount.
    """

    kind: ClassVar[str]
    grouped: ClassVar[bool] = False
    transparent: ClassVar[frozenset[str]] = frozenset({SKY})
    bundle_size: ClassVar[int] = DEFAULT_BUNDLE_SIZE
    needs_surroundings: ClassVar[bool] = False
    needs_victims: ClassVar[bool] = True
    needs_battery: ClassVar[bool] = False
    steers_rays: ClassVar[bool] = False
    names_objects: ClassVar[bool] = False
    settings_class: ClassVar[type[Any]] = SensorSettings
    opcodes: ClassVar[dict[str, Parameters]] = {}
    quantities: ClassVar[tuple[Quantity, ...]] = ()

    plan: KinematicTree
    mounts: tuple[Mount, ...]
    settings: tuple[Any, ...]

    def rays(self, bodies: BodyPoses) -> tuple[Array, Array]:
        """Return origins [m] (rays, 3) and unit directions (rays, 3) of the rays to cast; none by default."""
        fans = self.fans(bodies)
        return (NO_RAYS, NO_RAYS) if fans is None else fans.rays()

    def fans(self, bodies: BodyPoses) -> Fans | None:
        """Return all rays as fans, for a sensor whose rays start at its mounts and are fixed there.

        Such a sensor needs no `rays`, and is faster on a GPU, where the rays are not materialised. A subclass
        with other rays returns None here.
        """
        del bodies
        return None

    def aimed_rays(self, bodies: BodyPoses, surroundings: Surroundings) -> tuple[Array, Array]:
        """Return the rays as `rays` does, for a sensor that aims some of them at the surroundings.

        The number of rays is the same in every world. Unused ones have a zero direction: they are not cast
        and hit nothing.
        """
        del surroundings
        return self.rays(bodies)

    def steered_rays(self, bodies: BodyPoses, memory: Any) -> tuple[Array, Array]:  # noqa: ANN401
        """Return the rays as `rays` does, for a sensor that `steers_rays`: as many at any memory."""
        del memory
        return self.rays(bodies)

    def init_memory(self, inputs: SensorInput, key: Array) -> Any:  # noqa: ANN401 - memory is the sensor's own
        """Return the sensor's memory at the start of an episode, before any ray is cast; empty by default."""
        del inputs, key
        return ()

    @abstractmethod
    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Return the new memory and the measured value; `inputs.hits` are those of this sensor's rays."""

    def parameters_of(self, opcode: str) -> Parameters:
        """Return the form of the parameters of an operation of SET."""
        return self.opcodes.get(opcode.upper(), ANY_PARAMETERS)

    def handle_set(
        self,
        opcode: str,
        params: tuple[float, ...],
        inputs: SensorInput,
        memory: Any,  # noqa: ANN401
    ) -> Any | None:  # noqa: ANN401
        """Execute a SET command; return the new memory, or None for an invalid command."""
        del opcode, params, inputs, memory
        return None

    @property
    def has_overlay(self) -> bool:
        """Whether its memory contains an overlay for pictures; see `overlay`."""
        return False

    def overlay(self, memory: Any) -> OverlayLines:  # noqa: ANN401
        """Return the overlay of the last reading, for a sensor that `has_overlay`."""
        raise NotImplementedError(f"{self.kind} draws nothing")

    def with_noise(self, factor: ArrayLike) -> "Sensor":
        """Return the sensor with its noise scaled by a factor () >= 0."""
        scaled: list[Any] = []
        for settings in self.settings:
            noise = {name: getattr(settings, name, 0.0) for name in NOISE_SETTINGS}
            # Zeros stay plain numbers: scaled by a traced factor they would draw noise for nothing.
            noise = {name: value * factor for name, value in noise.items() if value}
            precision = getattr(settings, "precision", None)
            if precision is not None:
                # Precision is an inverse: twice the noise is half the precision.
                noise["precision"] = precision / factor
            scaled.append(replace(settings, **noise))
        return replace(self, settings=tuple(scaled))

    @property
    def max_distance(self) -> float:
        """Range of its rays [m]."""
        return math.inf

    @property
    def needs_incidence(self) -> bool:
        """Whether it uses the angles of incidence of its rays."""
        return False

    @property
    def least_cosines(self) -> tuple[float, ...]:
        """Least cosine of incidence of each fan of which only the first hit counts; empty: all hits count."""
        return ()

    @property
    def on_command(self) -> bool:
        """Whether it measures only on the SCAN command."""
        return False

    def goes_on(self, memory: Any) -> Array | bool:  # noqa: ANN401
        """Return whether a sensor `on_command` measures again without another one (), after a reading."""
        del memory
        return False

    def check(self) -> None:
        """Check mounts and settings while the scene is built.

        Raises:
            SpecError: A mount on an unknown part, or sensors that report together but do not measure
                together.
        """
        self.bodies_of_mounts()
        # One message has one time, and the suite keeps one due step for each sensor.
        if len({(settings.scan_interval, settings.with_time_stamp) for settings in self.settings}) > 1:
            raise SpecError(
                f"all {self.kind} sensors report together and need the same ScanInterval and bWithTimeStamp"
            )

    def check_value(self, shape: tuple[int, ...]) -> None:
        """Check the shape of a value against the declared quantities.

        Raises:
            SpecError: They differ.
        """
        wanted = total_size(self.quantities) * (len(self.mounts) if self.grouped else 1)
        if self.quantities and math.prod(shape) != wanted:
            raise SpecError(f"{self.kind}: a value of shape {shape} was read, expected {wanted} numbers")

    def bodies_of_mounts(self) -> np.ndarray:
        """Return the body of each mount (mounts,).

        Raises:
            SpecError: A mount names an unknown part.
        """
        parts = self.plan.parts
        for mount in self.mounts:
            if mount.parent not in parts:
                raise SpecError(
                    f"{mount.kind} {mount.name}: no part {mount.parent!r}; parts: {', '.join(parts)}"
                )
        return np.array([parts.index(mount.parent) for mount in self.mounts])

    def mount_poses(self, bodies: BodyPoses) -> tuple[Array, Array]:
        """Return the world poses of the mounts: positions (..., mounts, 3), orientations (..., mounts, 3, 3).

        Args:
            bodies: Poses of a robot's bodies, or of several robots' (...,).
        """
        index, at, local = self._mounts_on_bodies
        mat = bodies.mat[..., index, :, :]
        return bodies.pos[..., index, :] + matvec(mat, at), matmul(mat, local)

    @cached_property
    def _mounts_on_bodies(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bodies of the mounts (mounts,), positions (mounts, 3) and orientations on them (mounts, 3, 3)."""
        # Descriptions of robots keep USARSim's axes, so that they can be compared with the manual's tables.
        at = np.array([flip_vector(mount.at) for mount in self.mounts], np.float32)
        angles = np.array([flip_angles(mount.direction) for mount in self.mounts], np.float32)
        return self.bodies_of_mounts(), at, mat_from_angles(angles[:, 0], angles[:, 1], angles[:, 2])


SENSORS: Registry[type[Sensor]] = Registry("sensor")
"""Sensor types by their names on the wire."""


def relative_uniform(key: Array, data: Array, amplitude: Array | float) -> Array:
    """Return data + random(amplitude) * data, random in [-amplitude, amplitude] (manual 10.2.2)."""
    return data * (1 + random.uniform(key, data.shape, minval=-amplitude, maxval=amplitude))


def relative_normal(key: Array, data: Array, mean: Array | float, sigma: Array | float) -> Array:
    """Return data * (1 + N(mean, sigma)): noise proportional to the rate of change (manual 10.6)."""
    return data * normal_factor(key, data.shape, mean, sigma)


def normal_factor(key: Array, shape: Sequence[int], mean: Array | float, sigma: Array | float) -> Array:
    """Return 1 + N(mean, sigma) of a shape; keys as of `random.normal`."""
    # Only a plain zero: of a traced one nothing is known here.
    if isinstance(sigma, float) and not sigma:
        return xp.broadcast_to(xp.asarray(1 + mean, xp.float32), tuple(shape))
    return 1 + mean + sigma * random.normal(key, shape)


def setting_values(settings: Sequence[NoisySensorSettings], name: str) -> Array:
    """Return a setting of each sensor (sensors,); a JAX array if `with_noise` has scaled it by one."""
    values = [getattr(s, name) for s in settings]
    # `np.array` of traced numbers fails.
    if not on_numpy() and any(isinstance(value, jax.Array) for value in values):
        return xp.stack([xp.asarray(value, xp.float32) for value in values])
    return np.array(values, np.float32)


def noisy(key: Array, data: Array, settings: Sequence[NoisySensorSettings]) -> Array:
    """Return data (sensors, ...) with each sensor's noise: uniform, then Gaussian if set.

    Keys are folded by index: a sensor's noise does not depend on those after it. On NumPy also for robots'
    keys (robots,) and data (robots, sensors, ...).
    """
    noise, mean, sigma = (setting_values(settings, name) for name in ("noise", "mean", "sigma"))
    # Folded for all settings at once: XLA compiles one fold instead of one for each mount.
    keys = random.fold_in(key, np.arange(len(settings)))
    # Settings are per sensor: they are aligned with the axis of the sensors, whatever follows it.
    rows = (-1, *[1] * (data.ndim - random.axes(keys)))
    noisy_data = data if _is_zero(noise) else relative_uniform(keys, data, noise.reshape(rows))
    if _is_zero(mean) and _is_zero(sigma):
        return noisy_data
    # Another key than the uniform noise's: of the same one both would be correlated.
    return relative_normal(random.fold_in(keys, 1), noisy_data, mean.reshape(rows), sigma.reshape(rows))


def _is_zero(values: Array) -> bool:
    """Return whether values known at trace time are all 0."""
    return isinstance(values, np.ndarray) and not values.any()


def curve_problem(points: OutputCurve) -> str:
    """Return the fault of an OutputCurve's points, "" if there is none."""
    pairs = all(len(point) == 2 and all(map(math.isfinite, point)) for point in points)
    # `interp` needs rising inputs; of others it returns nonsense without an error.
    if pairs and all(a[0] < b[0] for a, b in pairwise(points)):
        return ""
    return f"the points of OutputCurve are {points!r}, expected finite ones with growing inputs"


def apply_output_curve(data: Array, points: OutputCurve) -> Array:
    """Distort data by linear interpolation between points, zero outside; no points: unchanged (manual 10)."""
    if not points:
        return data
    inputs, outputs = zip(*points, strict=True)
    return xp.interp(data, xp.array(inputs), xp.array(outputs), left=0.0, right=0.0)
