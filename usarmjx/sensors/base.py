"""What a sensor is: frozen settings and pure functions over arrays of one robot.

The batch maps these functions over robots and worlds; nothing here knows of either.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.errors import SpecError
from usarmjx.models.plan import Bodies, BodyPlan
from usarmjx.models.spec import SKY, Mount
from usarmjx.models.state import RobotState
from usarmjx.registry import Registry
from usarmjx.sensors.raycast import Hits
from usarmjx.sensors.surroundings import NOTHING, Surroundings
from usarmjx.transforms import Array, flip_angles, flip_vector, mat_from_angles


class Sight(struct.PyTreeNode, kw_only=True):
    """What the sensors of one robot can draw on at one moment.

    Attributes:
        time: Simulated time [s] ().
        state: The robot's own state.
        bodies: Poses of its bodies.
        hits: What the rays of the sensors met (rays,).
        surroundings: Victims and tags of its world; None: there are none.
    """

    time: Array
    state: RobotState
    bodies: Bodies
    hits: Hits
    surroundings: Surroundings | None = None

    @property
    def around(self) -> Surroundings:
        """The surroundings, `NOTHING` where none were given."""
        return NOTHING if self.surroundings is None else self.surroundings


class Reading(struct.PyTreeNode, kw_only=True):
    """What a sensor last reported.

    Attributes:
        value: The data; each sensor says which [sensor's unit] (...,).
        fresh: Whether it was taken now, rather than at an earlier scan ().
    """

    value: jax.Array
    fresh: jax.Array


@dataclass(frozen=True)
class Common:
    """Settings that all sensors have (manual 10).

    Attributes:
        hidden_sensor: Whether the sensor itself is invisible to pictures.
        with_time_stamp: Whether its messages carry the time.
        weight: Adds to the payload [kg].
        scan_interval: Time between two measurements [s]; 0 measures whenever asked.
    """

    hidden_sensor: bool = True
    with_time_stamp: bool = False
    weight: float = 0.4
    scan_interval: float = 0.0


@dataclass(frozen=True, eq=False)
class Sensor(ABC):
    """The sensors of one type on one robot class that report together, or a single one.

    Attributes:
        kind: Type as on the wire.
        grouped: Whether all of the type share one message (bUseGroup).
        needs_incidence: Whether it looks at the angle under which its rays meet surfaces.
        passes: Materials that its rays go through.
        looks_around: Whether it asks for the surroundings.
        plan: The robot class.
        mounts: Where the sensors sit.
        settings: Their settings, one each.
    """

    kind: ClassVar[str]
    grouped: ClassVar[bool] = False
    needs_incidence: ClassVar[bool] = False
    passes: ClassVar[frozenset[str]] = frozenset({SKY})
    looks_around: ClassVar[bool] = False
    defaults: ClassVar[type] = Common

    plan: BodyPlan
    mounts: tuple[Mount, ...]
    settings: tuple[Any, ...]

    def rays(self, bodies: Bodies) -> tuple[jax.Array, jax.Array]:
        """Return origins [m] (rays, 3) and unit directions (rays, 3) of the rays to cast; most need none."""
        del bodies
        return jnp.zeros((0, 3)), jnp.zeros((0, 3))

    def aim(self, bodies: Bodies, around: Surroundings) -> tuple[jax.Array, jax.Array]:
        """Return the rays as `rays` does, of a sensor that aims some of them at what is around.

        There are as many in every world, whatever there is.
        """
        del around
        return self.rays(bodies)

    def start(self, sight: Sight, key: jax.Array) -> Any:  # noqa: ANN401 - memory is the sensor's own
        """Return the sensor's memory at the start of an episode, before any ray is cast; most have none."""
        del sight, key
        return ()

    @abstractmethod
    def read(self, sight: Sight, memory: Any, key: jax.Array) -> tuple[Any, jax.Array]:  # noqa: ANN401
        """Return the new memory and the measured value; `sight.hits` are those of this sensor's rays."""

    def order(self, opcode: str, params: tuple[float, ...], sight: Sight, memory: Any) -> Any | None:  # noqa: ANN401
        """Carry out a SET command; return the new memory, or None when the command is not valid."""
        del opcode, params, sight, memory
        return None

    @property
    def manual(self) -> bool:
        """Whether the sensor measures only when told to (SCAN)."""
        return False

    def check(self) -> None:
        """Find what is wrong with mounts and settings while the scene is built.

        Raises:
            SpecError: A mount on a part that the robot does not have, or sensors that report together but
                do not measure together.
        """
        self.bodies_of_mounts()
        if len({(settings.scan_interval, settings.with_time_stamp) for settings in self.settings}) > 1:
            raise SpecError(
                f"all {self.kind} sensors report together and need the same ScanInterval and bWithTimeStamp"
            )

    def bodies_of_mounts(self) -> np.ndarray:
        """Return the body that each mount sits on (mounts,).

        Raises:
            SpecError: A mount names a part that the robot does not have.
        """
        parts = self.plan.parts
        for mount in self.mounts:
            if mount.parent not in parts:
                raise SpecError(
                    f"{mount.kind} {mount.name}: no part {mount.parent!r}; parts: {', '.join(parts)}"
                )
        return np.array([parts.index(mount.parent) for mount in self.mounts])

    def mount_poses(self, bodies: Bodies) -> tuple[jax.Array, jax.Array]:
        """Return the world poses of the mounts: positions (mounts, 3), orientations (mounts, 3, 3)."""
        at = np.array([flip_vector(mount.at) for mount in self.mounts], np.float32)
        angles = np.array([flip_angles(mount.direction) for mount in self.mounts], np.float32)
        local = mat_from_angles(angles[:, 0], angles[:, 1], angles[:, 2])
        index = self.bodies_of_mounts()
        mat = bodies.mat[index]
        return bodies.pos[index] + jnp.einsum("mij,mj->mi", mat, at), mat @ local


SENSORS: Registry[type[Sensor]] = Registry("sensor")
