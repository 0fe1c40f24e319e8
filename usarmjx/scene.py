"""A scene: an arena with a roster of robots, composed and resolved. Static; every world is a copy of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import mujoco
import numpy as np

from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.mail import MailSettings
from usarmjx.comms.walls import arena_solids
from usarmjx.errors import SpecError
from usarmjx.models.arena_spec import ArenaSpec, StartPose
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compose import LOOSE, Physics, add_robot, cap_contacts, new_spec
from usarmjx.models.effecters import Effecter, effecters_of
from usarmjx.models.layout import RobotIndex, index_robot
from usarmjx.models.plan import BodyPlan, body_plan
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec import RobotSpec
from usarmjx.sensors.raycast import check_types
from usarmjx.sensors.suite import Suite, suite_of

PARKING_HEIGHT = 30.0
"""Robots that no one uses wait this high above the arena, pinned in the air [m] (no contacts, no cost)."""
PARKING_STEP = 8.0
"""Distance between two parked robots [m]: more than a submarine's length."""
START_GAP = 0.002
"""Robots start this far above the floor, so that none starts inside it [m]."""
START_ELEVATION = 0.188
"""How high above the ground under it a start pose is given [m] (manual 5.3.5)."""


@dataclass(frozen=True)
class Entry:
    """One robot of a roster.

    Attributes:
        robot: Class name.
        name: Name on the wire; empty: the class name and the slot.
        parked: Whether the slot starts unused and waits for a client's INIT.
    """

    robot: str
    name: str = ""
    parked: bool = False


@dataclass(frozen=True, eq=False)
class Team:
    """The robots of one class in a scene; arrays have a leading axis over them.

    Attributes:
        plan: Body plan of the class.
        suite: Its sensors.
        slots: Roster slots of the robots (n,).
        indices: Where each lies in the model.
    """

    plan: BodyPlan
    suite: Suite
    slots: np.ndarray
    indices: tuple[RobotIndex, ...]

    @property
    def robot(self) -> RobotSpec:
        """The robot class."""
        return self.plan.robot

    @property
    def effecters(self) -> tuple[Effecter, ...]:
        """The effecters of the class."""
        return effecters_of(self.robot)

    @property
    def stock(self) -> tuple[int, ...]:
        """What each effecter carries to release."""
        return tuple(effecter.stock for effecter in self.effecters)

    @cached_property
    def root_qpos(self) -> np.ndarray:
        """Qpos addresses of the free joints (n, 7)."""
        return np.array([index.root_qpos + np.arange(7) for index in self.indices])

    @cached_property
    def root_dof(self) -> np.ndarray:
        """Qvel addresses of the free joints (n, 6)."""
        return np.array([index.root_dof + np.arange(6) for index in self.indices])

    @cached_property
    def qpos(self) -> np.ndarray:
        """Qpos addresses of the joints (n, joints)."""
        return np.array([index.qpos for index in self.indices], int)

    @cached_property
    def dof(self) -> np.ndarray:
        """Qvel addresses of the joints (n, joints)."""
        return np.array([index.dof for index in self.indices], int)

    @cached_property
    def actuator(self) -> np.ndarray:
        """Ids of the actuators that pull (n, actuators)."""
        return np.array([index.actuator for index in self.indices], int)

    @cached_property
    def activation(self) -> np.ndarray:
        """Addresses of the actuators' activations (n, actuators)."""
        return np.array([index.activation for index in self.indices], int)

    @cached_property
    def hold(self) -> np.ndarray:
        """Ids of the actuators that hold the joints (n, actuators)."""
        return np.array([index.hold for index in self.indices], int)

    @cached_property
    def chassis(self) -> np.ndarray:
        """Body ids of the chassis (n,)."""
        return np.array([index.body[0] for index in self.indices])


@dataclass(frozen=True, eq=False)
class ArenaGeoms:
    """Floor and arena geoms: MuJoCo types (n,), positions (n, 3), orientations (n, 3, 3), sizes (n, 3)."""

    kind: np.ndarray
    pos: np.ndarray
    mat: np.ndarray
    size: np.ndarray


@dataclass(frozen=True, eq=False)
class LooseGeoms:
    """Geoms of loose objects, in the frames of their objects.

    Attributes:
        root_qpos: Qpos addresses of the objects' free joints (objects, 7).
        owner: The object that each geom belongs to (geoms,).
        local: Type, position, orientation and size of the geoms, as in `ArenaGeoms`.
    """

    root_qpos: np.ndarray
    owner: np.ndarray
    local: ArenaGeoms


@dataclass(frozen=True, eq=False)
class Scene:
    """A composed scene.

    Attributes:
        arena: Arena description.
        physics: Solver and time settings.
        roster: The robots, by slot.
        spec: The MuJoCo description, for engines that add and remove robots.
        model: The compiled model.
        teams: The robots by class.
        radio: Constants of the robots' radios; None: they have none.
        mail: Sizes of the messages over it; None: there are none.
    """

    arena: ArenaSpec
    physics: Physics
    roster: tuple[Entry, ...]
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    teams: tuple[Team, ...] = field(default=())
    radio: RadioSettings | None = None
    mail: MailSettings | None = None

    @property
    def robots(self) -> int:
        """Number of robot slots."""
        return len(self.roster)

    @cached_property
    def arena_geoms(self) -> ArenaGeoms:
        """What of the scene does not belong to a robot."""
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        fixed = self.model.geom_bodyid < 2  # the world's own body and the arena's
        return ArenaGeoms(
            kind=self.model.geom_type[fixed],
            pos=data.geom_xpos[fixed].astype(np.float32),
            mat=data.geom_xmat[fixed].reshape(-1, 3, 3).astype(np.float32),
            size=self.model.geom_size[fixed].astype(np.float32),
        )

    @cached_property
    def loose_geoms(self) -> LooseGeoms:
        """What of the scene lies loose."""
        model, names = self.model, [f"{LOOSE}{loose.name}" for loose in self.arena.loose]
        bodies = [model.body(name).id for name in names]
        roots = [int(model.joint(name).qposadr[0]) for name in names]
        mine = np.isin(model.geom_bodyid, bodies)
        mats = np.zeros((int(mine.sum()), 9))
        for mat, quat in zip(mats, model.geom_quat[mine], strict=True):
            mujoco.mju_quat2Mat(mat, quat)
        return LooseGeoms(
            root_qpos=np.array([root + np.arange(7) for root in roots], int).reshape(len(roots), 7),
            owner=np.searchsorted(bodies, model.geom_bodyid[mine]),
            local=ArenaGeoms(
                kind=model.geom_type[mine],
                pos=model.geom_pos[mine].astype(np.float32),
                mat=mats.reshape(-1, 3, 3).astype(np.float32),
                size=model.geom_size[mine].astype(np.float32),
            ),
        )

    def team_of(self, slot: int) -> tuple[int, int]:
        """Return (team, place in the team) of a roster slot."""
        for t, team in enumerate(self.teams):
            places = np.flatnonzero(team.slots == slot)
            if places.size:
                return t, int(places[0])
        raise SpecError(f"slot {slot} is not in the roster of {self.robots} robots")


def prefix_of(slot: int) -> str:
    """Return the prefix of the names of a slot's robot in the model."""
    return f"r{slot}/"


def parking_place(arena: ArenaSpec, slot: int) -> tuple[float, float, float]:
    """Return where the robot of a slot waits while unused [m]."""
    row, column = divmod(slot, 8)
    return (PARKING_STEP * column, PARKING_STEP * row, arena.floor + PARKING_HEIGHT)


def start_height(arena: ArenaSpec, start: StartPose, robot: RobotSpec) -> float:
    """Return the height of a robot's origin when it stands on the ground under a start pose [m]."""
    ground = arena.floor + start.at[2] - START_ELEVATION
    return ground + body_plan(robot).clearance + START_GAP


def build_scene(
    arena: str | ArenaSpec = "yellow",
    roster: Sequence[str | Entry] = ("P2AT",),
    physics: Physics | None = None,
    *,
    radio: RadioSettings | None = None,
    mail: MailSettings | None = None,
) -> Scene:
    """Compose an arena and its robots.

    Args:
        arena: Name or description.
        roster: Class names or entries, in slot order; robots that are not parked need a start pose each.
        physics: Solver and time settings.
        radio: Constants of the robots' radios; None: they have none, and it costs nothing.
        mail: Sizes of the messages that they send each other over it; None: none.

    Raises:
        UnknownNameError: Unknown arena, robot class, sensor or setting.
        SpecError: More robots than the arena has start poses; mail without a radio.
        UnsupportedGeomError: A geom that rays cannot hit, or that the radio cannot count as a wall.
    """
    physics = physics or Physics()
    arena = ARENAS.get(arena) if isinstance(arena, str) else arena
    entries = tuple(Entry(robot=e) if isinstance(e, str) else e for e in roster)
    if mail is not None and radio is None:
        raise SpecError("mail needs a radio: give build_scene a radio=RadioSettings(...) too")
    if radio is not None:
        arena_solids(arena)
    active = sum(not entry.parked for entry in entries)
    if active > len(arena.starts):
        raise SpecError(f"{active} robots, but arena {arena.name} has {len(arena.starts)} start poses")
    spec = new_spec(arena, physics)
    robots = [ROBOTS.get(entry.robot) for entry in entries]
    for slot, robot in enumerate(robots):
        add_robot(spec, robot, prefix_of(slot), parking_place(arena, slot))
    cap_contacts(spec, physics, arena, robots)
    model = spec.compile()
    check_types(model.geom_type, [model.geom(i).name for i in range(model.ngeom)])
    return Scene(
        arena=arena,
        physics=physics,
        roster=entries,
        spec=spec,
        model=model,
        teams=_teams(model, entries),
        radio=radio,
        mail=mail,
    )


def _teams(model: mujoco.MjModel, entries: tuple[Entry, ...]) -> tuple[Team, ...]:
    slots: dict[str, list[int]] = {}
    for slot, entry in enumerate(entries):
        slots.setdefault(ROBOTS.get(entry.robot).name, []).append(slot)
    teams = []
    for name, members in slots.items():
        robot = ROBOTS.get(name)
        teams.append(
            Team(
                plan=body_plan(robot),
                suite=suite_of(robot),
                slots=np.array(members),
                indices=tuple(index_robot(model, robot, prefix_of(slot)) for slot in members),
            )
        )
    return tuple(teams)
