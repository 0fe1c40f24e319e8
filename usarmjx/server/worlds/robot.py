"""A client's robot in a served world."""

import math
from dataclasses import dataclass, field

import numpy as np

from usarmjx.cameras.mounts import Camera, cameras_of
from usarmjx.models.build.body_plan import KinematicTree
from usarmjx.models.effecters import Effecter, effecters_of
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.suite import Suite
from usarmjx.server.protocol.viewports import Viewports
from usarmjx.sim.control import RobotCommand


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
