"""One world on C MuJoCo and NumPy, without a compiler, with robots that come and go.

It does what a `Batch` does to many worlds, by the same pure functions (`world`, `operate`, `radio`, `views`)
and with the same random numbers: a robot at a pose reads what it would read in world `number` of a batch of
that seed.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import jax
import mujoco
import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, numpy_backend
from usarmjx.base.errors import PlaceError, SpecError, UsageError
from usarmjx.base.transforms import GRAVITY, Vec3
from usarmjx.comms.links import Links, no_links
from usarmjx.engines.base import GeomPoses, PhysicsState
from usarmjx.engines.c.camera_rays import CCameraRays, GeomColors
from usarmjx.engines.c.faults import RecoveryResult
from usarmjx.engines.c.placement import MAX_PENETRATION, SEARCH_RADIUS, deepest_contact, free_pose
from usarmjx.engines.c.rays import CRayCaster
from usarmjx.engines.c.world import CWorld
from usarmjx.models.compile.compose import (
    ARENA_PREFIX,
    LOOSE_PREFIX,
    RobotIndex,
    add_loose,
    add_robot,
    materials_of,
    new_spec,
    remove_loose,
    remove_robot,
)
from usarmjx.models.compile.standing import stance_of
from usarmjx.models.effecters import Opcode, no_dropped_tags
from usarmjx.models.types.arena import ArenaSpec, LooseObject
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.base import Reading, SensorInput
from usarmjx.sensors.cameras.shading import RenderScene
from usarmjx.sensors.suite import migrate_memory, query_of, suite_of
from usarmjx.sim.control import idle_command
from usarmjx.sim.operate import EffecterCommand, OperationResult, operate
from usarmjx.sim.radio import update_links
from usarmjx.sim.ray_geometry import moved_geom_poses
from usarmjx.sim.reset import new_group_state, restart_in_place, start_sensors
from usarmjx.sim.scene import RobotGroup, RosterEntry, Scene, parking_position, prefix_of, robot_groups
from usarmjx.sim.suction import Suction
from usarmjx.sim.views import build_render_scene, geom_colors_of
from usarmjx.sim.world import (
    FaultCounts,
    GroupState,
    World,
    clock_of,
    compute_inputs,
    observe,
    runaway_limit,
    sense_self,
)

MAX_FALL_HEIGHT = 1000.0
"""Fall below the greatest height so far after which a robot has left the world and is recovered [m]."""


class SpeedLimits:
    """Remembers how high robots have been.

    Args:
        groups: The robots.
        max_heights: Greatest height of some of them so far, by slot [m].
        qpos: Present positions (nq,).
        period: Length of a control step [s].
    """

    def __init__(
        self, groups: Iterable[RobotGroup], max_heights: Mapping[int, float], qpos: np.ndarray, period: float
    ) -> None:
        robots = [
            (int(slot), index.root_qposadr + 2, runaway_limit(group.robot))
            for group in groups
            for slot, index in zip(group.slots, group.indices, strict=True)
        ]
        self._slots = [slot for slot, _, _ in robots]
        self._heights = np.array([address for _, address, _ in robots], int)
        self._drive_limits = np.array([limit for _, _, limit in robots])
        self._step = GRAVITY * period
        self._max_heights = np.array(
            [max_heights.get(slot, float(qpos[address])) for slot, address, _ in robots]
        )

    @property
    def max_heights(self) -> dict[int, float]:
        """Greatest height of each robot so far, by slot [m]."""
        return dict(zip(self._slots, self._max_heights.tolist(), strict=True))

    def reset_robots(self, slots: Iterable[int], qpos: np.ndarray) -> None:
        """Forget how high robots have been, because they are somewhere else now."""
        selected = np.isin(self._slots, list(slots))
        self._max_heights[selected] = qpos[self._heights[selected]]

    def update(self, qpos: np.ndarray) -> dict[int, float]:
        """Look where robots are; return how fast each may be after the next control step [m/s], by slot."""
        height = qpos[self._heights]
        # The engine recovers such a robot; until then its greatest height stands in.
        # One product tests all heights: NaN and infinity spread through its sum.
        if not math.isfinite(np.vdot(height, height)):
            height = np.where(np.isfinite(height), height, self._max_heights)
        self._max_heights = np.maximum(self._max_heights, height)
        # Energy: a fall by h ends at sqrt(2 g h) at most; the last term is what one more step of free fall
        # adds.
        fallen = np.sqrt(2 * GRAVITY * np.minimum(self._max_heights - height, MAX_FALL_HEIGHT)) + self._step
        return dict(zip(self._slots, np.hypot(self._drive_limits, fallen).tolist(), strict=True))


EMPTY_SLOT = RosterEntry(robot="", parked=True)
"""Stands in a roster where there is no robot."""
LOOKAHEAD_STEPS = 50
"""Control steps for which the poses of moving geoms are computed at once: fifty cost hardly more than ten."""
KEPT_SUBSCENES = 64
"""Most sets of robots whose scene is kept: sixteen robots have 65,535 sets."""
SubScene = tuple[Scene, list[tuple[int, np.ndarray | None]]]
"""A scene with some of the robots, and of each of its groups the index and the members; None: all."""
RobotStates = Mapping[int, GroupState]
"""States of single robots by slot, without an axis over robots."""


class SingleWorld:
    """One world.

    Args:
        scene: Its scene, without robots.
        seed: Seed of the random numbers, as a batch's.
        number: Which world of a batch of that seed it is.
        seats: Most robots at once.

    Attributes:
        scene: The scene as it is now: another one whenever a robot joins or leaves.
        world: Everything but the physics; NumPy's arrays.
        engine: The physics.
    """

    def __init__(self, scene: Scene, seed: int = 0, number: int = 0, seats: int = 16) -> None:
        self.scene, self._seats = scene, seats
        self.engine = CWorld(scene.spec, scene.arena, scene.physics.substeps, scene.moved_geoms)
        with numpy_backend():
            zero = np.zeros((), np.int32)
            self.world = World(
                # The key that world `number` of a batch of this seed has.
                key=random.fold_in(random.key(seed), number),
                number=np.asarray(number, np.int32),
                arena_state=None,
                episode=zero,
                step=zero,
                groups=(),
                tags=no_dropped_tags(),
                faults=FaultCounts(not_finite=zero, overflow=zero, runaway=zero, refused=zero, task=zero),
                links=None if scene.radio is None else no_links(seats),
            )
        self._wraps = 0
        self._homes: dict[int, np.ndarray] = {}
        self._subscenes: dict[frozenset[int], SubScene] = {}
        self._speeds = SpeedLimits((), {}, self.engine.data.qpos, scene.physics.period)
        self._geom_colors: tuple[Scene, GeomColors] | None = None
        # Before step 0, so that the first step computes a table.
        self._moved_ahead: tuple[int, GeomPoses | None] = -LOOKAHEAD_STEPS, None
        self._regroup({}, {})
        self._suction = Suction(self.engine, lambda: self._use_arena(self.scene.arena))

    @property
    def physics(self) -> PhysicsState:
        """Positions, velocities and activations in single precision."""
        return self.engine.state()

    @property
    def steps(self) -> int:
        """Control steps since the world began; unlike `world.step` it does not wrap around."""
        # After 2**31 - 1 the step goes on at -2**31: a wrap adds the whole range of 32 bits.
        return self._wraps * 2**32 + int(self.world.step)

    @property
    def time(self) -> float:
        """Simulated time since the world began [s]."""
        return self.steps * self.scene.physics.period

    @property
    def roster(self) -> dict[int, RosterEntry]:
        """The robots by slot."""
        return {slot: entry for slot, entry in enumerate(self.scene.roster) if entry is not EMPTY_SLOT}

    # Robots come and go

    def add(self, robot: RobotSpec, name: str, poses: Sequence[tuple[Vec3, Array]]) -> int:
        """Add a robot and return its slot; the states of the others are kept to the bit.

        Args:
            robot: Its class.
            name: Its name.
            poses: Positions [m] of its chassis' origin and orientations (4,): the first with room is taken,
                else what is free within 1 m of the first.

        Raises:
            UsageError: All slots are taken, or there is no room.
            SpecError: MuJoCo cannot build the robot. Nothing has changed after this or any other exception.
        """
        roster, rows = self.roster, self._robot_states()
        free = [slot for slot in range(self._seats) if slot not in roster]
        if not free:
            raise UsageError(f"no seat left for another robot: {self._seats} are taken")
        slot, prefix = free[0], prefix_of(free[0])

        def remove(spec: mujoco.MjSpec) -> None:
            remove_robot(spec, prefix)

        # Far above the arena it touches nothing until the search below has found room for it.
        place = parking_position(self.scene.arena, slot)
        try:
            self.engine.edit(lambda spec: add_robot(spec, robot, prefix, place), remove)
        except ValueError as error:  # of MuJoCo
            raise SpecError(f"a {robot.name} cannot be built: {error}") from error
        try:
            # From here on the model has the robot: a fault takes it out again.
            (group,) = robot_groups(self.engine.model, {slot: robot})
            self._place_robot(group, poses)
            state = self._initial_state(group)
            self._regroup(roster | {slot: RosterEntry(robot=robot, name=name)}, rows | {slot: _row(state, 0)})
        except Exception:
            self.engine.edit(remove, remove)
            self._regroup(roster, rows)
            raise
        return slot

    def _place_robot(self, group: RobotGroup, poses: Sequence[tuple[Vec3, Array]]) -> None:
        """Put the one robot of a group where there is room for it, with the tilt and joints of its stance."""
        model, data, stance = self.engine.model, self.engine.data, stance_of(group.robot)
        (index,), floor = group.indices, self.scene.arena.floor - stance.sinking
        # Before the search: where a robot has room depends on its joints.
        data.qpos[list(index.qposadr)] = stance.joints
        for (pos, quat), reach in (*((pose, 0.0) for pose in poses), (poses[0], SEARCH_RADIUS)):
            found = free_pose(model, data, index, np.array(pos), stance.tilted(quat), floor, reach)
            if found is not None:
                self.engine.place(index, *found)
                # Recovery puts it here again, and not to the pose that was asked for.
                self._homes[int(group.slots[0])] = self.engine.home(index)
                return
        raise PlaceError(f"no room for a {group.robot.name} within {SEARCH_RADIUS:g} m of {{}}", poses[0][0])

    def move_robot(self, slot: int, pos: Vec3, quat: np.ndarray) -> None:
        """Put a robot at a pose, at rest, raised onto the floor if need be: position [m], orientation (4,).

        Raises:
            UsageError: There is no room.
        """
        model, data, index = self.engine.model, self.engine.data, self._indices[slot]
        floor = self.scene.arena.floor - stance_of(self.roster[slot].spec).sinking
        found = free_pose(model, data, index, np.array(pos), quat, floor, 0.0)
        if found is None:
            raise PlaceError(f"no room for {self.roster[slot].name} at {{}}", pos)
        # Before it moves: its weld would drag what it holds along.
        self._suction.open(self._suction.of_robots([slot]))
        self.engine.place(self._indices[slot], *found)
        self._speeds.reset_robots([slot], self.engine.data.qpos)

    def move_loose(self, number: int, pos: Vec3, quat: np.ndarray) -> None:
        """Put a loose object, by its number, at a pose, at rest: position [m], orientation (4,)."""
        self._suction.open(self._suction.holding([f"{LOOSE_PREFIX}{self.scene.arena.loose[number].name}"]))
        loose, data = self.scene.loose_geoms, self.engine.data
        data.qpos[loose.root_qposadr[number]] = (*pos, *quat)
        data.qvel[loose.root_dof[number]] = 0.0
        self.engine.hold(f"{LOOSE_PREFIX}{self.scene.arena.loose[number].name}", pos, quat)
        # MuJoCo computes poses of bodies in a step; rays and searches for room may come before.
        mujoco.mj_kinematics(self.engine.model, data)

    def add_loose(self, thing: LooseObject, *, held: bool) -> None:
        """Add a loose object; the states of all others are kept to the bit.

        Args:
            thing: The object, whose name no other has.
            held: Whether it hangs where it is; see `compose.add_loose`.

        Raises:
            PlaceError: Something is there. Nothing has changed then.
        """
        before = self.scene.arena
        arena = replace(before, loose=(*before.loose, thing))

        def remove(spec: mujoco.MjSpec) -> None:
            remove_loose(spec, thing.name)

        self.engine.edit(lambda spec: add_loose(spec, thing, arena.floor, held=held), remove, arena)
        body = self.engine.model.body(f"{LOOSE_PREFIX}{thing.name}").id
        # Tried in the model itself: only there is the object's exact shape.
        is_free = deepest_contact(self.engine.model, self.engine.data, body) <= MAX_PENETRATION
        if not is_free:
            self.engine.edit(remove, remove, before)
        self._use_arena(arena if is_free else before)  # in both cases the model is another one
        if not is_free:
            x, y, z = thing.at
            raise PlaceError(f"no room for {thing.name} at {{}}", (x, y, z + arena.floor))

    def remove_loose(self, number: int) -> None:
        """Remove a loose object, by its number; the states of all others are kept to the bit."""
        arena = self.scene.arena
        name = arena.loose[number].name
        # Vacuums let go first, so that no weld names a body that is gone.
        self._suction.open(self._suction.holding([f"{LOOSE_PREFIX}{name}"]))
        after = replace(arena, loose=(*arena.loose[:number], *arena.loose[number + 1 :]))
        self.engine.edit(lambda spec: remove_loose(spec, name), lambda spec: None, after)
        self._use_arena(after)

    def set_conveyors(self, share: float, name: str | None = None) -> None:
        """Set the velocity of the conveyors of a name (case ignored), or of all, as a share of their own."""
        for i, shape in enumerate(self.scene.arena.shapes):
            belt = shape.conveyor
            if belt is not None and (name is None or belt.name.lower() == name.lower()):
                x, y, z = belt.velocity
                self.engine.move_surface(f"{ARENA_PREFIX}{i}", (share * x, share * y, share * z))

    def _use_arena(self, arena: ArenaSpec) -> None:
        """Resolve the present model, whose arena has other loose objects now."""
        roster, rows = self.roster, self._robot_states()
        self.scene = replace(self.scene, arena=arena, model=self.engine.model)
        self._regroup(roster, rows)

    @numpy_backend()
    def _initial_state(self, group: RobotGroup) -> GroupState:
        """Return the state of the one robot of a group whose sensors start now, as they do at a reset."""
        since = np.full(1, self.world.step, np.int32)
        scene = self.scene.with_robots(self.engine.model, self.scene.roster, (group,))
        return start_sensors(
            scene, self.world, self.physics, group, new_group_state(scene, group, True, since)
        )

    def remove(self, slot: int) -> None:
        """Take a robot out of the world; the states of the others are kept to the bit."""
        self._suction.open(self._suction.of_robots([slot]))
        roster, rows = self.roster, self._robot_states()
        self.engine.edit(lambda spec: remove_robot(spec, prefix_of(slot)), lambda spec: None)
        del roster[slot], rows[slot], self._homes[slot]
        self._regroup(roster, rows)

    def replace_robot(self, slot: int, robot: RobotSpec) -> None:
        """Let a robot be of another class, which has the same parts and sensors; what it does goes on.

        The parts of the class have to be in the model already, see `update_robot_spec`.
        """
        rows, entry = self._robot_states(), self.roster[slot]
        (group,) = robot_groups(self.engine.model, {slot: robot})
        before, fresh = rows[slot].memory, _row(self._initial_state(group).memory, 0)
        memory = migrate_memory(suite_of(entry.spec), group.suite, before, fresh)
        rows[slot] = rows[slot].replace(memory=memory)
        self._regroup(self.roster | {slot: replace(entry, robot=robot)}, rows)

    def _robot_states(self) -> dict[int, GroupState]:
        return {
            int(slot): _row(state, i)
            for group, state in zip(self.scene.groups, self.world.groups, strict=True)
            for i, slot in enumerate(group.slots)
        }

    def _regroup(self, roster: Mapping[int, RosterEntry], rows: RobotStates) -> None:
        """Resolve the present model, with the robots by slot and their states."""
        groups = robot_groups(self.engine.model, {slot: entry.spec for slot, entry in roster.items()})
        seats = tuple(roster.get(slot, EMPTY_SLOT) for slot in range(self._seats))
        self.scene = self.scene.with_robots(self.engine.model, seats, groups)
        states = [_stacked([rows[int(s)] for s in group.slots]) for group in groups]
        self.world = self.world.replace(groups=tuple(states))
        # Scenes of subsets point at the old model.
        self._subscenes = {}
        self._indices = {int(s): i for g in groups for s, i in zip(g.slots, g.indices, strict=True)}
        # A slot without a home has been left: the next robot in it must not inherit how high that one was.
        max_heights = {slot: top for slot, top in self._speeds.max_heights.items() if slot in self._homes}
        self._speeds = SpeedLimits(groups, max_heights, self.engine.data.qpos, self.scene.physics.period)

    # Control steps

    @numpy_backend()
    def step(self) -> RecoveryResult:
        """Advance by one control step under the commands in force.

        Returns:
            Objects whose physics was not finite, and which were recovered: robots at their start poses, or
            near there. They count in `world.faults`, and the robots get idle commands.
        """
        moved, path = self._moved()
        self.world, inputs = compute_inputs(self.scene, self.world, self.physics, moved)
        self.engine.apply(inputs, path)
        # Before the step: it bounds what a robot may gain within the step.
        limits = self._speeds.update(self.engine.data.qpos)
        lost, recovery = self.engine.advance(self._indices, limits, self._homes)
        # The engine has checked already that all is finite and no robot too fast, as `finish_step` does.
        faults, step = self.world.faults, np.array(self.world.step, np.int32)
        # An array, counted up in place: a NumPy scalar warns when it wraps around.
        step += 1
        # The 32-bit count wraps around after 2**31 - 1 steps, 497 days at 0.02 s.
        self._wraps += int(step < self.world.step)
        if lost or recovery:
            overflow, bad = (np.asarray(count, np.int32) for count in (lost != 0, bool(recovery)))
            faults = faults.replace(overflow=faults.overflow + overflow, not_finite=faults.not_finite + bad)
        self.world = self.world.replace(step=step, faults=faults)
        if recovery:
            self._speeds.reset_robots(recovery.robots, self.engine.data.qpos)
            lost_by = self._suction.of_robots(recovery.robots) + self._suction.holding(recovery.others)
            self._suction.open(lost_by)
        for slot in recovery.robots:
            self.edit(slot, command=idle_command(self.roster[slot].spec))
        # After the recovery: a robot that was put elsewhere has let go already.
        self._suction.lose()
        return recovery

    @numpy_backend()
    def observe(self, slots: Iterable[int]) -> dict[int, tuple[Reading, ...]]:
        """Read the sensors that are due of some robots; by slot and sensor."""
        scene, members = self._subscene(frozenset(slots))
        states = self.world.groups
        # Sensing reads only the memories of the robots' states.
        part = [
            states[i] if some is None else states[i].replace(memory=_row(states[i].memory, some))
            for i, some in members
        ]
        world = self.world.replace(groups=tuple(part))
        world, readings = observe(scene, world, self.physics, self._caster())
        for (i, some), state in zip(members, world.groups, strict=True):
            if some is None:
                self.world = self.world.with_group(i, self.world.groups[i].replace(memory=state.memory))
            else:
                self._replace_members(i, some, memory=state.memory)
        return {
            int(slot): tuple(Reading(value=one.value[row], fresh=one.fresh[row]) for one in values)
            for group, values in zip(scene.groups, readings, strict=True)
            for row, slot in enumerate(group.slots)
        }

    def _subscene(self, slots: frozenset[int]) -> SubScene:
        """Return a scene with some of the robots, and of each of its groups the index and the members."""
        if slots not in self._subscenes:
            # All at once: in a served world the same few sets come back and are made again soon.
            if len(self._subscenes) >= KEPT_SUBSCENES:
                self._subscenes.clear()
            self._subscenes[slots] = self._build_subscene(slots)
        return self._subscenes[slots]

    def _build_subscene(self, slots: frozenset[int]) -> SubScene:
        found: list[tuple[int, np.ndarray | None]] = []
        groups: list[RobotGroup] = []
        for i, group in enumerate(self.scene.groups):
            some = [member for member, slot in enumerate(group.slots.tolist()) if slot in slots]
            if len(some) == len(group.slots):
                # A whole group needs no copy of its rows.
                found.append((i, None))
                groups.append(group)
            elif some:
                found.append((i, np.array(some)))
                groups.append(group.part(np.array(some)))
        return self.scene.with_robots(self.scene.model, self.scene.roster, tuple(groups)), found

    def _replace_members(self, group: int, members: Any, **fields: Any) -> None:  # noqa: ANN401 - what indexes, PyTrees
        """Replace fields of the states of some robots of a group."""

        def rows(old: Array, part: Array) -> np.ndarray:
            if np.shape(part) == np.shape(old):  # all of them
                return np.asarray(part)
            # A copy: the state of before may still be in use, as values are.
            copy = np.array(old)
            copy[members] = part
            return copy

        state = self.world.groups[group]
        new = {name: jax.tree.map(rows, getattr(state, name), value) for name, value in fields.items()}
        self.world = self.world.with_group(group, state.replace(**new))

    def _moved(self) -> tuple[GeomPoses | None, GeomPoses | None]:
        """Return the poses of the arena's moving geoms: the present ones, and those of some steps."""
        first, ahead = self._moved_ahead
        offset = int(self.world.step) - first
        # Also after a reset, when the step is before the first one of the table.
        if not 0 <= offset < LOOKAHEAD_STEPS:
            steps = self.world.step + np.arange(LOOKAHEAD_STEPS, dtype=np.int32)
            ahead = moved_geom_poses(self.scene, None, clock_of(self.scene, self.world.replace(step=steps)))
            offset, self._moved_ahead = 0, (int(self.world.step), ahead)
        now = None if ahead is None else GeomPoses(pos=ahead.pos[offset], quat=ahead.quat[offset])
        return now, ahead

    def _caster(self) -> CRayCaster:
        return self.engine.caster(self._indices, *self._moved())

    # One robot

    def state_of(self, slot: int) -> GroupState:
        """Return a robot's state, without an axis over robots."""
        group, member = self.scene.group_of(slot)
        return _row(self.world.groups[group], member)

    def edit(self, slot: int, **fields: Any) -> None:  # noqa: ANN401 - PyTrees of one robot
        """Replace fields of a robot's state."""
        group, member = self.scene.group_of(slot)
        # None until the first servo is softened, and rows can be replaced in an array only.
        if "stiffness" in fields:
            state = self.world.groups[group]
            self.world = self.world.with_group(group, state.replace(stiffness=_stiffness_of(state)))
        self._replace_members(group, member, **fields)

    def set_stiffness(self, slot: int, joint: int, share: float) -> None:
        """Set the share of its gains and torque that the servo of a joint, by index, exerts: 0 to 1."""
        group, member = self.scene.group_of(slot)
        stiffness = _stiffness_of(self.world.groups[group])[member].copy()
        stiffness[self.scene.groups[group].plan.actuated == joint] = share
        self.edit(slot, stiffness=stiffness)

    @numpy_backend()
    def sensor_input(self, slot: int) -> SensorInput:
        """Return a robot's sensor input without rays."""
        scene, _ = self._subscene(frozenset([slot]))
        inputs = sense_self(scene, self.world, self.physics, scene.groups[0])
        own = {name: _row(getattr(inputs, name), 0) for name in ("state", "bodies", "hits")}
        return inputs.replace(**own)

    @property
    def robots(self) -> Mapping[int, RobotIndex]:
        """Indices of each robot in the model, by slot."""
        return self._indices

    @numpy_backend()
    def met_geoms(self, slot: int, sensor: int) -> np.ndarray:
        """Return the geoms that a robot's object sensor met within its range, -1 for none (rays,).

        They are those of its last reading, or of now, if robots joined or left since then.
        """
        group, _ = self.scene.group_of(slot)
        own, caster = self.scene.groups[group].suite.sensors[sensor], self._caster()
        # The caster is made anew with every model and has forgotten what was met.
        if (slot, own.mounts[0].name) not in caster.met:
            caster(*own.rays(self.sensor_input(slot).bodies), query_of(own, np.int32(slot)))
        return caster.met[slot, own.mounts[0].name]

    @numpy_backend()
    def operate(self, slot: int, effecter: int, opcode: Opcode, value: float) -> OperationResult:
        """Let a robot operate one of its effecters, by index."""
        group, member = self.scene.group_of(slot)
        where = np.arange(len(self.scene.groups[group].slots)) == member
        values = np.full(len(where), value, np.float32)
        order = EffecterCommand(group=group, effecter=effecter, opcode=opcode, value=values, where=where)
        self.world, result = operate(self.scene, self.world, self.physics, order, self._ground)
        return _row(result, member)

    @numpy_backend()
    def suck(self, slot: int, effecter: int, *, closes: bool) -> None:
        """Close a robot's vacuum, by its index among the effecters, or open it."""
        group, _ = self.scene.group_of(slot)
        if closes:
            robot, vacuum = self.scene.groups[group].robot, self.scene.groups[group].effecters[effecter]
            self._suction.close((slot, effecter), robot, self._indices[slot], vacuum, self._caster())
        else:
            self._suction.open([(slot, effecter)])

    def sucks(self, slot: int, effecter: int) -> bool:
        """Return whether a robot's vacuum is closed, whether or not it holds anything."""
        return self._suction.is_closed((slot, effecter))

    @cached_property
    def _ground(self) -> CRayCaster:
        """Casts rays at what dropped things fall on: floor and arena, without what is loose, and doors."""
        # Kept when robots and objects come and go: the ground has none of them.
        arena = replace(self.scene.arena, loose=(), doors=())
        model = new_spec(arena, self.scene.physics).compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        return CRayCaster(model, data, materials_of(model, arena), {})

    # All of it

    @numpy_backend()
    def reset(self) -> None:
        """Begin the next episode: robots, loose objects and doors back where they began, and time at 0.

        Robots get idle commands and full batteries. A robot whose start pose is taken is put next to it.
        """
        self._suction.open(self._suction.of_robots(self.roster))
        self.engine.reset_all(self._indices, self._homes)
        self.set_conveyors(1.0)
        for thing, at in zip(self.scene.arena.loose, self.scene.loose_geoms.root_qposadr, strict=True):
            pose = self.engine.data.qpos[at]
            self.engine.hold(f"{LOOSE_PREFIX}{thing.name}", pose[:3], pose[3:])
        self._wraps = 0
        self.world = restart_in_place(self.scene, self.world, self.physics)
        self._speeds.reset_robots(self._indices, self.engine.data.qpos)

    @numpy_backend()
    def links(self) -> Links:
        """Return the radio links, evaluated at most once in a control step, or radio `period`.

        Raises:
            UsageError: The scene has no radio.
        """
        links = update_links(self.scene, self.world, self.physics)
        self.world = self.world.replace(links=links)
        return links

    @numpy_backend()
    def sight(self) -> CCameraRays:
        """Return a caster of cameras' rays for the present state, which later steps do not change."""
        # The moving geoms are where the last step had them: rays need them where they are now.
        self.engine.move(*self._moved())
        # By identity: any robot or object that joins or leaves makes another scene.
        if self._geom_colors is None or self._geom_colors[0] is not self.scene:
            self._geom_colors = self.scene, geom_colors_of(self.scene)
        return CCameraRays(self.engine.model, self.engine.data, self._geom_colors[1])

    @numpy_backend()
    def render_scene(self) -> RenderScene:
        """Return all that cameras see; NumPy's arrays."""
        return build_render_scene(self.scene, self.world, self.physics)[0]


def _stiffness_of(state: GroupState) -> np.ndarray:
    """Return the stiffness of the servos of one robot or several; see `GroupState`."""
    if state.stiffness is None:
        return np.ones(np.shape(state.hold), np.float32)
    return np.asarray(state.stiffness)


def _stacked(rows: Sequence[GroupState]) -> GroupState:
    """Return the state of several robots, of their states."""
    if any(row.stiffness is not None for row in rows):
        rows = [row.replace(stiffness=_stiffness_of(row)) for row in rows]
    return jax.tree.map(lambda *x: np.stack(x), *rows)


def _row(tree: Any, index: Any) -> Any:  # noqa: ANN401 - a PyTree and what indexes its leading axes
    return jax.tree.map(lambda x: x[index], tree)
