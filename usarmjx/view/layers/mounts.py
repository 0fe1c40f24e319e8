"""Where sensors are, what they said, and where they were when they said it."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
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


class HeldMounts:
    """Where the mounts of range sensors were when they took their readings.

    Else a scan would go along with a robot that drives on. A reading is taken to be new when it differs from
    the one before; one that met nothing is the same everywhere, and goes along.

    Args:
        sensors: The sensors.

    Attributes:
        sensors: The sensors.
        readings: What each took, flat; empty while its robot is not there.
        rows: Which of the arrays below are the mounts of each.
        pos: Where mounts were [m] (mounts, 3).
        quat: How they were turned, w first (mounts, 4).
        mat: The same as matrices (mounts, 3, 3).
    """

    def __init__(self, sensors: Sequence[DrawnSensor]) -> None:
        self.sensors = tuple(sensors)
        self.readings = [np.zeros(0, np.float32) for _ in sensors]
        ends = np.cumsum([0, *(len(sensor.mount.pos) for sensor in sensors)]).tolist()
        self.rows = [slice(first, last) for first, last in pairwise(ends)]
        self.pos = np.zeros((ends[-1], 3), np.float32)
        self.quat = np.tile(np.array([1, 0, 0, 0], np.float32), (ends[-1], 1))
        self.mat = np.tile(np.eye(3, dtype=np.float32), (ends[-1], 1, 1))
        self._body = np.concatenate([np.zeros(0, int), *(sensor.mount.body for sensor in sensors)])
        self._at = np.concatenate([np.zeros((0, 3)), *(sensor.mount.pos for sensor in sensors)])
        self._local = np.concatenate([np.zeros((0, 3, 3)), *(sensor.mount.mat for sensor in sensors)])
        self._turn = quats_of(self._local)
        self._max_range = [min(one.max_range for one in sensor.settings) for sensor in sensors]

    def look(self, frame: Frame) -> list[int]:
        """Take what is new; return which sensors have something new."""
        new: list[int] = []
        for number, sensor in enumerate(self.sensors):
            robot, before = frame.robots.get(sensor.slot), self.readings[number]
            if robot is None:
                if len(before):
                    self.readings[number] = before[:0]
                    new.append(number)
                continue
            reading = np.asarray(robot.readings[sensor.index]).reshape(-1)
            if not np.array_equal(reading, before) or self._met_nothing(number, reading):
                self.readings[number] = reading
                new.append(number)
        if new:
            quat = frame.quat[self._body]
            with numpy_backend():
                mat = np.asarray(mat_from_quat(quat))
                pos = frame.pos[self._body] + np.asarray(matvec(mat, self._at))
                mat = np.asarray(matmul(mat, self._local))
            turned = quat_product(quat, self._turn)
            for number in new:
                rows = self.rows[number]
                self.pos[rows], self.quat[rows], self.mat[rows] = pos[rows], turned[rows], mat[rows]
        return new

    def _met_nothing(self, number: int, reading: np.ndarray) -> bool:
        return bool(((reading <= 0) | (reading >= self._max_range[number])).all())
