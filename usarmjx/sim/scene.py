"""A scene: an arena with a roster of robots, composed and resolved. Static; every world is a copy of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import Array
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.mail import MailSettings
from usarmjx.comms.walls import arena_solids
from usarmjx.models.build.arena_set import ArenaSet, arena_set
from usarmjx.models.build.body_plan import BodyPlan, body_plan
from usarmjx.models.build.compose import Physics, add_robot, cap_contacts, new_spec
from usarmjx.models.build.compose_arena import ARENA, BONE
from usarmjx.models.build.layout import RobotIndex, index_robot
from usarmjx.models.build.moved import MovedGeoms
from usarmjx.models.build.parts import parts_of
from usarmjx.models.build.tags import TagTable, tag_table
from usarmjx.models.build.variation import Variation, VariedBodies, check_variation, varies
from usarmjx.models.build.victims import VictimTable, victim_table
from usarmjx.models.effecters import Effecter, effecters_of
from usarmjx.models.files.load import find_arena
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec.arena import START_ELEVATION, ArenaSpec, StartPose
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.rays.targets import check_types
from usarmjx.sensors.suite import Suite, suite_of
from usarmjx.sim.scene_geoms import Look, LooseGeoms, door_qpos, fixed_look, loose_geoms, moved_look

PARKING_HEIGHT = 30.0
"""Robots that no one uses wait this high above the arena, pinned in the air [m] (no contacts, no cost)."""
PARKING_STEP = 8.0
"""Distance between two parked robots [m]: more than a submarine's length."""
START_GAP = 0.002
"""Robots start this far above the floor, so that none starts inside it [m]."""


@dataclass(frozen=True)
class Entry:
    """One robot of a roster.

    Attributes:
        robot: Class name, or a description of one's own.
        name: Name on the wire; empty: the class name and the slot.
        parked: Whether the slot starts unused and waits for a client's INIT.
    """

    robot: str | RobotSpec
    name: str = ""
    parked: bool = False

    @property
    def spec(self) -> RobotSpec:
        """The robot's description.

        Raises:
            UnknownNameError: No such class.
        """
        return ROBOTS.get(self.robot) if isinstance(self.robot, str) else self.robot


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
class Scene:
    """A composed scene.

    Attributes:
        arena: Arena description; of a scene with several arenas, one with room for any of them.
        physics: Solver and time settings.
        roster: The robots, by slot.
        spec: The MuJoCo description, for engines that add and remove robots.
        model: The compiled model.
        teams: The robots by class.
        radio: Constants of the robots' radios; None: they have none.
        mail: Sizes of the messages over it; None: there are none.
        arenas: The arenas, of which each world has one; None: all have `arena`.
        vary: What else differs between worlds and episodes; None: nothing.
    """

    arena: ArenaSpec
    physics: Physics
    roster: tuple[Entry, ...]
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    teams: tuple[Team, ...] = field(default=())
    radio: RadioSettings | None = None
    mail: MailSettings | None = None
    arenas: ArenaSet | None = None
    vary: Variation | None = None

    @cached_property
    def victims(self) -> VictimTable:
        """The victims, where all worlds have the same arena."""
        return victim_table(self.arena.victims, self.arena.false_alarms)

    @cached_property
    def tags(self) -> TagTable:
        """The arena's RFID tags, where all worlds have the same arena."""
        return tag_table(self.arena.tags)

    @property
    def robots(self) -> int:
        """Number of robot slots."""
        return len(self.roster)

    @cached_property
    def swinging(self) -> np.ndarray:
        """The victims' boxes that move, as places in `victims`; where all worlds have the same arena."""
        return np.flatnonzero(self.victims.swing > 0)

    @cached_property
    def moved(self) -> MovedGeoms | None:
        """The arena's geoms that are data; None: there are none."""
        if self.arenas is not None:
            names = tuple(f"{ARENA}{i}" for i in range(len(self.arena.shapes)))
            return MovedGeoms(names=names, longest=self.arenas.longest, resized=True)
        if not len(self.swinging):
            return None
        names = tuple(f"{BONE}{i}" for i in self.swinging)
        return MovedGeoms(names=names, longest=self.victims.size[self.swinging].max(-1), resized=False)

    @cached_property
    def varied(self) -> VariedBodies | None:
        """The robots that vary between worlds; None: nothing varies."""
        if self.vary is None:
            return None
        chassis = np.zeros(self.robots, int)
        which = np.zeros(self.robots, bool)
        owner, wheel = np.full(self.model.nbody, -1), np.zeros(self.model.nbody, bool)
        for team in self.teams:
            rolls = np.array([False, *(part.rolls for part in parts_of(team.robot))])
            for slot, index in zip(team.slots, team.indices, strict=True):
                chassis[slot], which[slot] = index.body[0], varies(self.vary, team.robot)
                if which[slot]:
                    owner[list(index.body)], wheel[list(index.body)] = slot, rolls
        return VariedBodies(vary=self.vary, varies=which, chassis=chassis, owner=owner, wheel=wheel)

    @cached_property
    def _moved_names(self) -> tuple[str, ...]:
        return () if self.moved is None else self.moved.names

    @cached_property
    def fixed_look(self) -> Look:
        """Floor and arena, without the geoms that are data."""
        return fixed_look(self.model, self.arena, self._moved_names)

    @cached_property
    def moved_look(self) -> Look:
        """The geoms that are data; the kinds, materials and sizes of these are of use."""
        return moved_look(self.model, self.arena, self._moved_names)

    @cached_property
    def loose_geoms(self) -> LooseGeoms:
        """What lies loose."""
        return loose_geoms(self.model, self.arena)

    @cached_property
    def door_qpos(self) -> np.ndarray:
        """Qpos addresses of the doors' hinges (doors,)."""
        return door_qpos(self.model, self.arena)

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


def origin_height(arena: ArenaSpec, height: Array, robot: RobotSpec) -> Array:
    """Return the height of a robot's origin when it stands under start poses of some height (...,) [m]."""
    return arena.floor + height - START_ELEVATION + body_plan(robot).clearance + START_GAP


def start_height(arena: ArenaSpec, start: StartPose, robot: RobotSpec) -> float:
    """Return the height of a robot's origin when it stands on the ground under a start pose [m]."""
    return origin_height(arena, start.at[2], robot)


def build_scene(
    arena: str | Path | ArenaSpec | Sequence[ArenaSpec] = "yellow",
    roster: Sequence[str | RobotSpec | Entry] = ("P2AT",),
    physics: Physics | None = None,
    *,
    radio: RadioSettings | None = None,
    mail: MailSettings | None = None,
    vary: Variation | None = None,
) -> Scene:
    """Compose an arena and its robots.

    Args:
        arena: Name, file (see `models.files.load`) or description; or several descriptions, of which each
            world gets one at every reset.
        roster: Class names, descriptions or entries, in slot order; robots that are not parked need a start
            pose each.
        physics: Solver and time settings.
        radio: Constants of the robots' radios; None: they have none, and it costs nothing.
        mail: Sizes of the messages that they send each other over it; None: none.
        vary: What else differs between worlds and episodes: domain randomisation; None: nothing.

    Raises:
        UnknownNameError: Unknown arena, robot class, sensor or setting.
        SpecError: More robots than the arena has start poses; mail without a radio; arenas that cannot be
            together in a batch, see `models.build.arena_set`; a variation that does not go with a robot.
        UnsupportedGeomError: A geom that rays cannot hit, or that the radio cannot count as a wall.
    """
    physics = physics or Physics()
    arenas = None
    if isinstance(arena, (str, Path)):
        arena = find_arena(arena)
    elif not isinstance(arena, ArenaSpec):
        arenas = arena_set(arena)
        arena = arenas.template
    entries = tuple(e if isinstance(e, Entry) else Entry(robot=e) for e in roster)
    if mail is not None and radio is None:
        raise SpecError("mail needs a radio: give build_scene a radio=RadioSettings(...) too")
    if radio is not None:
        arena_solids(arena)
    active = sum(not entry.parked for entry in entries)
    if active > len(arena.starts):
        raise SpecError(f"{active} robots, but arena {arena.name} has {len(arena.starts)} start poses")
    spec = new_spec(arena, physics)
    robots = [entry.spec for entry in entries]
    if vary is not None:
        check_variation(vary, robots, radio is not None)
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
        arenas=arenas,
        vary=vary,
    )


def _teams(model: mujoco.MjModel, entries: tuple[Entry, ...]) -> tuple[Team, ...]:
    slots: dict[RobotSpec, list[int]] = {}
    for slot, entry in enumerate(entries):
        slots.setdefault(entry.spec, []).append(slot)
    teams = []
    for robot, members in slots.items():
        teams.append(
            Team(
                plan=body_plan(robot),
                suite=suite_of(robot),
                slots=np.array(members),
                indices=tuple(index_robot(model, robot, prefix_of(slot)) for slot in members),
            )
        )
    return tuple(teams)
