"""Wheel kinematics and drive response: wheel speeds to a chassis twist and back."""

from dataclasses import dataclass

import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.backend import Array, numpy_backend
from usarmjx.engines.planar.responses import (
    Response,
    UncalibratedRobotError,
    response_of,
    rolls,
    uncalibrated,
)
from usarmjx.models.compile.compose import RobotIndex
from usarmjx.models.compile.kinematic_tree import KinematicTree, kinematic_tree_of
from usarmjx.models.drives.ground import Ackermann, OmniDrive, SkidSteer, Wheel
from usarmjx.models.types.robot import RobotSpec

MIN_CORNERING_SPEED = 0.05
"""Speed below which turning is not limited by lateral acceleration [m/s]."""
REGULARIZATION = 1e-6
"""Regularization of the least squares, which keeps components at zero that no wheel determines."""


@dataclass(frozen=True, eq=False)
class RollingWheels:
    """Wheels with individual speeds and steering angles, powered or passive.

    Attributes:
        pos: Positions on the chassis, ahead and to the left [m] (wheels, 2).
        spin: Indices of their joints among the robot's joints (wheels,).
        steer: Indices of their steering joints (wheels,); -1: none.
        powered: Whether they have a motor (wheels,).
        radius: Wheel radius [m].
    """

    pos: np.ndarray
    spin: np.ndarray
    steer: np.ndarray
    powered: np.ndarray
    radius: float

    def rolling_directions(self, joints: Array) -> Array:
        """Return the rolling directions of the wheels (robots, wheels, 2)."""
        # Wheels without steering (-1) read joint 0, whose angle is thrown away.
        angle = jnp.where(self.steer < 0, 0.0, joints[:, np.maximum(self.steer, 0)])
        return jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)

    def twist(self, joints: Array, spin: Array) -> Array:
        """Return the least-squares twist (robots, 3) for the wheel speeds.

        Args:
            joints: Joint positions (robots, joints).
            spin: Wheel speeds [rad/s] (robots, wheels).
        """
        ahead = self.rolling_directions(joints)
        aside = jnp.stack([-ahead[..., 1], ahead[..., 0]], -1)
        rolls, slides = self._twist_rows(ahead), self._twist_rows(aside)
        # A passive wheel rolls at any speed; only its sideways motion is forbidden.
        rolls = rolls * jnp.asarray(self.powered, jnp.float32)[:, None]
        rows = jnp.concatenate([rolls, slides], 1)
        wanted = jnp.concatenate([self.radius * spin * self.powered, jnp.zeros_like(spin)], 1)
        # Normal equations: wheels want their rolling speed along, and no slip across, their heading.
        square = (rows[..., :, None] * rows[..., None, :]).sum(1) + REGULARIZATION * jnp.eye(
            3, dtype=jnp.float32
        )
        return _solve3(square, (rows * wanted[..., None]).sum(1))

    def wheel_speeds(self, joints: Array, twist: Array) -> Array:
        """Return the speeds of wheels that roll along with a twist (robots, wheels)."""
        rows = self._twist_rows(self.rolling_directions(joints))
        return (rows * twist[:, None]).sum(-1) / self.radius

    def _twist_rows(self, along: Array) -> Array:
        """Return each wheel's speed along a direction as a row of twist coefficients (robots, wheels, 3)."""
        lever = self.pos[:, 0] * along[..., 1] - self.pos[:, 1] * along[..., 0]
        return jnp.concatenate([along, lever[..., None]], -1)


def _solve3(a: Array, b: Array) -> Array:
    """Solve 3 x 3 systems (n, 3, 3), (n, 3) by cross products, without a batched factorisation."""
    rows = [jnp.cross(a[:, 1], a[:, 2]), jnp.cross(a[:, 2], a[:, 0]), jnp.cross(a[:, 0], a[:, 1])]
    # The triple product; cross products of rows are the columns of the inverse, times it.
    det = (a[:, 0] * rows[0]).sum(-1, keepdims=True)
    return sum(b[:, i : i + 1] * rows[i] for i in range(3)) / det


@dataclass(frozen=True, eq=False)
class SideWheels:
    """Wheels of two sides: skid steering, and tracks.

    Attributes:
        spin: Indices of their joints among the robot's joints, left ones first (wheels,).
        left: Number of wheels on the left.
        ratio: Speed of each wheel over its side's (wheels,).
        radius: Radius at which the side's speed is defined [m].
        track: Distance between the sides [m].
    """

    spin: np.ndarray
    left: int
    ratio: np.ndarray
    radius: float
    track: float

    def twist(self, joints: Array, spin: Array) -> Array:
        """Return forward speed, lateral speed and yaw rate (robots, 3); see `RollingWheels.twist`."""
        del joints
        # Small wheels of tracks turn faster for the same speed of the rim.
        rim = self.radius * spin / self.ratio
        left, right = rim[:, : self.left].mean(-1), rim[:, self.left :].mean(-1)
        return jnp.stack([(left + right) / 2, jnp.zeros_like(left), (right - left) / self.track], -1)

    def wheel_speeds(self, joints: Array, twist: Array) -> Array:
        """Return the wheel speeds (robots, wheels) for a twist; see `RollingWheels.wheel_speeds`."""
        del joints
        # Left wheels come first in `spin`.
        side = np.repeat([-1.0, 1.0], [self.left, len(self.spin) - self.left])
        rim = twist[:, :1] + side * twist[:, 2:] * self.track / 2
        return rim * self.ratio / self.radius


Wheels = RollingWheels | SideWheels


def wheel_kinematics(robot: RobotSpec) -> Wheels:
    """Return the wheels of a rolling class."""
    plan, drive = kinematic_tree_of(robot), robot.drive
    if isinstance(drive, SkidSteer):
        return _sides(plan, drive)
    assert isinstance(drive, Ackermann | OmniDrive)
    return _rolling(plan, drive.wheels, drive.radius)


def _sides(plan: KinematicTree, drive: SkidSteer) -> SideWheels:
    names = (*drive.left, *drive.right)
    spin = np.array([_joint(plan, name) for name in names])
    # Part 0 is the chassis, so joint k moves part k + 1.
    across = plan.rest_pos[spin + 1, 1]
    left = len(drive.left)
    track = abs(float(across[:left].mean() - across[left:].mean()))
    ones = np.ones((1, 2), np.float32)
    with numpy_backend():
        ratio = np.asarray(drive.targets(ones))[0]
    return SideWheels(spin=spin, left=left, ratio=ratio, radius=drive.radius, track=track)


def _rolling(plan: KinematicTree, wheels: tuple[Wheel, ...], radius: float) -> RollingWheels:
    return RollingWheels(
        # Wheels of a description are in USARSim's axes, whose y points right.
        pos=np.array([(wheel.x, -wheel.y) for wheel in wheels]),
        spin=np.array([_joint(plan, wheel.joint) for wheel in wheels]),
        steer=np.array([_joint(plan, wheel.steer) if wheel.steer else -1 for wheel in wheels]),
        powered=np.array([wheel.powered for wheel in wheels]),
        radius=radius,
    )


def _joint(plan: KinematicTree, name: str) -> int:
    place = plan.joint_index(name)
    assert place is not None
    return place


@dataclass(frozen=True, eq=False)
class RollingGroup:
    """Robots of one rolling class in a model.

    Attributes:
        wheels: Its wheels.
        response: Its drive response.
        members: Indices of its robots in the model (n,).
        qpos: Indices of their joints in qpos (n, joints).
        qvel: Indices of their joints in qvel (n, joints).
        ctrl: Indices of the wheels' inputs in ctrl (n, wheels); one past the end for a wheel without a motor.
        act: Indices of the wheels' activations in act, likewise.
    """

    wheels: Wheels
    response: Response
    members: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    ctrl: np.ndarray
    act: np.ndarray


def rolling_groups(
    model: mujoco.MjModel, robots: list[tuple[RobotSpec, RobotIndex]]
) -> tuple[RollingGroup, ...]:
    """Return the rolling robots, by class.

    Raises:
        UnsupportedFeatureError: The drive response of a class is unknown.
    """
    # By value: two equal descriptions share their wheels and one computation.
    classes: dict[RobotSpec, list[int]] = {}
    for number, (robot, _) in enumerate(robots):
        if rolls(robot.drive):
            classes.setdefault(robot, []).append(number)
    if missing := uncalibrated(classes):
        raise UncalibratedRobotError(missing)
    return tuple(_group(model, robot, members, robots) for robot, members in classes.items())


def _group(
    model: mujoco.MjModel, robot: RobotSpec, members: list[int], robots: list[tuple[RobotSpec, RobotIndex]]
) -> RollingGroup:
    indices, wheels = [robots[number][1] for number in members], wheel_kinematics(robot)
    actuated = kinematic_tree_of(robot).actuated.tolist()
    places = [actuated.index(joint) if joint in actuated else None for joint in wheels.spin.tolist()]

    def inputs(ids: tuple[int, ...], none: int) -> list[int]:
        return [none if place is None else ids[place] for place in places]

    return RollingGroup(
        wheels=wheels,
        response=response_of(robot),
        members=np.array(members),
        qpos=np.array([index.qposadr for index in indices]),
        qvel=np.array([index.dofadr for index in indices]),
        ctrl=np.array([inputs(index.actuator_ids, model.nu) for index in indices]),
        act=np.array([inputs(index.actadr, model.na) for index in indices]),
    )


def limited_lag(
    response: Response, before: Array, target: Array, dt: float, grip: Array | float = 1.0
) -> Array:
    """Return the twist (robots, 3) after a time step, given the previous twist and the wheels' target.

    The exact first-order lag, with the change limited by the class's accelerations.

    Args:
        response: Drive response of the class.
        before: Previous forward speed, lateral speed and yaw rate [m/s, rad/s] (robots, 3).
        target: Target twist (robots, 3).
        dt: Time step [s].
        grip: Factor on the acceleration limits, for instance for another friction or mass; () or (robots, 1).
    """
    lag = jnp.array([response.forward_lag, response.forward_lag, response.turn_lag])
    most = jnp.array([response.acceleration, response.acceleration, response.turn_acceleration])
    # 1 - exp(-x) by expm1: for steps much shorter than the lag float32 would lose its digits.
    share = -jnp.expm1(-dt / jnp.maximum(lag, 1e-4))
    # Lateral acceleration = speed * yaw rate.
    sharpest = response.cornering / jnp.maximum(jnp.abs(before[..., 0]), MIN_CORNERING_SPEED)
    target = jnp.stack([target[..., 0], target[..., 1], jnp.clip(target[..., 2], -sharpest, sharpest)], -1)
    change = (target - before) * share
    if response.sides_apart:
        # Yaw to the left is positive: it slows the left side and speeds up the right one.
        part = change / (most * dt * grip)
        left = jnp.clip(part[..., 0] - part[..., 2], -1.0, 1.0)
        right = jnp.clip(part[..., 0] + part[..., 2], -1.0, 1.0)
        part = jnp.stack([(left + right) / 2, part[..., 1], (right - left) / 2], -1)
        return before + part * most * dt * grip
    # Both sides have the same motors: torque that one side uses for turning is lost to forward acceleration.
    effort = (jnp.abs(change) / most).sum(-1, keepdims=True) / (dt * grip)
    # All components are scaled alike, so that the path keeps its curvature.
    return before + change / jnp.maximum(effort, 1.0)
