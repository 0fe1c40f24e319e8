"""Controls of worlds on the page, whichever program runs them, and the lock of the one user who holds them.

All methods of `WorldControls` return at once and may be called from any thread: they leave a request, which
is carried out between two control steps. The reason of a failure stands in `WorldStatus.last_error`.
"""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from usarmjx.base.transforms import Vec3

BY_PAGE, BY_CLIENT, BY_POLICY = "page", "client", "policy"
"""Drivers of a robot: a user of the page, a client over TCP, or a policy."""


@dataclass(frozen=True)
class StartPoseChoice:
    """A start pose of an arena: its name, the ground there [m] (3,) and the direction [rad]."""

    tag: str
    pos: Vec3
    yaw: float


@dataclass(frozen=True)
class WorldStatus:
    """Status of a world.

    Attributes:
        time: Simulated time since the world began [s].
        realtime_factor: Recent simulated seconds per second.
        paused: Whether it is paused.
        speed: Wanted simulated seconds per second; 0: as many as possible.
        connections: Number of connected clients.
        bad_worlds: Number of resets of the whole world after its physics diverged.
        put_back: Number of robots and objects that were returned to their initial poses for that reason.
        put_back_names: The last of them.
        errors: Number of failed requests so far.
        last_error: Reason of the last failure.
        drivers: Driver of each robot, by slot.
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
    """Controls of worlds that run together; their numbers are those of the page's source.

    Attributes:
        reset_about: Description of a reset, in one line.
    """

    reset_about: str

    @property
    def classes(self) -> Sequence[str]:
        """Robot classes that can be spawned."""
        ...

    def status(self, world: int) -> WorldStatus:
        """Return the status of a world."""
        ...

    def starts(self, world: int) -> Sequence[StartPoseChoice]:
        """Return the start poses of a world's arena."""
        ...

    def pause(self, on: bool) -> None:
        """Pause all worlds, or let them go on."""
        ...

    def step(self, steps: int = 1) -> None:
        """Make some control steps in paused worlds."""
        ...

    def set_speed(self, factor: float) -> None:
        """Set the simulated seconds per second; 0: as many as possible."""
        ...

    def reset(self, world: int) -> None:
        """Restart a world; the others keep every bit."""
        ...

    def take_over(self, world: int, slot: int, on: bool = True) -> None:
        """Take over a robot from its client or policy, or give it back; meanwhile only the page drives it."""
        ...

    def drive(self, world: int, slot: int, values: Mapping[str, float]) -> None:
        """Set keys of a robot's DRIVE; all are 0 again unless this is called again within half a second."""
        ...

    def set_joint(self, world: int, slot: int, joint: str, position: float) -> None:
        """Move a joint to a position [rad or m]."""
        ...

    def set_light(self, world: int, slot: int, on: bool) -> None:
        """Switch a robot's headlight."""
        ...

    def zoom(self, world: int, slot: int, camera: str, fov: float) -> None:
        """Set the field of view of a robot's camera [rad]."""
        ...

    def operate(self, world: int, slot: int, effecter: str, opcode: str, value: float | None = None) -> None:
        """Operate an effecter of a robot, as SET does."""
        ...

    def spawn(self, world: int, robot: str, name: str, pos: Vec3, yaw: float) -> None:
        """Spawn a robot of a class with no client.

        Args:
            world: Number of the world.
            robot: Its class.
            name: Its name; empty for one that the simulator chooses.
            pos: Point of the ground below it [m] (3,).
            yaw: Its heading [rad].
        """
        ...

    def remove(self, world: int, slot: int, any_owner: bool = False) -> None:
        """Remove a robot from the world: one that `spawn` added, or anyone's."""
        ...

    def release_all(self) -> None:
        """Stop all robots that the page drives, and give back what it took over."""
        ...


class ControlLock:
    """Lock of a page's controls: the first user who asks holds them until they are given back.

    Args:
        allowed: Whether any user may hold them.
    """

    def __init__(self, allowed: bool = True) -> None:
        self.allowed = allowed
        self._holder: int | None = None
        self._lock = threading.Lock()

    @property
    def holder(self) -> int | None:
        """Client number of the user with the controls; None without one."""
        return self._holder

    def take(self, viewer: int) -> bool:
        """Give the controls to a user, if no other has them; return whether the user has them."""
        # Users' clicks come on threads of their own.
        with self._lock:
            if self.allowed and self._holder is None:
                self._holder = viewer
            return self._holder == viewer

    def leave(self, viewer: int) -> bool:
        """Release the controls of a user; return whether the user had them."""
        with self._lock:
            # Only the holder's own release counts: a second user who closes the page must not take it away.
            had = self._holder == viewer
            if had:
                self._holder = None
            return had
