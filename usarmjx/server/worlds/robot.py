"""A client's robot in a served world."""

import math
from dataclasses import dataclass, field

import numpy as np

from usarmjx.base.transforms import Vec3
from usarmjx.models.compile.kinematic_tree import KinematicTree
from usarmjx.models.effecters import Effecter, effecters_of
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.cameras.mounts import Camera, cameras_of
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.sensors.suite import Suite
from usarmjx.server.protocol.commands import Trace
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
"""A robot has to move further than this between two points [m]: 7 Unreal units (KRobot.uc)."""
MIN_INTERVAL = 0.1
"""A robot's position is looked up no more often than this [s]."""
MAX_POINTS = 512
"""Most points of a world. When there would be more, every other one goes, and from then on every other one is
not left at all: the whole way can still be seen."""


@dataclass
class RobotTrace:
    """One robot's trace.

    Attributes:
        command: The last Trace command.
        last: Where its last point is [m], None before the first.
        next: Time from which the next point may come [s].
        count: How many there would be of it.
    """

    command: Trace
    last: Vec3 | None = None
    next: float = 0.0
    count: int = 0

    def due(self, time: float) -> bool:
        """Whether it is time to look where the robot is."""
        return self.command.on and time >= self.next - 1e-6


@dataclass
class Traces:
    """The points of a world.

    Attributes:
        points: Position [m] and colour of each.
        stride: Of so many points one is kept.
    """

    points: list[tuple[Vec3, str]] = field(default_factory=list[tuple[Vec3, str]])
    stride: int = 1

    def add_point(self, trace: RobotTrace, position: Vec3, time: float) -> None:
        """Leave a point where a robot is now, if it is far enough from its last one."""
        trace.next = time + MIN_INTERVAL
        if trace.last is not None and np.linalg.norm(np.subtract(position, trace.last)) <= MIN_DISTANCE:
            return
        trace.last, trace.next = position, time + max(MIN_INTERVAL, trace.command.interval)
        trace.count += 1
        if (trace.count - 1) % self.stride == 0:
            self.points.append((position, trace.command.color))
        if len(self.points) > MAX_POINTS:
            del self.points[1::2]
            self.stride *= 2

    def clear(self) -> None:
        """Forget all points."""
        self.points.clear()
        self.stride = 1

    def sketch(self) -> OverlayLines:
        """Return all points, to be drawn; numpy arrays."""
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
        command: Its command; numpy arrays.
        spawn_time: World time at which it appeared [s].
        drowned: Whether water has killed its battery.
        pending: Readings that have not been reported yet, by index in the suite.
        latest: The last readings, by index in the suite, and when they were taken [s].
        tile: Its tile of the MultiView, -1 without one.
        obeys: Whose commands it takes meanwhile in place of its client's.
        next_report: When it reports next [s]; never without a client.
    """

    slot: int
    name: str
    suite: Suite
    command: RobotCommand
    spawn_time: float
    drowned: bool = False
    pending: dict[int, np.ndarray] = field(default_factory=dict)
    latest: dict[int, tuple[float, np.ndarray]] = field(default_factory=dict)
    tile: int = -1
    obeys: object = None
    next_report: float = math.inf

    def __post_init__(self) -> None:
        """Give it what its cameras start with."""
        self.described = self.spec
        """Its class, whatever has been edited since; `figures` are those that have been, by their keys."""
        self.figures: dict[str, float] = {}
        self.fovs = [camera.default_fov for camera in self.cameras]
        """Field of view in force of each camera [rad]."""
        self.viewports = Viewports.of([camera.mount.name for camera in self.cameras])

    def begin_again(self, command: RobotCommand) -> None:
        """Forget what it was told and what it has read."""
        self.command, self.drowned = command, False
        self.pending.clear()
        self.latest.clear()
        self.__post_init__()

    @property
    def plan(self) -> KinematicTree:
        """Its body plan."""
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
