"""One served world as the adapter sees it: robots come and go, are told things and report.

Two worlds implement it: `live.LiveWorld` (C MuJoCo, any class at any time) and `claim.ClaimedWorld`
(one world of a running batch, where robots wait parked).
"""

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import jax
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.transforms import Vec3
from usarmjx.cameras.mounts import Camera, cameras_of
from usarmjx.cameras.picture import Picture, Viewpoint, viewpoint
from usarmjx.models.build.body_plan import Bodies, BodyPlan
from usarmjx.models.drives.state import RobotState
from usarmjx.models.effecters import Effecter, Opcode, effecters_of
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.sketch import Sketch
from usarmjx.sensors.suite import Memory, Suite, suite_of
from usarmjx.server.messages.victims import written
from usarmjx.server.protocol.multi_view import MultiView
from usarmjx.server.protocol.traces import Traces
from usarmjx.server.protocol.viewports import Ties, Viewports
from usarmjx.sim.control import Command
from usarmjx.sim.operate import OK, Outcome

log = logging.getLogger(__name__)

REACH = 1000.0
"""Nobody spawns further from the origin than this [m]: single precision gets coarse there."""


@dataclass(eq=False)
class Robot:
    """A robot in a served world.

    Attributes:
        slot: Its place in the world.
        name: Its name on the wire.
        suite: Its class's sensors.
        command: What it is told to do; numpy arrays.
        born: World time at which it appeared [s].
        drowned: Whether water has killed its battery.
        pending: Readings that have not been reported yet, by place in the suite.
        view: Its tile of the MultiView, -1 without one.
    """

    slot: int
    name: str
    suite: Suite
    command: Command
    born: float
    drowned: bool = False
    pending: dict[int, np.ndarray] = field(default_factory=dict)
    view: int = -1

    def __post_init__(self) -> None:
        """Give it what its cameras start with."""
        self.fovs = [camera.default for camera in self.cameras]
        """Field of view in force of each camera [rad]."""
        self.viewports = Viewports.of([camera.mount.name for camera in self.cameras])

    @property
    def plan(self) -> BodyPlan:
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

    def camera(self, name: str) -> int | None:
        """Return the place of the first camera of that name, case ignored; None without one."""
        for place, camera in enumerate(self.cameras):
            if camera.mount.name.lower() == name.lower():
                return place
        return None

    def effecter(self, kind: str, name: str) -> int | None:
        """Return the place of the first effecter of that type and name, case ignored; None without one."""
        for place, effecter in enumerate(self.effecters):
            if effecter.is_type(kind) and effecter.mount.name.lower() == name.lower():
                return place
        return None


@dataclass(frozen=True)
class Shot:
    """A picture to take.

    Attributes:
        robot: Whose camera.
        camera: Place of the camera among `robot.cameras`.
        width: [pixels]
        height: [pixels]
    """

    robot: Robot
    camera: int
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class Vista:
    """A picture to take from where no robot's camera need be.

    Attributes:
        eye: From where; numpy arrays.
        width: [pixels]
        height: [pixels]
    """

    eye: Viewpoint
    width: int
    height: int


def status_of(outcome: Outcome) -> str:
    """Return the Status that RES tells of one robot's operation (manual 11)."""
    if not outcome.done:
        return "Failed"
    return "OK" if outcome.number == OK else str(int(outcome.number))


class HostWorld(ABC):
    """A world that clients share. Positions and angles are in our axes."""

    arena: ArenaSpec
    period: float
    robots: dict[int, Robot]
    multi_view: MultiView | None = None
    """How all robots' cameras share a picture, if they do."""

    @cached_property
    def ties(self) -> Ties:
        """Whose view is tied to which camera."""
        return Ties()

    @cached_property
    def traces(self) -> Traces:
        """The points that robots have left behind."""
        return Traces()

    @cached_property
    def tag_texts(self) -> dict[int, str]:
        """What is written on RFID tags, by ID; the others are empty."""
        return written(self.arena)

    @property
    @abstractmethod
    def time(self) -> float:
        """Simulated time since the world began [s]."""

    def prepare(self, robot: RobotSpec) -> None:
        """Do what takes long before the first robot of a class can appear; may run beside the loop."""
        suite_of(robot)

    @abstractmethod
    def spawn(self, robot: RobotSpec, name: str, pos: Vec3, angles: Vec3) -> Robot:
        """Put a robot of that class there.

        Raises:
            UsageError: There is no room for it, or the place is out of reach.
        """

    @abstractmethod
    def remove(self, robot: Robot) -> None:
        """Take the robot out of the world."""

    def battery(self, robot: Robot) -> float:
        """Return for how long the robot's battery lasts yet [s]; 0 when water has killed it."""
        return 0.0 if robot.drowned else max(0.0, robot.spec.battery_life - (self.time - robot.born))

    def free_view(self, robot: RobotSpec) -> int:
        """Return the tile of the MultiView that a new robot of a class gets; -1 when there is none."""
        if self.multi_view is None or not robot.cameras:
            return -1
        taken = {other.view for other in self.robots.values()}
        return next((n for n in range(self.multi_view.camera_num) if n not in taken), -1)

    def zoom(self, robot: Robot, camera: int, fov: float) -> bool:
        """Set a camera's field of view: 0 for its default, and never beyond its limits (manual 9.4).

        Args:
            robot: The robot.
            camera: Place of the camera.
            fov: [rad]

        Returns:
            Whether it has become what was asked for; 0 and what is beyond the limits is not (KRobot.uc).
        """
        robot.fovs[camera] = float(robot.cameras[camera].clamp(fov))
        return abs(robot.fovs[camera] - fov) < 1e-6

    def viewpoint(self, shot: Shot | Vista) -> Viewpoint:
        """Return from where a picture would be taken now; numpy arrays."""
        if isinstance(shot, Vista):
            return shot.eye
        robot, fov = shot.robot, np.float32(shot.robot.fovs[shot.camera])
        return viewpoint(robot.cameras[shot.camera], self.bodies(robot), np.int32(robot.slot), fov)

    @abstractmethod
    def expose(self, shots: Sequence[Shot | Vista]) -> Callable[[], list[Picture]]:
        """Hold still what pictures show; return what then takes them.

        The first half is quick. The second half may run in another thread, while the world goes on.
        """

    @abstractmethod
    def tell(self, robot: Robot, command: Command) -> None:
        """Replace what the robot is told to do."""

    @abstractmethod
    def step(self) -> None:
        """Advance by one control step."""

    @abstractmethod
    def observe(self, due: list[Robot]) -> None:
        """Read the sensors of the robots that are about to report; put fresh readings into `pending`."""

    @abstractmethod
    def state(self, robot: Robot) -> RobotState:
        """Return where the robot is and how it moves; numpy arrays."""

    @abstractmethod
    def bodies(self, robot: Robot) -> Bodies:
        """Return where the robot's bodies are; numpy arrays."""

    @abstractmethod
    def memory(self, robot: Robot) -> Memory:
        """Return what the robot's sensors remember."""

    def sketches(self) -> list[Sketch]:
        """Return what the robots' sensors draw into pictures; numpy arrays."""
        found = []
        for robot in self.robots.values():
            draws = [place for place, sensor in enumerate(robot.suite.sensors) if sensor.draws]
            own = self.memory(robot).own if draws else ()
            found += [robot.suite.sensors[place].sketch(own[place]) for place in draws]
        return jax.device_get(found)

    @abstractmethod
    def door_angles(self) -> np.ndarray:
        """Return how far the arena's doors are open now [rad] (doors,)."""

    @abstractmethod
    def order(self, robot: Robot, sensor: int, opcode: str, params: tuple[float, ...]) -> bool:
        """Carry out a SET command on a sensor; return whether it was valid."""

    @abstractmethod
    def operate(self, robot: Robot, effecter: int, opcode: Opcode, value: float) -> str:
        """Carry out a SET command on an effecter.

        Args:
            robot: The robot.
            effecter: Place among `effecters_of` its class.
            opcode: One of the effecter's operations.
            value: Its parameter.

        Returns:
            The Status that RES tells (manual 11): OK, Failed, or a number.
        """

    @staticmethod
    def check_place(pos: Vec3) -> None:
        """Refuse places out of reach.

        Raises:
            UsageError: Names the place and the reach.
        """
        if not all(math.isfinite(v) and abs(v) <= REACH for v in pos):
            raise UsageError(f"start position {pos} is out of reach: at most {REACH} m from the origin")

    @staticmethod
    def lift(name: str, low: float, floor: float) -> float:
        """Return by how much to raise a robot whose lowest point is at `low` [m], and log it."""
        raised = max(0.0, floor - low)
        if raised > 0:
            log.info("%s would start %.3f m inside the floor: raised", name, raised)
        return raised
