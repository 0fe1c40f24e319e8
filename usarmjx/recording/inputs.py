"""Inputs of a recorded world: its initial setup and all later changes from outside, enough for a replay.

Each input has the number of control steps that the world had made before it. Class and field names stand in
recordings: do not rename them without an alias in `values`.
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
from usarmjx.models.types.arena import ArenaSpec, LooseObject
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import RosterEntry
from usarmjx.sim.world import GroupState

PACKAGES = ("usarmjx", "mujoco", "mujoco-mjx", "numpy", "jax", "jaxlib")
"""Packages whose versions a recording keeps: other versions may compute other bits."""
SINGLE = "single"
"""Kind of a `SingleWorld`; others have the name of a batch's engine."""
ORDER_FIELDS = ("command", "active", "battery_start", "drowned")
"""Fields of a `GroupState` that change a batch's worlds from outside."""


# Kept, as each version is read from files and every world asks.
@cache
def versions() -> dict[str, str]:
    """Return the versions of the packages here, and the kind of machine, by name."""
    found = {"machine": f"{platform.system()} {platform.machine()}", "python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        # A source tree that is not installed has no version to read.
        except PackageNotFoundError:
            found[package] = "unknown"
    return found


@dataclass(frozen=True, kw_only=True)
class WorldSetup:
    """Initial inputs of a world.

    Attributes:
        kind: `SINGLE`, or the engine of its batch.
        arenas: Its arena, or those that its batch goes through.
        physics: Solver and time settings.
        roster: The robots of a batch, by slot.
        radio: Constants of the radio; None without one.
        mail: Sizes of messages; None without any.
        vary: Randomization between worlds of the batch; None without any.
        shuffle: Whether robots start in a random order.
        seed: Seed of all random numbers.
        first: Number of the batch's first world.
        number: Index of the world in the batch, or number of the world whose random numbers it draws.
        seats: Most robots of a `SINGLE` world.
        worlds: Worlds in the batch.
        steps_before: Control steps made before the recording began.
        repeat: Control steps per call.
        start: Initial positions (nq,); None: those of a reset.
        snapshot: Arrays of the state of a batch of this one world that the recording begins with, see
            `replay.state_arrays`; empty: it begins with a reset.
        reset_bad: Whether a world whose physics is not finite begins its next episode at once.
        spare: Room for other arenas in those of the batch, see `build_scene`.
        versions: Versions of the packages that computed it, by name.
        why_not: Reason why it cannot be replayed; empty if it can.
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
    snapshot: tuple[np.ndarray, ...] = ()
    reset_bad: bool = True
    spare: float = 0.0
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    why_not: str = ""


@dataclass(frozen=True, kw_only=True)
class RobotAdded:
    """Attempt to add a robot to a `SINGLE` world; without room for it the attempt failed.

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
    """Removal of the robot of a slot from a `SINGLE` world."""

    step: int
    slot: int


@dataclass(frozen=True, kw_only=True)
class RobotRedescribed:
    """Replacement of the description of a robot of a `SINGLE` world."""

    step: int
    slot: int
    robot: RobotSpec


@dataclass(frozen=True, kw_only=True)
class RobotPlaced:
    """Pose set for the robot of a slot: position [m] (3,) and orientation (4,)."""

    step: int
    slot: int
    pos: np.ndarray
    quat: np.ndarray


@dataclass(frozen=True, kw_only=True)
class LooseAdded:
    """Attempt to add a loose object to a `SINGLE` world; it fails if there is no room.

    Attributes:
        step: Control steps made by then.
        thing: The object.
        held: Whether it hangs in its place.
    """

    step: int
    thing: LooseObject
    held: bool


@dataclass(frozen=True, kw_only=True)
class LooseRemoved:
    """Removal of a loose object from a `SINGLE` world, by its number."""

    step: int
    number: int


@dataclass(frozen=True, kw_only=True)
class LoosePlaced:
    """Pose set for a loose object, by its number: position [m] (3,) and orientation (4,)."""

    step: int
    number: int
    pos: np.ndarray
    quat: np.ndarray


@dataclass(frozen=True, kw_only=True)
class ConveyorsSet:
    """Speed set for the conveyors of a name, as a share of their own."""

    step: int
    name: str
    share: float


@dataclass(frozen=True, kw_only=True)
class VacuumSet:
    """Vacuum of the robot of a slot that is closed or opened, by its index among the effecters."""

    step: int
    slot: int
    effecter: int
    closes: bool


@dataclass(frozen=True, kw_only=True)
class WorldReset:
    """Restart of the world; the robots are at their spawn poses, or parked."""

    step: int


@dataclass(frozen=True, kw_only=True)
class OrdersGiven:
    """Commands of robots between two control steps: fields of their `GroupState`, by slot."""

    step: int
    orders: Mapping[int, Mapping[str, Any]]


@dataclass(frozen=True, kw_only=True)
class Interrupted:
    """End of the part that can be replayed, with its reason."""

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


Input = (
    RobotAdded
    | RobotRemoved
    | RobotRedescribed
    | RobotPlaced
    | LooseAdded
    | LooseRemoved
    | LoosePlaced
    | ConveyorsSet
    | VacuumSet
    | WorldReset
    | OrdersGiven
    | Interrupted
)
"""An input of a world."""


def batch_setup(batch: Batch, number: int, steps_before: int) -> WorldSetup:
    """Return the initial inputs of a batch, of which one world is recorded.

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
    """Return `ORDER_FIELDS` of a group's robots in a world of a batch; leading axis over robots.

    Args:
        state: The group in all worlds (worlds, robots, ...).
        world: Index of the world.
    """
    return {name: jax.tree.map(lambda x: np.asarray(x)[world], getattr(state, name)) for name in ORDER_FIELDS}
