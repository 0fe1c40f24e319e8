"""What a world was made of and what came into it from outside: enough to compute all again.

Everything has the control steps that the world had made by then, since the recording of it can begin.
"""

import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import jax
import numpy as np

from usarmjx.base.transforms import Vec3
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.mail import MessageSettings
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import DomainRandomization
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import RosterEntry
from usarmjx.sim.world import GroupState

PACKAGES = ("usarmjx", "mujoco", "mujoco-mjx", "numpy", "jax", "jaxlib")


@cache
def versions() -> dict[str, str]:
    """Return the versions of what computes here, and the kind of machine, by name."""
    found = {"machine": f"{platform.system()} {platform.machine()}", "python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "unknown"
    return found


SINGLE = "single"
"""Kind of a `SingleWorld`; others have the name of a batch's engine."""


@dataclass(frozen=True, kw_only=True)
class WorldSetup:
    """What a world was made of.

    Attributes:
        kind: `SINGLE`, or the engine of the batch that it is one of.
        arenas: Its arena, or those that its batch goes through.
        physics: Solver and time settings.
        roster: The robots of a batch, by slot.
        radio: Constants of the radio; None: the scene has none.
        mail: Sizes of messages; None: there are none.
        vary: What differs between worlds of the batch; None: nothing.
        shuffle: Whether robots start in a random order.
        seed: Of all random numbers.
        first: Number of the batch's first world.
        number: Which world of the batch it is, or of which it draws the random numbers.
        seats: Most robots of a `SINGLE` world.
        worlds: Worlds in the batch.
        steps_before: Control steps made before the recording began.
        repeat: Control steps that are made in one go.
        start: Positions that it starts from (nq,); None: those of a reset.
        versions: Of what computed it, by name.
        why_not: Why it cannot be computed again, in words; empty: it can.
    """

    kind: str
    arenas: tuple[ArenaSpec, ...]
    physics: Physics
    roster: tuple[RosterEntry, ...] = ()
    radio: RadioSettings | None = None
    mail: MessageSettings | None = None
    vary: DomainRandomization | None = None
    shuffle: bool = False
    seed: int = 0
    first: int = 0
    number: int = 0
    seats: int = 0
    worlds: int = 1
    steps_before: int = 0
    repeat: int = 1
    start: np.ndarray | None = None
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    why_not: str = ""


@dataclass(frozen=True, kw_only=True)
class RobotAdded:
    """A robot was to join a `SINGLE` world; where there was no room, it did not.

    Attributes:
        step: Control steps made by then.
        robot: Its class.
        name: Its name.
        poses: Positions [m] and orientations (4,) to choose from.
    """

    step: int
    robot: RobotSpec
    name: str
    poses: tuple[tuple[Vec3, np.ndarray], ...]


@dataclass(frozen=True, kw_only=True)
class RobotRemoved:
    """The robot of a slot was taken out of a `SINGLE` world."""

    step: int
    slot: int


@dataclass(frozen=True, kw_only=True)
class RobotRedescribed:
    """The robot of a slot of a `SINGLE` world got another description."""

    step: int
    slot: int
    robot: RobotSpec


@dataclass(frozen=True, kw_only=True)
class RobotPlaced:
    """The robot of a slot of a batch was put somewhere: position [m] (3,) and orientation (4,)."""

    step: int
    slot: int
    pos: np.ndarray
    quat: np.ndarray


@dataclass(frozen=True, kw_only=True)
class WorldReset:
    """The world began anew; the robots are where they appeared, or parked."""

    step: int


@dataclass(frozen=True, kw_only=True)
class OrdersGiven:
    """What robots were told between two control steps: fields of their `GroupState`, by slot."""

    step: int
    orders: Mapping[int, Mapping[str, Any]]


@dataclass(frozen=True, kw_only=True)
class Interrupted:
    """From here on the world cannot be computed again, for a reason in words."""

    step: int
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class StepState:
    """The physics after a control step, with all its digits.

    Attributes:
        step: Control steps made by then.
        time: Simulated time [s].
        qpos: Positions (nq,).
        qvel: Velocities (nv,).
        act: Activations (na,).
    """

    step: int
    time: float
    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray


Input = RobotAdded | RobotRemoved | RobotRedescribed | RobotPlaced | WorldReset | OrdersGiven | Interrupted
"""What comes into a world."""


ORDER_FIELDS = ("command", "active", "battery_start", "drowned")
"""Fields of a `GroupState` by which worlds of a batch are told what to do."""


def batch_setup(batch: Batch, number: int, steps_before: int) -> WorldSetup:
    """Return what a batch was made of, of which one world is recorded.

    Args:
        batch: The batch.
        number: Index of the world.
        steps_before: Control steps made so far.
    """
    scene = batch.scene
    seed, first, shuffle = batch.origin
    return WorldSetup(
        kind=batch.engine.name,
        arenas=(scene.arena,) if scene.arenas is None else tuple(scene.arenas.arenas),
        physics=scene.physics,
        roster=scene.roster,
        radio=scene.radio,
        mail=scene.mail,
        vary=scene.vary,
        shuffle=shuffle,
        seed=seed,
        first=first,
        number=number,
        worlds=batch.worlds,
        steps_before=steps_before,
        versions=versions(),
    )


def orders_of(state: GroupState, world: int) -> dict[str, Any]:
    """Return what a group's robots of a world of a batch have been told; leading axis over robots.

    Args:
        state: The group in all worlds (worlds, robots, ...).
        world: Index of the world.
    """
    return {name: jax.tree.map(lambda x: np.asarray(x)[world], getattr(state, name)) for name in ORDER_FIELDS}
