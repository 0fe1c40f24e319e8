"""One served world as the adapter sees it: robots come and go, are told things and report.

Two worlds implement it: `live.LiveWorld` (C MuJoCo, any class at any time) and `claim.ClaimedWorld`
(one world of a running batch, where robots wait parked).
"""

import logging
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from usarmjx.control import Command
from usarmjx.errors import UsageError
from usarmjx.models.arena_spec import ArenaSpec
from usarmjx.models.effecters import Effecter, Opcode, effecters_of
from usarmjx.models.plan import BodyPlan
from usarmjx.models.spec import RobotSpec
from usarmjx.models.state import RobotState
from usarmjx.operate import OK, Outcome
from usarmjx.sensors.suite import Suite, suite_of
from usarmjx.server.found import written
from usarmjx.transforms import Vec3

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
    """

    slot: int
    name: str
    suite: Suite
    command: Command
    born: float
    drowned: bool = False
    pending: dict[int, np.ndarray] = field(default_factory=dict)

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

    def effecter(self, kind: str, name: str) -> int | None:
        """Return the place of the first effecter of that type and name, case ignored; None without one."""
        for place, effecter in enumerate(self.effecters):
            if effecter.is_type(kind) and effecter.mount.name.lower() == name.lower():
                return place
        return None


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
