"""A client's robot in a served world."""

import math
from dataclasses import dataclass, field

import numpy as np

from usarmjx.base.backend import Array, numpy_backend
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import Vec3, angles_from_mat
from usarmjx.models.compile.kinematic_tree import KinematicTree
from usarmjx.models.effecters import Effecter, effecters_of
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.cameras.mounts import Camera, cameras_of
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.sensors.suite import Suite
from usarmjx.server.protocol.commands import Trace
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.protocol.viewports import Viewports
from usarmjx.sim.control import RobotCommand

COLORS: dict[str, Vec3] = {
    "Red": (1.0, 0.0, 0.0),
    "Yellow": (1.0, 1.0, 0.0),
    "Green": (0.0, 1.0, 0.0),
    "Cyan": (0.0, 1.0, 1.0),
    "White": (1.0, 1.0, 1.0),
    "Blue": (0.0, 0.0, 1.0),
    "Purple": (0.5, 0.0, 0.5),
}
"""Red, green and blue, 0 to 1, of `commands.TRACE_COLORS`."""
MIN_DISTANCE = 7 / 250
"""Least distance between two points of a trace [m]: 7 Unreal units (KRobot.uc)."""
MIN_INTERVAL = 0.1
"""Least interval between two reads of a robot's position [s]."""
MAX_POINTS = 512
"""Most points of a world's traces.

Beyond that, every other point is dropped, and from then on every other new one: the whole path stays visible.
"""


@dataclass
class RobotTrace:
    """State of one robot's trace.

    Attributes:
        command: The last Trace command.
        last: Position of its last point [m], None before the first.
        next: Time from which the next point may come [s].
        count: Number of its points, dropped ones included.
    """

    command: Trace
    last: Vec3 | None = None
    next: float = 0.0
    count: int = 0

    def due(self, time: float) -> bool:
        """Whether a point is due."""
        # Times are sums of periods, with rounding errors.
        return self.command.on and time >= self.next - 1e-6


@dataclass
class Traces:
    """The points of a world.

    Attributes:
        points: Position [m] and colour of each.
        stride: Of this many points one is kept.
    """

    points: list[tuple[Vec3, str]] = field(default_factory=list[tuple[Vec3, str]])
    stride: int = 1

    def add_point(self, trace: RobotTrace, position: Vec3, time: float) -> None:
        """Add a point at a robot's position, if it is far enough from its last one."""
        # Also without a point: a robot that stands is looked at only now and then.
        trace.next = time + MIN_INTERVAL
        if trace.last is not None and np.linalg.norm(np.subtract(position, trace.last)) <= MIN_DISTANCE:
            return
        trace.last, trace.next = position, time + max(MIN_INTERVAL, trace.command.interval)
        trace.count += 1
        # The first point of a trace is kept whatever the stride is.
        if (trace.count - 1) % self.stride == 0:
            self.points.append((position, trace.command.color))
        if len(self.points) > MAX_POINTS:
            # Every other point of all robots, so old and new parts of a path are equally dense.
            del self.points[1::2]
            self.stride *= 2

    def clear(self) -> None:
        """Forget all points."""
        self.points.clear()
        self.stride = 1

    def sketch(self) -> OverlayLines:
        """Return all points as overlay; NumPy arrays."""
        positions = np.array([position for position, _ in self.points], np.float32).reshape(-1, 3)
        colors = np.array([COLORS[color] for _, color in self.points], np.float32).reshape(-1, 3)
        return OverlayLines(start=positions, end=positions, rgb=colors, shown=np.ones(len(positions), bool))


@dataclass(eq=False)
class Robot:
    """A robot in a served world.

    Attributes:
        slot: Its index in the world, which it keeps.
        name: Its name on the wire.
        suite: Its class's sensors.
        command: Its command; NumPy arrays.
        spawn_time: World time at which it was spawned [s].
        drowned: Whether water has shorted its battery.
        pending: Readings that have not been reported yet, by index in the suite.
        latest: The last readings, by index in the suite, with their times [s].
        tile: Its tile of the MultiView, -1 without one.
        controller: Dialogue that drives it in place of its client; None: its client does.
        next_report: Time of its next report [s]; infinite without a client.
        refused: Requested position, if there was no room for the robot [m]; else None.
    """

    slot: int
    name: str
    suite: Suite
    command: RobotCommand
    spawn_time: float
    drowned: bool = False
    pending: dict[int, np.ndarray] = field(default_factory=dict[int, np.ndarray])
    latest: dict[int, tuple[float, np.ndarray]] = field(default_factory=dict[int, tuple[float, np.ndarray]])
    tile: int = -1
    controller: object = None
    next_report: float = math.inf
    refused: Vec3 | None = None

    def __post_init__(self) -> None:
        """Set its cameras to their defaults."""
        self.class_spec = self.spec
        """Description of its class without edits; `parameters` has the edited parameters, by their keys."""
        self.parameters: dict[str, float] = {}
        self.fovs = [camera.default_fov for camera in self.cameras]
        """Field of view in force of each camera [rad]."""
        self.viewports = Viewports.of([camera.mount.name for camera in self.cameras])

    def restart(self, command: RobotCommand) -> None:
        """Forget commands and readings."""
        self.command, self.drowned = command, False
        self.pending.clear()
        self.latest.clear()
        # Cameras return to their defaults with the robot.
        self.__post_init__()

    @property
    def plan(self) -> KinematicTree:
        """Its kinematic tree."""
        return self.suite.plan

    @property
    def spec(self) -> RobotSpec:
        """Its class."""
        return self.plan.robot

    @property
    def effecters(self) -> tuple[Effecter, ...]:
        """Its class's effecters."""
        return effecters_of(self.spec)

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """Its class's cameras."""
        return cameras_of(self.spec)

    def camera_index(self, name: str) -> int | None:
        """Return the index of the first camera of that name, case ignored; None without one."""
        for index, camera in enumerate(self.cameras):
            if camera.mount.name.lower() == name.lower():
                return index
        return None

    def effecter_index(self, kind: str, name: str) -> int | None:
        """Return the index of the first effecter of that type and name, case ignored; None without one."""
        for index, effecter in enumerate(self.effecters):
            if effecter.is_type(kind) and effecter.mount.name.lower() == name.lower():
                return index
        return None


def wire_pose(pos: Array, quat: Array) -> tuple[Vec3, Vec3]:
    """Return position [m] and roll, pitch and yaw [rad] on the wire.

    Args:
        pos: Position in our axes [m] (3,).
        quat: Orientation, w first (4,).
    """
    with numpy_backend():
        angles = angles_from_mat(np.asarray(mat_from_quat(np.asarray(quat)), float))
    position = flip_wire_vector(np.asarray(pos, float).tolist())
    return position, flip_wire_angles(np.asarray(angles, float).tolist())
