"""What wheels make of a robot: a twist of its chassis, which follows their speeds as its class does."""

from dataclasses import dataclass

import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import numpy_backend
from usarmjx.engines.planar.responses import (
    Response,
    UncalibratedRobotError,
    response_of,
    rolls,
    uncalibrated,
)
from usarmjx.models.compile.kinematic_tree import KinematicTree, kinematic_tree_of
from usarmjx.models.compile.layout import RobotIndex
from usarmjx.models.drives.ackermann import Ackermann, Wheel
from usarmjx.models.drives.ground import OmniDrive, SkidSteer
from usarmjx.models.types.robot import RobotSpec

SLOW = 0.05
"""At less speed robots turn as sharply as they like [m/s]."""
STEADY = 1e-6
"""Keeps what no wheel decides at rest."""


@dataclass(frozen=True, eq=False)
class RollingWheels:
    """Wheels that turn at speeds and angles of their own, or only roll along.

    Attributes:
        pos: Where they are on the chassis, ahead and to the left [m] (wheels, 2).
        spin: Places of their joints among the joints (wheels,).
        steer: Places of the joints that they steer by (wheels,); -1: they do not.
        powered: Whether they have a motor (wheels,).
        radius: [m].
    """

    pos: np.ndarray
    spin: np.ndarray
    steer: np.ndarray
    powered: np.ndarray
    radius: float

    def headings(self, joints: Array) -> Array:
        """Return which way wheels roll (robots, wheels, 2)."""
        angle = jnp.where(self.steer < 0, 0.0, joints[:, np.maximum(self.steer, 0)])
        return jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)

    def twist(self, joints: Array, spin: Array) -> Array:
        """Return the twist (robots, 3) that agrees best with how the wheels turn.

        Args:
            joints: Positions of the joints (robots, joints).
            spin: Speeds of the wheels [rad/s] (robots, wheels).
        """
        ahead = self.headings(joints)
        aside = jnp.stack([-ahead[..., 1], ahead[..., 0]], -1)
        rolls, slides = self._rows(ahead), self._rows(aside)
        rolls = rolls * jnp.asarray(self.powered, jnp.float32)[:, None]
        rows = jnp.concatenate([rolls, slides], 1)
        wanted = jnp.concatenate([self.radius * spin * self.powered, jnp.zeros_like(spin)], 1)
        square = (rows[..., :, None] * rows[..., None, :]).sum(1) + STEADY * jnp.eye(3)
        return _solve3(square, (rows * wanted[..., None]).sum(1))

    def spins(self, joints: Array, twist: Array) -> Array:
        """Return how fast wheels turn that roll along with a twist (robots, wheels)."""
        rows = self._rows(self.headings(joints))
        return (rows * twist[:, None]).sum(-1) / self.radius

    def _rows(self, along: Array) -> Array:
        """Return how fast each wheel goes along a direction, by the twist's numbers (robots, wheels, 3)."""
        lever = self.pos[:, 0] * along[..., 1] - self.pos[:, 1] * along[..., 0]
        return jnp.concatenate([along, lever[..., None]], -1)


def _solve3(a: Array, b: Array) -> Array:
    """Return the solutions of 3 x 3 systems (n, 3, 3), (n, 3) by cross products: no batched factorisation."""
    rows = [jnp.cross(a[:, 1], a[:, 2]), jnp.cross(a[:, 2], a[:, 0]), jnp.cross(a[:, 0], a[:, 1])]
    det = (a[:, 0] * rows[0]).sum(-1, keepdims=True)
    return sum(b[:, i : i + 1] * rows[i] for i in range(3)) / det


@dataclass(frozen=True, eq=False)
class SideWheels:
    """Wheels of two sides: skid steering, and tracks.

    Attributes:
        spin: Places of their joints among the joints, the left ones first (wheels,).
        left: How many of them are on the left.
        ratio: Speed of each over its side's (wheels,).
        radius: Of what turns at the side's speed [m].
        track: Distance of the sides [m].
    """

    spin: np.ndarray
    left: int
    ratio: np.ndarray
    radius: float
    track: float

    def twist(self, joints: Array, spin: Array) -> Array:
        """Return forward speed, sideways speed and rate of turn (robots, 3); see `RollingWheels.twist`."""
        del joints
        rim = self.radius * spin / self.ratio
        left, right = rim[:, : self.left].mean(-1), rim[:, self.left :].mean(-1)
        return jnp.stack([(left + right) / 2, jnp.zeros_like(left), (right - left) / self.track], -1)

    def spins(self, joints: Array, twist: Array) -> Array:
        """Return the speeds of the wheels (robots, wheels) that make a twist; see `RollingWheels.spins`."""
        del joints
        side = np.repeat([-1.0, 1.0], [self.left, len(self.spin) - self.left])
        rim = twist[:, :1] + side * twist[:, 2:] * self.track / 2
        return rim * self.ratio / self.radius


Wheels = RollingWheels | SideWheels


def wheels_of(robot: RobotSpec) -> Wheels:
    """Return the wheels of a class that rolls."""
    plan, drive = kinematic_tree_of(robot), robot.drive
    if isinstance(drive, SkidSteer):
        return _sides(plan, drive)
    assert isinstance(drive, Ackermann | OmniDrive)
    return _rolling(plan, drive.wheels, drive.radius)


def _sides(plan: KinematicTree, drive: SkidSteer) -> SideWheels:
    names = (*drive.left, *drive.right)
    spin = np.array([_joint(plan, name) for name in names])
    across = plan.rest_pos[spin + 1, 1]
    left = len(drive.left)
    track = abs(float(across[:left].mean() - across[left:].mean()))
    ones = np.ones((1, 2), np.float32)
    with numpy_backend():
        ratio = np.asarray(drive.targets(ones))[0]
    return SideWheels(spin=spin, left=left, ratio=ratio, radius=drive.radius, track=track)


def _rolling(plan: KinematicTree, wheels: tuple[Wheel, ...], radius: float) -> RollingWheels:
    return RollingWheels(
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
    """The robots of a class that rolls, in a model.

    Attributes:
        wheels: Its wheels.
        response: How it answers them.
        members: Which of the model's robots they are (n,).
        qpos: Where in qpos their joints are (n, joints).
        qvel: Where in qvel they are (n, joints).
        ctrl: Where in ctrl the wheels' inputs are (n, wheels); those without a motor have the last place.
        act: Where in act the wheels' activations are, likewise.
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
    """Return the robots that roll, by class.

    Raises:
        UncalibratedRobotError: The motor response of a class was not measured.
    """
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
    indices, wheels = [robots[number][1] for number in members], wheels_of(robot)
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


def follow(response: Response, before: Array, told: Array, dt: float, grip: Array | float = 1.0) -> Array:
    """Return the twist (robots, 3) after a time in which the wheels were told one, from that before.

    Exact for a first-order lag; the change is held to the class's most.

    Args:
        response: How the class answers.
        before: Forward speed, sideways speed, rate of turn [m/s, rad/s] (robots, 3).
        told: What the wheels make of it in the end (robots, 3).
        dt: Time [s].
        grip: Factor on the most change, for instance of another friction or mass; () or (robots, 1).
    """
    lag = jnp.array([response.forward_lag, response.forward_lag, response.turn_lag])
    most = jnp.array([response.acceleration, response.acceleration, response.turn_acceleration])
    share = -jnp.expm1(-dt / jnp.maximum(lag, 1e-4))
    sharpest = response.cornering / jnp.maximum(jnp.abs(before[..., 0]), SLOW)
    told = jnp.stack([told[..., 0], told[..., 1], jnp.clip(told[..., 2], -sharpest, sharpest)], -1)
    change = (told - before) * share
    if response.sides_apart:
        part = change / (most * dt * grip)
        left = jnp.clip(part[..., 0] - part[..., 2], -1.0, 1.0)
        right = jnp.clip(part[..., 0] + part[..., 2], -1.0, 1.0)
        part = jnp.stack([(left + right) / 2, part[..., 1], (right - left) / 2], -1)
        return before + part * most * dt * grip
    # The motors of both sides are as strong: what one side needs to turn is lost to going ahead.
    effort = (jnp.abs(change) / most).sum(-1, keepdims=True) / (dt * grip)
    return before + change / jnp.maximum(effort, 1.0)
