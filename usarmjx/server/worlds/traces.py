"""Points that robots leave behind on their way, by Trace (manual 9.4); they stay until the server ends."""

from dataclasses import dataclass, field

import numpy as np

from usarmjx.base.transforms import Vec3
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.server.protocol.commands import Trace

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
