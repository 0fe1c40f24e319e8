"""A piece of ground with robots of one class on it, and how they are told to go."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from usarmjx.base.transforms import Vec3, quat_from_angles
from usarmjx.models.compile.parts import joint_names
from usarmjx.models.drives import Blimp, RotaryWing, Underwater
from usarmjx.models.effecters import effecters_of
from usarmjx.models.effecters.standard import Gripper
from usarmjx.models.robots.kit import FLIPPERS
from usarmjx.models.types.arena import ArenaSpec, LooseObject, StartPose, Water
from usarmjx.models.types.robot import RobotSpec
from usarmjx.models.types.shapes import Shape

MAX_SPEED = 3.0
"""Fastest that any robot is driven [m/s]."""
FLIPPER_ANGLE = 1.5
"""[rad]"""
START = StartPose(tag="start0", at=(0.0, 0.0, 0.0))
SEA = (Water(low=(-200.0, -200.0, -90.0), high=(200.0, 200.0, 90.0)),)
Order = Mapping[str, float]
LIFTED: Order = dict(
    zip(FLIPPERS, (FLIPPER_ANGLE, FLIPPER_ANGLE, -FLIPPER_ANGLE, -FLIPPER_ANGLE), strict=True)
)
"""Flippers that press down: positive in front and negative behind [rad]."""


@dataclass(frozen=True)
class Orders:
    """Commands that make a class go.

    Attributes:
        straight: Straight on.
        spin: To turn on the spot; None: it cannot.
        arc: Round a bend; None: it does not.
        flippers: Angles of its flippers that lift it, by joint [rad]; None: it has none.
        gripper: Index of the effecter that grips; None: it has none.
    """

    straight: Order
    spin: Order | None = None
    arc: Order | None = None
    flippers: Order | None = None
    gripper: int | None = None


def orders_of(robot: RobotSpec) -> Orders | None:
    """Return how a class is driven; None: by no DRIVE."""
    orders = _drive_orders(robot)
    if orders is None:
        return None
    has_flippers = LIFTED.keys() <= set(joint_names(robot))
    grippers = [i for i, effecter in enumerate(effecters_of(robot)) if isinstance(effecter, Gripper)]
    return replace(
        orders, flippers=LIFTED if has_flippers else None, gripper=grippers[0] if grippers else None
    )


def _drive_orders(robot: RobotSpec) -> Orders | None:
    full, drive = robot.drive.full_scale, robot.drive
    share = min(1.0, MAX_SPEED / drive.top_speed) if full else 0.0
    if "Left" in full:
        top = share * full["Left"]
        return Orders(
            {"Left": top, "Right": top}, {"Left": -top, "Right": top}, {"Left": 0.5 * top, "Right": top}
        )
    if "FrontSteer" in full:
        straight = {"Speed": share * full["Speed"]}
        return Orders(straight, arc=straight | {"FrontSteer": 0.5 * full["FrontSteer"]})
    if "WheelSpeed0" in full:
        return Orders({key: share * top for key, top in full.items() if key.startswith("WheelSpeed")})
    if "LinearVelocity" in full:
        straight = {"LinearVelocity": share * full["LinearVelocity"]}
        spin = {"RotationalVelocity": 0.5 * full["RotationalVelocity"]}
        return Orders(straight, spin, straight | spin)
    if "ThrustPropeller" in full:
        return Orders({"ThrustPropeller": full["ThrustPropeller"]})
    if "Propeller" in full:
        straight = {"Propeller": full["Propeller"]}
        return Orders(straight, arc=straight | {"Rudder": 0.5 * full["Rudder"]})
    return None


def touches_ground(robot: RobotSpec) -> bool:
    """Return whether a class neither flies nor dives."""
    return not isinstance(robot.drive, RotaryWing | Blimp | Underwater)


@dataclass(frozen=True)
class Ground:
    """A piece of ground and the poses of robots on it.

    Attributes:
        shapes: Things that stand there.
        loose: Things that lie there.
        poses: Poses of robots: x, y [m] and heading [rad] of each.
        slope: Slope ahead of the ground, which is one of the shapes then [rad].
    """

    shapes: tuple[Shape, ...] = ()
    loose: tuple[LooseObject, ...] = ()
    poses: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),)
    slope: float = 0.0

    def arena(self, robot: RobotSpec) -> ArenaSpec:
        """Return the arena for robots of a class."""
        return ArenaSpec(
            name="track",
            has_floor=touches_ground(robot) and not self.slope,
            shapes=self.shapes,
            loose=self.loose,
            starts=tuple(replace(START, tag=f"start{i}") for i in range(len(self.poses))),
            waters=SEA if isinstance(robot.drive, Underwater) else (),
            extent=((-50, 50), (-50, 50)),
        )

    def places(self, height: float) -> list[tuple[Vec3, np.ndarray]]:
        """Return position [m] and orientation (4,) of each robot, its origin so far above the ground [m]."""
        ahead = (math.cos(self.slope), math.sin(self.slope))
        up = (-math.sin(self.slope), math.cos(self.slope))
        return [
            (
                (x * ahead[0] + height * up[0], y, x * ahead[1] + height * up[1]),
                quat_from_angles(0.0, -self.slope, yaw),
            )
            for x, y, yaw in self.poses
        ]


class Track(ABC):
    """A world with robots of a class on a piece of ground.

    Args:
        robot: The class.
        period: Length of a control step [s].
    """

    def __init__(self, robot: RobotSpec, period: float) -> None:
        self.robot, self._period = robot, period

    @abstractmethod
    def tell(self, order: Order, slot: int = 0) -> None:
        """Give a robot an order."""

    @abstractmethod
    def move(self, targets: Order) -> None:
        """Tell joints of the first robot where to go [rad]."""

    @abstractmethod
    def advance(self, steps: int) -> None:
        """Let some control steps pass.

        Raises:
            EngineError: The physics went bad.
        """

    @abstractmethod
    def root(self, slot: int = 0) -> np.ndarray:
        """Return position [m] and orientation of a robot (7,)."""

    @abstractmethod
    def thing(self) -> np.ndarray:
        """Return where the first thing that lies there is now [m] (3,)."""

    def run(self, seconds: float) -> None:
        """Let time pass.

        Raises:
            EngineError: The physics went bad.
        """
        self.advance(round(seconds / self._period))

    def pose(self, slot: int = 0) -> tuple[np.ndarray, float]:
        """Return a robot's position [m] (3,) and heading [rad]."""
        root = self.root(slot)
        mat = np.zeros(9)
        mujoco.mju_quat2Mat(mat, root[3:])
        return root[:3], math.atan2(mat[3], mat[0])

    def turn(self, seconds: float) -> float:
        """Let time pass; return how far the first robot turns [rad], with whole turns counted."""
        total, before = 0.0, self.pose()[1]
        for _ in range(round(seconds / 0.1)):
            self.run(0.1)
            now = self.pose()[1]
            total += math.remainder(now - before, 2 * math.pi)
            before = now
        return total
