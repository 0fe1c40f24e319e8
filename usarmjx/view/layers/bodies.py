"""Sensors and cameras of robots: their poses, housings and fields of view."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import mat_from_quat, matmul, matvec
from usarmjx.models.compile.parts import HOUSING_RGBA, HOUSING_SIZE
from usarmjx.sensors.base import SENSORS, Sensor
from usarmjx.view.drawing import Drawing, DrawnMount, Frame
from usarmjx.view.layers.base import InstanceNode, LineNode, NodeLayer, robot_colors

VIEW_LENGTH = 0.5
"""Distance of a camera's drawn picture frame [m]."""
ASPECT = 3 / 4
"""Height of pictures, as a share of their width."""


@dataclass(frozen=True, eq=False)
class DrawnSensor:
    """A sensor of a robot, or several that report together.

    Attributes:
        slot: Slot of the robot.
        index: Index of its reading among the robot's.
        mount: Its mounts.
        settings: Settings of each mount, of the sensor's class.
    """

    slot: int
    index: int
    mount: DrawnMount
    settings: tuple[Any, ...]

    def reading(self, frame: Frame) -> np.ndarray | None:
        """Return its last reading; None while its robot is absent."""
        robot = frame.robots.get(self.slot)
        return None if robot is None else np.asarray(robot.readings[self.index])


def mount_poses(frame: Frame, mount: DrawnMount) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions of mounts in the world [m] (mounts, 3), and their orientations (mounts, 3, 3)."""
    with numpy_backend():
        mat = np.asarray(mat_from_quat(frame.quat[mount.body]))
        return np.asarray(frame.pos[mount.body] + matvec(mat, mount.pos)), np.asarray(matmul(mat, mount.mat))


def quat_product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the products of quaternions, w first, (n, 4) each: `second` within `first`."""
    w, x, y, z = first.T
    # The matrix of a multiplication from the left, one for each of `first`: (4, 4, n).
    rows = np.array([(w, -x, -y, -z), (x, w, -z, y), (y, z, w, -x), (z, -y, x, w)])
    return np.einsum("ijn,nj->ni", rows, second)


def quats_of(mats: np.ndarray) -> np.ndarray:
    """Return orientations (n, 3, 3), possibly none, as quaternions, w first (n, 4)."""
    # SciPy takes no empty stack of matrices.
    whole = np.concatenate([np.eye(3)[None], mats])
    return Rotation.from_matrix(whole).as_quat(scalar_first=True)[1:]


def sensors_of(drawing: Drawing, family: type[Sensor]) -> list[DrawnSensor]:
    """Return the sensors of all robots that are of a class or of one derived from it."""
    found: list[DrawnSensor] = []
    for slot, robot in drawing.robots.items():
        for index, mount in enumerate(robot.sensors):
            # A recording may have sensors that are not registered here.
            kind = SENSORS.get(mount.kind) if mount.kind in SENSORS else Sensor
            if issubclass(kind, family):
                found.append(DrawnSensor(slot, index, mount, settings_of(kind, mount)))
    return found


def settings_of(kind: type[Sensor], mount: DrawnMount) -> tuple[Any, ...]:
    """Return the settings of each mount as the sensor's own, without those that are no plain values."""
    known = {field.name for field in fields(kind.settings_class)}
    return tuple(
        kind.settings_class(**{name: value for name, value in settings.items() if name in known})
        for settings in mount.settings
    )


class ReadingPoses:
    """Poses of the mounts of range sensors at the time of their readings.

    Otherwise a scan would move with a robot that drives on. A reading counts as new when it differs from
    the one before; a reading without echoes is always the same, and moves with its robot.

    Args:
        sensors: The sensors.

    Attributes:
        sensors: The sensors.
        readings: Reading of each, flat; empty while its robot is absent.
        rows: Rows of each one's mounts in the arrays below.
        pos: Positions of mounts [m] (mounts, 3).
        quat: Their orientations, w first (mounts, 4).
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
        # Sensors that report together have one reading, which is empty only beyond the least of their ranges.
        self._max_range = [min(one.max_range for one in sensor.settings) for sensor in sensors]

    def update(self, frame: Frame) -> list[int]:
        """Take new readings; return the sensors that have one."""
        new: list[int] = []
        for number, sensor in enumerate(self.sensors):
            robot, before = frame.robots.get(sensor.slot), self.readings[number]
            if robot is None:
                if len(before):
                    # Reported as new once, so that layers remove the last scan of a robot that has left.
                    self.readings[number] = before[:0]
                    new.append(number)
                continue
            reading = np.asarray(robot.readings[sensor.index]).reshape(-1)
            if not np.array_equal(reading, before) or self._is_empty(number, reading):
                self.readings[number] = reading
                new.append(number)
        if new:
            quat = frame.quat[self._body]
            with numpy_backend():
                mat = np.asarray(mat_from_quat(quat))
                # For all mounts at once, although few are new: NumPy's time is that of its calls.
                pos = frame.pos[self._body] + np.asarray(matvec(mat, self._at))
                mat = np.asarray(matmul(mat, self._local))
            turned = quat_product(quat, self._turn)
            for number in new:
                rows = self.rows[number]
                self.pos[rows], self.quat[rows], self.mat[rows] = pos[rows], turned[rows], mat[rows]
        return new

    def _is_empty(self, number: int, reading: np.ndarray) -> bool:
        return bool(((reading <= 0) | (reading >= self._max_range[number])).all())


def box() -> tuple[np.ndarray, np.ndarray]:
    """Return corners (8, 3) and triangles (12, 3) of a cube of side 2 about the origin."""
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    # Corners of each side counter-clockwise from outside, which is where a browser sees a face.
    quads = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    return corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


class SensorBodyLayer(NodeLayer):
    """A small box for each sensor, as HiddenSensor=false shows it in pictures."""

    name = "Sensor bodies"
    about = "a small box where each sensor sits, as HiddenSensor=false draws it"
    shown_at_first = False

    def draw(self, drawing: Drawing) -> None:
        """Collect the sensors of all robots; those with HiddenSensor=false are drawn with their robots."""
        slot, body, pos, mat = list[int](), list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
        for robot in drawing.robots.values():
            for mount in robot.sensors:
                hidden = [bool(settings.get("hidden_sensor", True)) for settings in mount.settings]
                slot += [robot.slot] * sum(hidden)
                body.append(mount.body[hidden])
                # The box lies behind its mount, as in the model: a sensor looks out of its front.
                back = mount.pos - HOUSING_SIZE[0] * mount.mat[:, :, 0]
                pos.append(back[hidden])
                mat.append(mount.mat[hidden])
        self._slot = np.array(slot, int)
        self._body = np.concatenate([np.zeros(0, int), *body])
        self._pos = np.concatenate([np.zeros((0, 3)), *pos])
        self._turn = quats_of(np.concatenate([np.zeros((0, 3, 3)), *mat]))
        corners, faces = box()
        self._boxes = InstanceNode(self.scene, f"{self.root}/boxes", (corners * HOUSING_SIZE, faces))
        self._rgb = (255 * np.array(HOUSING_RGBA[:3])).astype(np.uint8)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Move the boxes with their bodies."""
        del drawing
        there = np.isin(self._slot, list(frame.robots))
        body, count = self._body[there], int(there.sum())
        quat = frame.quat[body]
        with numpy_backend():
            # On NumPy: JAX would compile for each number of robots.
            offset = np.asarray(matvec(mat_from_quat(quat), self._pos[there]))
        turns = quat_product(quat, self._turn[there])
        self._boxes.set(frame.pos[body] + offset, turns, np.ones(count), np.tile(self._rgb, (count, 1)))


def view_lines(fov: np.ndarray) -> np.ndarray:
    """Return the edges of cameras' fields of view, in their axes [m] (cameras, 8, 2, 3).

    Args:
        fov: Horizontal fields of view [rad] (cameras,).
    """
    # Towards half a turn the tangent has no bound.
    wide = VIEW_LENGTH * np.tan(np.minimum(fov, 2.8) / 2)
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    corners = np.stack(
        [
            np.full((len(wide), 4), VIEW_LENGTH),
            wide[:, None] * signs[:, 0],
            ASPECT * wide[:, None] * signs[:, 1],
        ],
        -1,
    )
    rim = np.stack([corners, np.roll(corners, -1, 1)], 2)
    return np.concatenate([np.stack([np.zeros_like(corners), corners], 2), rim], 1)


class CameraLayer(NodeLayer):
    """Edges of cameras' fields of view."""

    name = "Camera views"
    about = "where cameras sit and look: the edges of their pictures"
    shown_at_first = False

    def draw(self, drawing: Drawing) -> None:
        """Collect the cameras; mirrors look all around and have no edges."""
        self._cameras: list[tuple[int, int, DrawnMount]] = [
            (slot, index, mount)
            for slot, robot in drawing.robots.items()
            for index, mount in enumerate(robot.cameras)
            if mount.settings[0].get("lens", "pinhole") == "pinhole"
        ]
        self._lines = LineNode(self.scene, f"{self.root}/lines", width=1.5)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Follow pan, tilt and zoom."""
        del drawing
        # Robots that have left stay in the drawing until the next one, and have no frame.
        there = [one for one in self._cameras if one[0] in frame.robots]
        fov = np.array([frame.robots[slot].fovs[index] for slot, index, _ in there], float)
        body = np.array([mount.body[0] for _, _, mount in there], int)
        local = np.array([mount.mat[0] for _, _, mount in there]).reshape(-1, 3, 3)
        at = np.array([mount.pos[0] for _, _, mount in there]).reshape(-1, 3)
        with numpy_backend():
            turn = np.asarray(mat_from_quat(frame.quat[body]))
        pos = frame.pos[body] + np.einsum("nij,nj->ni", turn, at)
        edges = pos[:, None, None] + np.einsum("nij,nklj->nkli", turn @ local, view_lines(fov))
        # Eight lines for each camera: four edges and the four sides of its picture.
        rgb = np.repeat(robot_colors(np.array([slot for slot, _, _ in there], int)), 8, axis=0)
        self._lines.set(edges.reshape(-1, 2, 3), rgb)
