"""A scene: an arena with a roster of robots, composed and resolved. Static; every world is a copy of it."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from usarmjx.base.backend import ArrayLike
from usarmjx.base.errors import SpecError, UsageError
from usarmjx.base.tables import facts_table
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.mail import MessageSettings
from usarmjx.comms.walls import arena_solids
from usarmjx.models.compile.arena_set import ArenaSet, ArenaState, arena_set
from usarmjx.models.compile.compose import (
    ARENA_PREFIX,
    DOOR_PREFIX,
    LOOSE_PREFIX,
    VICTIM_PREFIX,
    RobotIndex,
    add_robot,
    cap_contacts,
    index_robot,
    materials_of,
    new_spec,
    textures_of,
)
from usarmjx.models.compile.geoms import MovedGeoms
from usarmjx.models.compile.kinematic_tree import KinematicTree, kinematic_tree_of
from usarmjx.models.compile.parts import parts_of
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import (
    DomainRandomization,
    RandomizedBodies,
    check_randomization,
    is_randomized,
)
from usarmjx.models.compile.ray_geoms import ray_primitives_of
from usarmjx.models.compile.standing import stance_of, standing_height
from usarmjx.models.compile.tags import TagTable, tag_table
from usarmjx.models.compile.victims import VictimTable, victim_table
from usarmjx.models.effecters import Effecter, effecters_of
from usarmjx.models.files.find_robot import find_robot
from usarmjx.models.files.load import find_arena
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.cameras.paint import labels_of
from usarmjx.sensors.rays.targets import check_ray_kinds
from usarmjx.sensors.suite import Suite, suite_of


@dataclass(frozen=True, eq=False)
class RobotGroup:
    """The robots of one class in a scene; arrays have a leading axis over them.

    Attributes:
        plan: Body plan of the class.
        suite: Its sensors.
        slots: Roster slots of the robots (n,).
        indices: Indices of each in the model.
    """

    plan: KinematicTree
    suite: Suite
    slots: np.ndarray
    indices: tuple[RobotIndex, ...]

    @property
    def robot(self) -> RobotSpec:
        """The robot class."""
        return self.plan.robot

    def part(self, members: np.ndarray) -> "RobotGroup":
        """Return a group of some of its robots (members,)."""
        return replace(
            self, slots=self.slots[members], indices=tuple(self.indices[int(i)] for i in members.tolist())
        )

    @property
    def effecters(self) -> tuple[Effecter, ...]:
        """The effecters of the class."""
        return effecters_of(self.robot)

    @property
    def releases(self) -> tuple[int, ...]:
        """Stock of each effecter at the start."""
        return tuple(effecter.initial_stock for effecter in self.effecters)

    @cached_property
    def root_qposadr(self) -> np.ndarray:
        """Qpos addresses of the free joints (n, 7)."""
        return np.array([index.root_qposadr + np.arange(7) for index in self.indices])

    @cached_property
    def root_dofadr(self) -> np.ndarray:
        """Qvel addresses of the free joints (n, 6)."""
        return np.array([index.root_dofadr + np.arange(6) for index in self.indices])

    @cached_property
    def qposadr(self) -> np.ndarray:
        """Qpos addresses of the joints (n, joints)."""
        return np.array([index.qposadr for index in self.indices], int)

    @cached_property
    def dofadr(self) -> np.ndarray:
        """Qvel addresses of the joints (n, joints)."""
        return np.array([index.dofadr for index in self.indices], int)

    @cached_property
    def actuator_ids(self) -> np.ndarray:
        """Ids of the actuators that pull (n, actuators)."""
        return np.array([index.actuator_ids for index in self.indices], int)

    @cached_property
    def actadr(self) -> np.ndarray:
        """Addresses of the actuators' activations (n, actuators)."""
        return np.array([index.actadr for index in self.indices], int)

    @cached_property
    def hold_actuator_ids(self) -> np.ndarray:
        """Ids of the actuators that hold the joints (n, actuators)."""
        return np.array([index.hold_actuator_ids for index in self.indices], int)

    @cached_property
    def chassis(self) -> np.ndarray:
        """Body ids of the chassis (n,)."""
        return np.array([index.body_ids[0] for index in self.indices])


def prefix_of(slot: int) -> str:
    """Return the prefix of the names of a slot's robot in the model."""
    return f"r{slot}/"


def robot_groups(model: mujoco.MjModel, robots: Mapping[int, RobotSpec]) -> tuple[RobotGroup, ...]:
    """Return the robots of a model, by slot, as groups by class."""
    # By description: robots of one class are in one group, wherever they are in the roster.
    slots: dict[RobotSpec, list[int]] = {}
    for slot, robot in robots.items():
        slots.setdefault(robot, []).append(slot)
    return tuple(
        RobotGroup(
            plan=kinematic_tree_of(robot),
            suite=suite_of(robot),
            slots=np.array(members),
            indices=tuple(index_robot(model, robot, prefix_of(slot)) for slot in members),
        )
        for robot, members in slots.items()
    )


@dataclass(frozen=True, eq=False)
class GeomTable:
    """Pieces of geoms.

    Attributes:
        geom: Ids of the geoms that they belong to (n,).
        kind: MuJoCo types, or kinds of `models.compile.ray_geoms` (n,).
        pos: Positions [m] (n, 3).
        mat: Orientations (n, 3, 3).
        size: Size numbers [m] (n, 3).
        material: Their materials; members of `shapes.MATERIALS` (n,).
        rgb: Their colours (n, 3).
        label: Their labels in a segmentation, see `cameras.paint` (n,).
        texture: Codes of what is on them, see `shapes.texture_names` (n,).
    """

    geom: np.ndarray
    kind: np.ndarray
    pos: np.ndarray
    mat: np.ndarray
    size: np.ndarray
    material: np.ndarray
    rgb: np.ndarray
    label: np.ndarray
    texture: np.ndarray


@dataclass(frozen=True, eq=False)
class LooseGeoms:
    """Geoms of loose objects.

    Attributes:
        root_qposadr: Qpos addresses of the objects' free joints (objects, 7).
        root_dof: Qvel addresses (objects, 6).
        owner: The object that each piece belongs to (n,).
        local: The pieces, in the frames of their objects.
    """

    root_qposadr: np.ndarray
    root_dof: np.ndarray
    owner: np.ndarray
    local: GeomTable


def fixed_geoms(model: mujoco.MjModel, arena: ArenaSpec, moved: Sequence[str]) -> GeomTable:
    """Return floor and arena as they are in the model, without the geoms that are data."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    names = [model.geom(i).name for i in range(model.ngeom)]
    left = (model.geom_bodyid < 2) & ~np.isin(names, list(moved))  # the world's own body and the arena's
    fixed = np.flatnonzero(left)
    return _geom_table(model, arena, fixed, data.geom_xpos[fixed], data.geom_xmat[fixed].reshape(-1, 3, 3))


def moved_geom_table(model: mujoco.MjModel, arena: ArenaSpec, moved: Sequence[str]) -> GeomTable:
    """Return the geoms that are data, in the axes of the arena, where the model has them."""
    geoms = np.array([model.geom(name).id for name in moved], int)
    return _geom_table(model, arena, geoms, model.geom_pos[geoms], _matrices(model.geom_quat[geoms]))


def loose_geoms(model: mujoco.MjModel, arena: ArenaSpec) -> LooseGeoms:
    """Return the geoms of the arena's loose objects."""
    names = [f"{LOOSE_PREFIX}{loose.name}" for loose in arena.loose]
    bodies = [model.body(name).id for name in names]
    mine = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
    local = _geom_table(model, arena, mine, model.geom_pos[mine], _matrices(model.geom_quat[mine]))
    joints = [model.joint(name) for name in names]
    return LooseGeoms(
        root_qposadr=np.array([j.qposadr[0] + np.arange(7) for j in joints], int).reshape(-1, 7),
        root_dof=np.array([j.dofadr[0] + np.arange(6) for j in joints], int).reshape(-1, 6),
        # `bodies` rises: MuJoCo numbers bodies in the order in which the arena's objects are added.
        owner=np.searchsorted(bodies, model.geom_bodyid[local.geom]),
        local=local,
    )


def door_qpos(model: mujoco.MjModel, arena: ArenaSpec) -> np.ndarray:
    """Return the qpos addresses of the doors' hinges (doors,)."""
    return np.array([model.joint(f"{DOOR_PREFIX}{door.name}").qposadr[0] for door in arena.doors], int)


def _matrices(quats: np.ndarray) -> np.ndarray:
    mats = np.zeros((len(quats), 9))
    for mat, quat in zip(mats, quats, strict=True):
        mujoco.mju_quat2Mat(mat, quat)
    return mats.reshape(-1, 3, 3)


def _geom_table(
    model: mujoco.MjModel, arena: ArenaSpec, geoms: np.ndarray, pos: np.ndarray, mat: np.ndarray
) -> GeomTable:
    pieces = ray_primitives_of(model, geoms, materials_of(model, arena))
    world_pos, world_mat = pieces.world_poses(pos, mat)
    return GeomTable(
        geom=geoms[pieces.geom],
        kind=pieces.kind,
        pos=np.asarray(world_pos, np.float32),
        mat=np.asarray(world_mat, np.float32),
        size=pieces.size,
        material=pieces.material,
        rgb=model.geom_rgba[geoms[pieces.geom], :3].astype(np.float32),
        label=labels_of(model, arena)[geoms[pieces.geom]],
        texture=textures_of(model, arena)[geoms[pieces.geom]],
    )


PARKING_HEIGHT = 30.0
"""Robots that no one uses wait this high above the arena, pinned in the air [m] (no contacts, no cost)."""
PARKING_STEP = 8.0
"""Distance between two parked robots [m]: more than a submarine's length."""
ARENA_TABLES = frozenset(
    {
        "victims",
        "tags",
        "moving_victim_boxes",
        "moved_geoms",
        "_moved_names",
        "fixed_geoms",
        "moved_geom_table",
        "loose_geoms",
        "door_qpos",
    }
)
"""The properties of a scene that are those of its arena, whatever robots there are."""


@dataclass(frozen=True)
class RosterEntry:
    """One robot of a roster.

    Attributes:
        robot: Class name, or the caller's own description.
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
        return find_robot(self.robot)


# Compared by identity: a scene's arrays have no truth value, and JAX hashes what programs close over.
@dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """A composed scene.

    Attributes:
        arena: Arena description; of a scene with several arenas, one with room for any of them.
        physics: Solver and time settings.
        roster: The robots, by slot.
        spec: The MuJoCo description, for engines that add and remove robots.
        model: The compiled model.
        groups: The robots by class.
        radio: Constants of the robots' radios; None: they have none.
        mail: Sizes of the messages over it; None: there are none.
        arenas: The arenas, of which each world has one; None: all have `arena`.
        vary: Domain randomization between worlds and episodes; None: none.
    """

    arena: ArenaSpec
    physics: Physics
    roster: tuple[RosterEntry, ...]
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    groups: tuple[RobotGroup, ...] = field(default=())
    radio: RadioSettings | None = None
    mail: MessageSettings | None = None
    arenas: ArenaSet | None = None
    vary: DomainRandomization | None = None

    def __repr__(self) -> str:
        """Return a short line: JAX asks for it whenever it compiles a function that closes over a scene."""
        return f"Scene({self.arena.name!r}, {self.num_robots} robots)"

    @property
    def facts(self) -> dict[str, object]:
        """Facts of the scene by name, for display."""
        counts = Counter(entry.spec.name for entry in self.roster)
        return {
            "arena": self.arena.name if self.arenas is None else "one of several in each world",
            "robots": ", ".join(f"{count} {name}" for name, count in counts.items()) or "none",
            "victims": len(self.arena.victims),
            "solids": self.model.ngeom,
            "radio": "yes" if self.radio else "no",
            "control step [s]": self.physics.period,
        }

    def _repr_html_(self) -> str:
        return facts_table("Scene", self.facts)

    @cached_property
    def victims(self) -> VictimTable:
        """The victims, where all worlds have the same arena."""
        return victim_table(self.arena.victims, self.arena.false_alarms)

    @cached_property
    def tags(self) -> TagTable:
        """The arena's RFID tags, where all worlds have the same arena."""
        return tag_table(self.arena.tags)

    @property
    def num_robots(self) -> int:
        """Number of robot slots."""
        return len(self.roster)

    @cached_property
    def moving_victim_boxes(self) -> np.ndarray:
        """The victims' boxes that move, as indices into `victims`; for scenes with one arena."""
        return np.flatnonzero(self.victims.swing > 0)

    @cached_property
    def moved_geoms(self) -> MovedGeoms | None:
        """The arena's geoms that are data; None: there are none."""
        if self.arenas is not None:
            names = tuple(f"{ARENA_PREFIX}{i}" for i in range(len(self.arena.shapes)))
            return MovedGeoms(names=names, max_half_length=self.arenas.max_half_length, resized=True)
        if not len(self.moving_victim_boxes):
            return None
        names = tuple(f"{VICTIM_PREFIX}{i}" for i in self.moving_victim_boxes)
        return MovedGeoms(
            names=names,
            max_half_length=np.asarray(self.victims.size)[self.moving_victim_boxes].max(-1),
            resized=False,
        )

    @cached_property
    def varied_bodies(self) -> RandomizedBodies | None:
        """The robots that vary between worlds; None: nothing varies."""
        if self.vary is None:
            return None
        chassis = np.zeros(self.num_robots, int)
        which = np.zeros(self.num_robots, bool)
        # Bodies of no robot have owner -1, and never vary.
        owner, wheel = np.full(self.model.nbody, -1), np.zeros(self.model.nbody, bool)
        for group in self.groups:
            # The chassis is the first body of a robot and no part of its list.
            rolls = np.array([False, *(part.is_wheel for part in parts_of(group.robot))])
            for slot, index in zip(group.slots, group.indices, strict=True):
                chassis[slot], which[slot] = index.body_ids[0], is_randomized(self.vary, group.robot)
                if which[slot]:
                    owner[list(index.body_ids)], wheel[list(index.body_ids)] = slot, rolls
        return RandomizedBodies(vary=self.vary, varies=which, chassis=chassis, owner=owner, wheel=wheel)

    @cached_property
    def _moved_names(self) -> tuple[str, ...]:
        return () if self.moved_geoms is None else self.moved_geoms.names

    @cached_property
    def fixed_geoms(self) -> GeomTable:
        """Floor and arena, without the geoms that are data."""
        return fixed_geoms(self.model, self.arena, self._moved_names)

    @cached_property
    def moved_geom_table(self) -> GeomTable:
        """The geoms that are data; the kinds, materials and sizes of these are of use."""
        return moved_geom_table(self.model, self.arena, self._moved_names)

    @cached_property
    def loose_geoms(self) -> LooseGeoms:
        """The geoms of loose objects."""
        return loose_geoms(self.model, self.arena)

    @cached_property
    def robots(self) -> tuple[tuple[RobotSpec, RobotIndex], ...]:
        """The robots, and where they are in the model, by slot."""
        found = {
            int(slot): (group.robot, index)
            for group in self.groups
            for slot, index in zip(group.slots, group.indices, strict=True)
        }
        return tuple(found[slot] for slot in sorted(found))

    @cached_property
    def parked_qpos(self) -> np.ndarray:
        """Qpos with all robots parked, their joints as they stand, and the arena as described (nq,)."""
        # A copy: `qpos0` belongs to the model, which others read.
        qpos = self.model.qpos0.astype(np.float32)
        for group in self.groups:
            qpos[group.qposadr] = stance_of(group.robot).joints
        return qpos

    @cached_property
    def door_qpos(self) -> np.ndarray:
        """Qpos addresses of the doors' hinges (doors,)."""
        return door_qpos(self.model, self.arena)

    def with_robots(
        self, model: mujoco.MjModel, roster: tuple[RosterEntry, ...], groups: tuple[RobotGroup, ...]
    ) -> "Scene":
        """Return a scene with the same arena and other robots, which are behind the arena in the model."""
        other = replace(self, model=model, roster=roster, groups=groups)
        # Tables of the arena take long to make, and robots come and go in a served world.
        known = {name: value for name, value in vars(self).items() if name in ARENA_TABLES}
        if model is not self.model:
            known.pop("loose_geoms", None)  # objects that were added later are behind robots
        vars(other).update(known)  # where cached properties are kept
        return other

    def arena_of(self, arena_state: ArenaState | None) -> ArenaSpec:
        """Return the description that a world's arena was made from."""
        if self.arenas is None or arena_state is None:
            return self.arena
        return self.arenas.arena_of(int(np.asarray(arena_state.serial)))

    def group_of(self, slot: int) -> tuple[int, int]:
        """Return (group, index in the group) of a roster slot."""
        if slot not in self._places:
            raise SpecError(f"slot {slot} is not in the roster of {self.num_robots} robots")
        return self._places[slot]

    @cached_property
    def _places(self) -> dict[int, tuple[int, int]]:
        """Group and index in it of each robot, by slot."""
        return {
            slot: (t, place)
            for t, group in enumerate(self.groups)
            for place, slot in enumerate(group.slots.tolist())
        }


def parking_position(arena: ArenaSpec, slot: int) -> tuple[float, float, float]:
    """Return the position in which the robot of a slot waits while unused [m]."""
    row, column = divmod(slot, 8)
    return (PARKING_STEP * column, PARKING_STEP * row, arena.floor + PARKING_HEIGHT)


def origin_height(arena: ArenaSpec, height: ArrayLike, robot: RobotSpec) -> ArrayLike:
    """Return the height of a robot's origin when it stands under start poses of some height (...,) [m]."""
    # Start poses are above the ground by the height at which USARSim's maps have them.
    return arena.floor + height - START_ELEVATION + standing_height(robot)


def start_height(arena: ArenaSpec, start: StartPose, robot: RobotSpec) -> float:
    """Return the height of a robot's origin when it stands on the ground under a start pose [m]."""
    return float(origin_height(arena, start.at[2], robot))


def _resolve_arena(
    arena: str | Path | ArenaSpec | Sequence[ArenaSpec], spare: float
) -> tuple[ArenaSpec, ArenaSet | None]:
    """Return the description to compose, and the set that worlds draw their arenas from, if any."""
    if isinstance(arena, (str, Path)):
        return find_arena(arena), None
    if isinstance(arena, ArenaSpec):
        return arena, None
    arenas = arena_set(arena, spare)
    return arenas.template, arenas


def parse_roster(text: str) -> list[str]:
    """Return the class names of a roster written as `P2AT:4,P2DX:2`.

    Raises:
        UsageError: Not of that form.
        UnknownNameError: No such robot class.
    """
    names: list[str] = []
    # Empty parts are dropped: a comma at the end adds no robot, and "" is an empty roster.
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, count = part.partition(":")
        if count and not count.isdecimal():
            raise UsageError(f"roster entry {part!r} is not of the form CLASS:COUNT, as P2AT:4")
        names += [find_robot(name).name] * int(count or 1)
    return names


def unique_entries(roster: str | Sequence[str | RobotSpec | RosterEntry]) -> tuple[RosterEntry, ...]:
    """Return the entries of a roster, whose names differ, case ignored: messages tell robots apart by them.

    Raises:
        SpecError: Names the robot and its slots.
    """
    roster = parse_roster(roster) if isinstance(roster, str) else roster
    entries = tuple(e if isinstance(e, RosterEntry) else RosterEntry(robot=e) for e in roster)
    slots: dict[str, int] = {}
    for slot, entry in enumerate(entries):
        name = entry.name or f"{entry.spec.name}{slot}"
        # Default names count as well: an explicit name must not be that of another slot.
        if (first := slots.setdefault(name.lower(), slot)) != slot:
            raise SpecError(f"robots {first} and {slot} are both named {name}, expected names of their own")
    return entries


def build_scene(
    arena: str | Path | ArenaSpec | Sequence[ArenaSpec] = "yellow",
    roster: str | Sequence[str | RobotSpec | RosterEntry] = ("P2AT",),
    physics: Physics | None = None,
    *,
    radio: RadioSettings | None = None,
    mail: MessageSettings | None = None,
    vary: DomainRandomization | None = None,
    spare: float = 0.0,
) -> Scene:
    """Compose an arena and its robots.

    Args:
        arena: Name, file (see `models.files.load`) or description; or several descriptions, of which each
            world gets one at every reset.
        roster: Class names, descriptions or entries, in slot order, or a text as `P2AT:2,P2DX`; robots that
            are not parked need a start pose each.
        physics: Solver and time settings.
        radio: Constants of the robots' radios; None: they have none, and it costs nothing.
        mail: Sizes of the messages that they send each other over it; None: none.
        vary: Domain randomization between worlds and episodes; None: none.
        spare: With several arenas: room for others that replace them later, see `arena_set`.

    Raises:
        UnknownNameError: Unknown arena, robot class, sensor or setting.
        SpecError: Two robots of one name, more robots than start poses, mail without a radio, arenas that
            cannot be together in a batch, or a variation that does not go with a robot.
        UnsupportedGeomError: A geom that rays cannot hit, or that the radio cannot count as a wall.
    """
    physics = physics or Physics()
    arena, arenas = _resolve_arena(arena, spare)
    entries = unique_entries(roster)
    if mail is not None and radio is None:
        raise SpecError("mail needs a radio: give build_scene a radio=RadioSettings(...) too")
    if radio is not None:
        arena_solids(arena)  # a solid that cannot be counted is an error here, not in a step
    active = sum(not entry.parked for entry in entries)
    if active > len(arena.starts):
        raise SpecError(f"{active} robots, but arena {arena.name} has {len(arena.starts)} start poses")
    spec = new_spec(arena, physics, moves=arenas is not None)
    robots = [entry.spec for entry in entries]
    if vary is not None:
        check_randomization(vary, robots, radio is not None)
    for slot, robot in enumerate(robots):  # in slot order, as `index_robot` and `Inputs` have it
        add_robot(spec, robot, prefix_of(slot), parking_position(arena, slot))
    cap_contacts(spec, physics, arena, robots)  # after the robots, by whose geoms buffers are sized
    model = spec.compile()
    check_ray_kinds(model.geom_type.tolist(), [model.geom(i).name for i in range(model.ngeom)])
    return Scene(
        arena=arena,
        physics=physics,
        roster=entries,
        spec=spec,
        model=model,
        groups=_groups(model, entries),
        radio=radio,
        mail=mail,
        arenas=arenas,
        vary=vary,
    )


def _groups(model: mujoco.MjModel, entries: tuple[RosterEntry, ...]) -> tuple[RobotGroup, ...]:
    return robot_groups(model, {slot: entry.spec for slot, entry in enumerate(entries)})
