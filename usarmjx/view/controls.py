"""What may be done to worlds from the page, whoever runs them; and the seat of the one who may.

All methods of `WorldControls` return at once and may be called from any thread: they leave a request, which
is carried out between two control steps. What could not be done stands in `WorldStatus.last_error`.
"""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from usarmjx.base.transforms import Vec3

BY_PAGE, BY_CLIENT, BY_POLICY = "page", "client", "policy"
"""Who drives a robot: somebody at the page, a client over TCP, or a policy."""


@dataclass(frozen=True)
class StartPoseChoice:
    """A start pose of an arena: its name, the ground there [m] (3,) and the direction [rad]."""

    tag: str
    pos: Vec3
    yaw: float


@dataclass(frozen=True)
class WorldStatus:
    """How a world goes.

    Attributes:
        time: Simulated time since the world began [s].
        realtime_factor: Simulated seconds per second, of late.
        paused: Whether it stands still.
        speed: Simulated seconds per second that are wanted; 0: as many as there can be.
        connections: How many clients are connected.
        bad_worlds: How often a whole world was reset as its physics had gone bad.
        put_back: How many robots and objects were put back as their physics had gone bad.
        put_back_names: The last of them.
        errors: How many requests could not be carried out so far.
        last_error: Why the last of them could not.
        drivers: Who drives each robot, by slot.
        taken_over: Slots of clients' robots that the page drives meanwhile.
    """

    time: float
    realtime_factor: float = 0.0
    paused: bool = False
    speed: float = 1.0
    connections: int = 0
    bad_worlds: int = 0
    put_back: int = 0
    put_back_names: tuple[str, ...] = ()
    errors: int = 0
    last_error: str = ""
    drivers: Mapping[int, str] = field(default_factory=dict[int, str])
    taken_over: frozenset[int] = frozenset()


class WorldControls(Protocol):
    """What may be done to worlds that run together, which are numbered as the page's source numbers them.

    Attributes:
        reset_about: What a reset does to a world, in a line.
    """

    reset_about: str

    @property
    def classes(self) -> Sequence[str]:
        """Robot classes that can appear."""
        ...

    def status(self, world: int) -> WorldStatus:
        """Return how a world goes."""
        ...

    def starts(self, world: int) -> Sequence[StartPoseChoice]:
        """Return the start poses of a world's arena."""
        ...

    def pause(self, on: bool) -> None:
        """Let all worlds stand still, or go on."""
        ...

    def step(self, steps: int = 1) -> None:
        """Let worlds that stand still make so many control steps."""
        ...

    def set_speed(self, factor: float) -> None:
        """Set how many simulated seconds a second shall have; 0: as many as there can be."""
        ...

    def reset(self, world: int) -> None:
        """Put a world back to its start; the others keep every bit."""
        ...

    def take_over(self, world: int, slot: int, on: bool = True) -> None:
        """Drive a robot that a client or a policy has, or give it back; meanwhile it obeys the page only."""
        ...

    def drive(self, world: int, slot: int, values: Mapping[str, float]) -> None:
        """Set keys of a robot's DRIVE; all are 0 again unless this is called again within half a second."""
        ...

    def set_joint(self, world: int, slot: int, joint: str, position: float) -> None:
        """Let a joint go to a position [rad or m]."""
        ...

    def set_light(self, world: int, slot: int, on: bool) -> None:
        """Switch a robot's headlight."""
        ...

    def zoom(self, world: int, slot: int, camera: str, fov: float) -> None:
        """Set the field of view of a robot's camera [rad]."""
        ...

    def operate(self, world: int, slot: int, effecter: str, opcode: str, value: float | None = None) -> None:
        """Let a robot operate an effecter, as SET does."""
        ...

    def spawn(self, world: int, robot: str, name: str, pos: Vec3, yaw: float) -> None:
        """Let a robot of a class appear with no client.

        Args:
            world: In which world.
            robot: Its class.
            name: Its name; empty: one is found.
            pos: The ground where it shall stand [m] (3,).
            yaw: The direction in which it shall look [rad].
        """
        ...

    def remove(self, world: int, slot: int, anyones: bool = False) -> None:
        """Take a robot out of the world: one that appeared by `spawn`, or anyone's."""
        ...

    def let_go(self) -> None:
        """Stop all robots that the page drives, and give back what it took over."""
        ...


class ControlLock:
    """Which of the people at a page has its controls: the first who asks, until given back.

    Args:
        allowed: Whether anybody may have them.
    """

    def __init__(self, allowed: bool = True) -> None:
        self.allowed = allowed
        self._holder: int | None = None
        self._lock = threading.Lock()

    @property
    def holder(self) -> int | None:
        """Who has them; None: nobody."""
        return self._holder

    def take(self, viewer: int) -> bool:
        """Give the controls to a viewer, if nobody has them; return whether it has them."""
        with self._lock:
            if self.allowed and self._holder is None:
                self._holder = viewer
            return self._holder == viewer

    def leave(self, viewer: int) -> bool:
        """Take the controls from a viewer; return whether it had them."""
        with self._lock:
            had = self._holder == viewer
            if had:
                self._holder = None
            return had
