"""One served world as the adapter sees it: robots come and go, take commands and report.

Three worlds implement it: `dynamic_world.DynamicWorld` (C MuJoCo, any class at any time),
`batch_world.BatchWorld` (one world of a running batch, where robots wait parked) and
`policy_world.PolicyWorld` (the same with a policy driving the robots that nobody has claimed).
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
from usarmjx.cameras.picture import Picture, Viewpoint, camera_viewpoint
from usarmjx.models.build.body_plan import BodyPoses, KinematicTree
from usarmjx.models.drives.state import RobotState
from usarmjx.models.effecters import Effecter, Opcode, effecters_of
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.sensors.suite import SensorMemory, Suite, suite_of
from usarmjx.server.messages.victims import initial_tag_texts
from usarmjx.server.protocol.multi_view import MultiView
from usarmjx.server.protocol.reports import STATUS_FAILED, STATUS_OK
from usarmjx.server.protocol.viewports import ViewBindings, Viewports
from usarmjx.server.worlds.traces import Traces
from usarmjx.sim.control import RobotCommand
from usarmjx.sim.operate import NO_NUMBER, OperationResult

log = logging.getLogger(__name__)

MAX_COORDINATE = 1000.0
"""Nobody spawns further from the origin than this [m]: single precision gets coarse there."""


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
        tile: Its tile of the MultiView, -1 without one.
    """

    slot: int
    name: str
    suite: Suite
    command: RobotCommand
    spawn_time: float
    drowned: bool = False
    pending: dict[int, np.ndarray] = field(default_factory=dict)
    tile: int = -1

    def __post_init__(self) -> None:
        """Give it what its cameras start with."""
        self.fovs = [camera.default_fov for camera in self.cameras]
        """Field of view in force of each camera [rad]."""
        self.viewports = Viewports.of([camera.mount.name for camera in self.cameras])

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


@dataclass(frozen=True)
class CameraRequest:
    """A picture to render.

    Attributes:
        robot: Whose camera.
        camera: Index of the camera among `robot.cameras`.
        width: [pixels]
        height: [pixels]
    """

    robot: Robot
    camera: int
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class ViewpointRequest:
    """A picture to render from where no robot's camera need be.

    Attributes:
        viewpoint: From where; numpy arrays.
        width: [pixels]
        height: [pixels]
    """

    viewpoint: Viewpoint
    width: int
    height: int


def status_of(outcome: OperationResult) -> str:
    """Return the Status of RES for one robot's operation (manual 11)."""
    if not outcome.done:
        return STATUS_FAILED
    return STATUS_OK if outcome.number == NO_NUMBER else str(int(outcome.number))


class ServedWorld(ABC):
    """A world that clients share. Positions and angles are in our axes.

    A subclass sets `arena`, `period` and `robots` in its constructor and implements what is abstract here:
    robots that come and go (`spawn`, `remove`: both keep `robots`), the step, sensors that are read into
    `Robot.pending`, the present state as numpy arrays, commands and operations, and pictures. What takes long
    before it can be done the first time goes into `warm_up`, if it needs no robot class, and into `prepare`.
    All is called by one thread, the server's loop, except `prepare` and what `snapshot` returns.

    Attributes:
        arena: Where it is.
        period: Length of a control step [s].
        robots: The clients' robots, by slot.
        multi_view: How all robots' cameras share a picture, if they do.
    """

    arena: ArenaSpec
    period: float
    robots: dict[int, Robot]
    multi_view: MultiView | None = None

    @cached_property
    def view_bindings(self) -> ViewBindings:
        """Whose view is bound to which camera."""
        return ViewBindings()

    @cached_property
    def traces(self) -> Traces:
        """The points that robots have left behind."""
        return Traces()

    @cached_property
    def tag_texts(self) -> dict[int, str]:
        """What is written on RFID tags, by ID; the others are empty."""
        return initial_tag_texts(self.arena)

    @property
    @abstractmethod
    def time(self) -> float:
        """Simulated time since the world began [s]."""

    def warm_up(self) -> None:  # noqa: B027 - nothing to compile is fine
        """Compile what the first client would else wait for, before any comes; the world stays as it is."""

    def prepare(self, robot: RobotSpec) -> None:
        """Do what takes long before the first robot of a class can appear; may run in a thread."""
        suite_of(robot)

    @abstractmethod
    def spawn(self, robot: RobotSpec, name: str, pos: Vec3, angles: Vec3) -> Robot:
        """Put a robot of that class there.

        Raises:
            UsageError: There is no room for it, or the position is out of reach.
        """

    @abstractmethod
    def remove(self, robot: Robot) -> None:
        """Take the robot out of the world."""

    def battery(self, robot: Robot) -> float:
        """Return for how long the robot's battery lasts yet [s]; 0 when water has killed it."""
        return 0.0 if robot.drowned else max(0.0, robot.spec.battery_life - (self.time - robot.spawn_time))

    def free_tile(self, robot: RobotSpec) -> int:
        """Return the tile of the MultiView that a new robot of a class gets; -1 when there is none."""
        if self.multi_view is None or not robot.cameras:
            return -1
        taken = {other.tile for other in self.robots.values()}
        return next((n for n in range(self.multi_view.camera_num) if n not in taken), -1)

    def zoom(self, robot: Robot, camera: int, fov: float) -> bool:
        """Set a camera's field of view: 0 for its default, and never beyond its limits (manual 9.4).

        Args:
            robot: The robot.
            camera: Index of the camera.
            fov: [rad]

        Returns:
            Whether it has become what was asked for; 0 and what is beyond the limits is not (KRobot.uc).
        """
        robot.fovs[camera] = float(robot.cameras[camera].clamp(np.array(fov)))
        return abs(robot.fovs[camera] - fov) < 1e-6

    def viewpoint(self, request: CameraRequest | ViewpointRequest) -> Viewpoint:
        """Return from where a picture would be rendered now; numpy arrays."""
        if isinstance(request, ViewpointRequest):
            return request.viewpoint
        robot, camera = request.robot, request.robot.cameras[request.camera]
        slot = np.array(robot.slot, np.int32)
        fov = np.array(robot.fovs[request.camera], np.float32)
        return camera_viewpoint(camera, self.bodies(robot), slot, fov)

    @abstractmethod
    def snapshot(self, requests: Sequence[CameraRequest | ViewpointRequest]) -> Callable[[], list[Picture]]:
        """Take a snapshot of what pictures show; return a function that renders them.

        The first half is quick. The function may run in another thread, while the world goes on.
        """

    @abstractmethod
    def set_command(self, robot: Robot, command: RobotCommand) -> None:
        """Replace the robot's command."""

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
    def bodies(self, robot: Robot) -> BodyPoses:
        """Return where the robot's bodies are; numpy arrays."""

    @abstractmethod
    def memory(self, robot: Robot) -> SensorMemory:
        """Return what the robot's sensors remember."""

    def sketches(self) -> list[OverlayLines]:
        """Return what the robots' sensors draw into pictures; numpy arrays."""
        overlays = []
        for robot in self.robots.values():
            drawn = [index for index, sensor in enumerate(robot.suite.sensors) if sensor.has_overlay]
            own = self.memory(robot).own if drawn else ()
            overlays += [robot.suite.sensors[index].overlay(own[index]) for index in drawn]
        return jax.device_get(overlays)

    @abstractmethod
    def door_angles(self) -> np.ndarray:
        """Return how far the arena's doors are open now [rad] (doors,)."""

    @abstractmethod
    def operate_sensor(self, robot: Robot, sensor: int, opcode: str, params: tuple[float, ...]) -> bool:
        """Carry out a SET command on a sensor; return whether it was valid."""

    @abstractmethod
    def operate(self, robot: Robot, effecter: int, opcode: Opcode, value: float) -> str:
        """Carry out a SET command on an effecter.

        Args:
            robot: The robot.
            effecter: Index among `effecters_of` its class.
            opcode: One of the effecter's operations.
            value: Its parameter.

        Returns:
            The Status of RES (manual 11): `STATUS_OK`, `STATUS_FAILED`, or a number.
        """

    @staticmethod
    def check_position(pos: Vec3) -> None:
        """Refuse positions out of reach.

        Raises:
            UsageError: Names the position and the reach.
        """
        if not all(math.isfinite(v) and abs(v) <= MAX_COORDINATE for v in pos):
            raise UsageError(
                f"start position {pos} is out of reach: at most {MAX_COORDINATE} m from the origin"
            )

    @staticmethod
    def floor_correction(name: str, low: float, floor: float) -> float:
        """Return by how much to raise a robot whose lowest point is at `low` [m], and log it."""
        raised = max(0.0, floor - low)
        if raised > 0:
            log.info("%s would start %.3f m inside the floor: raised", name, raised)
        return raised
