"""Where sensors are, what they said, and where they were when they said it."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import mat_from_quat, matmul, matvec
from usarmjx.sensors.base import SENSORS, Sensor
from usarmjx.view.drawing import Drawing, DrawnMount, Frame


@dataclass(frozen=True, eq=False)
class DrawnSensor:
    """A sensor of a robot, or several that report together.

    Attributes:
        slot: Slot of the robot.
        index: Place of its reading among the robot's.
        mount: Where it sits.
        settings: Settings of each mount, of the sensor's class.
    """

    slot: int
    index: int
    mount: DrawnMount
    settings: tuple[Any, ...]

    def reading(self, frame: Frame) -> np.ndarray | None:
        """Return what it said last; None: its robot is not there."""
        robot = frame.robots.get(self.slot)
        return None if robot is None else np.asarray(robot.readings[self.index])

    def poses(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        """Return where its mounts are [m] (mounts, 3), and how they are turned (mounts, 3, 3)."""
        return mount_poses(frame, self.mount)


def mount_poses(frame: Frame, mount: DrawnMount) -> tuple[np.ndarray, np.ndarray]:
    """Return where mounts are in the world [m] (mounts, 3), and how they are turned (mounts, 3, 3)."""
    with numpy_backend():
        mat = np.asarray(mat_from_quat(frame.quat[mount.body]))
        return np.asarray(frame.pos[mount.body] + matvec(mat, mount.pos)), np.asarray(matmul(mat, mount.mat))


def quat_product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return orientations that are `second` within `first`, w first, (n, 4) each."""
    w, x, y, z = first.T
    rows = np.array([(w, -x, -y, -z), (x, w, -z, y), (y, z, w, -x), (z, -y, x, w)])
    return np.einsum("ijn,nj->ni", rows, second)


def quats_of(mats: np.ndarray) -> np.ndarray:
    """Return orientations (n, 3, 3), of which there may be none, as quaternions, w first (n, 4)."""
    whole = np.concatenate([np.eye(3)[None], mats])
    return Rotation.from_matrix(whole).as_quat(scalar_first=True)[1:]


def sensors_of(drawing: Drawing, family: type[Sensor]) -> list[DrawnSensor]:
    """Return the sensors of all robots that are of a class or of those made from it."""
    found: list[DrawnSensor] = []
    for slot, robot in drawing.robots.items():
        for index, mount in enumerate(robot.sensors):
            kind = SENSORS.get(mount.kind) if mount.kind in SENSORS else Sensor
            if issubclass(kind, family):
                found.append(DrawnSensor(slot, index, mount, settings_of(kind, mount)))
    return found


def settings_of(kind: type[Sensor], mount: DrawnMount) -> tuple[Any, ...]:
    """Return the settings of each mount as the sensor knows them, without those that are no plain values."""
    known = {field.name for field in fields(kind.settings_class)}
    return tuple(
        kind.settings_class(**{name: value for name, value in told.items() if name in known})
        for told in mount.settings
    )


class Held:
    """What was made of a range sensor's readings, in the place where it was when it took them.

    Else a scan would go along with a robot that drives on. A reading is taken to be new when it differs from
    the one before; one that met nothing is the same everywhere, and goes along.

    Args:
        sensor: The sensor.
        make: Makes something of reading, positions (mounts, 3) and orientations (mounts, 3, 3).
    """

    def __init__(
        self, sensor: DrawnSensor, make: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    ) -> None:
        self.sensor, self._make = sensor, make
        self._max_range = min(settings.max_range for settings in sensor.settings)
        self._reading: np.ndarray | None = None
        self._made: np.ndarray | None = None

    def at(self, frame: Frame) -> np.ndarray | None:
        """Return what was made of the last reading; None: the robot is not there."""
        reading = self.sensor.reading(frame)
        if reading is None:
            self._reading = self._made = None
            return None
        met_nothing = ((reading <= 0) | (reading >= self._max_range)).all()
        if met_nothing or self._reading is None or not np.array_equal(reading, self._reading):
            self._reading = reading
            self._made = self._make(reading, *self.sensor.poses(frame))
        return self._made
