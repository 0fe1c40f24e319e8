"""A served world that is one of a running batch: clients claim parked robots of the roster.

The batch's shape is fixed, so INIT can only activate a parked robot of the requested class; disconnecting
parks it again. All worlds of the batch run on; only the served one has clients.
"""

import asyncio
import logging
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TextIO

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsageError
from usarmjx.base.transforms import Vec3, quat_from_angles
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.links import Links
from usarmjx.engines import PhysicsState
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.standing import stance_of, stances_in
from usarmjx.models.drives.base import RobotState
from usarmjx.models.effecters import Opcode
from usarmjx.models.types.robot import RobotSpec
from usarmjx.recording.inputs import WorldSetup, batch_setup, orders_of
from usarmjx.sensors.cameras.picture import Picture
from usarmjx.sensors.suite import suite_of
from usarmjx.server.worlds.instances import check_instances
from usarmjx.server.worlds.met_objects import MetObject, ObjectFinder
from usarmjx.server.worlds.recorded import record_step, store_reading
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import CameraRequest, ServedWorld, ViewpointRequest, status_of
from usarmjx.sim.batch import Batch, BatchState, Readings, put_robot
from usarmjx.sim.control import RobotCommand, idle_command
from usarmjx.sim.reset import new_group_state, start_sensors
from usarmjx.sim.scene import PARKING_HEIGHT, Scene
from usarmjx.sim.world import GroupState, World

log = logging.getLogger(__name__)

INITIAL_FIELDS = ("active", "battery_start", "drowned", "command", "releases", "fov", "memory")
"""Fields of a robot's state that activation sets to their initial values."""


class SharedBatch:
    """A batch that several served worlds are part of: the first one that needs the next step makes it.

    Args:
        batch: The batch.

    Attributes:
        batch: The batch.
        state: Its state now.
        steps: Control steps made so far.
        served: The served worlds that are part of it.
    """

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        self.state = batch.reset()
        self.steps = 0
        self.served: list[BatchWorld] = []

    def advance(self, steps: int) -> None:
        """Advance to a number of control steps since the beginning."""
        while self.steps < steps:
            # Orders before the step and physics after it, of all served worlds: the step is one for all of
            # them.
            for world in self.served:
                world.record_orders()
            self._step()
            for world in self.served:
                world.record_physics()

    def _step(self) -> None:
        self.state = self.batch.step(self.state)
        self.steps += 1

    def observe(self) -> None:
        """Read the sensors that are due, for all served worlds: a reading is fresh in one call only."""
        self.state, readings = self.batch.observe(self.state)
        for world in self.served:
            world.keep(readings)


def select_world(instance: int, tree: Any) -> Any:  # noqa: ANN401 - a PyTree
    """Return one world of a PyTree (worlds, ...) as NumPy arrays of their own.

    On the host all worlds are viewed without a copy first: selecting one in JAX takes ten times as long.
    """
    first = next((leaf for leaf in jax.tree.leaves(tree) if isinstance(leaf, jax.Array)), None)
    if first is None or {device.platform for device in first.devices()} == {"cpu"}:
        # Copies: a view would keep the whole batch of this moment in memory.
        return jax.tree.map(lambda x: np.array(np.asarray(x)[instance]), tree)
    # On an accelerator only the one world crosses the bus.
    return jax.tree.map(lambda x: np.asarray(x[instance]), tree)


@jax.jit  # written one by one, the fields of a robot would be some thirty programs
def write_member(old: Any, new: Any, instance: int, member: int) -> Any:  # noqa: ANN401 - PyTrees
    """Return a PyTree (worlds, robots, ...) with the values of one robot of a world replaced."""
    return jax.tree.map(lambda rows, row: rows.at[instance, member].set(row), old, new)


class BatchWorld(ServedWorld):
    """World `instance` of a batch.

    Args:
        batch: The batch; its roster's parked robots can be claimed. Worlds of one batch share it.
        instance: Number of the served world.

    Raises:
        UsageError: The batch has no such world.
    """

    def __init__(self, batch: Batch | SharedBatch, instance: int) -> None:
        self._shared = batch if isinstance(batch, SharedBatch) else SharedBatch(batch)
        self._batch, self._instance = self._shared.batch, instance
        check_instances([instance], self._batch.worlds)
        self.robots = {}
        self.period = self.scene.physics.period
        # Worlds of a batch share a scene, and may have arenas of their own, which change at resets.
        self.arena = self._batch.arena_of(self._state, instance)
        self._fetched: tuple[BatchState, tuple[World, PhysicsState]] | None = None
        self._steps, self._episode = self._shared.steps, int(self._state.worlds.episode[instance])
        self._homes: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._finder: ObjectFinder | None = None
        self._shared.served.append(self)
        # The first step makes the readings and contacts that a client expects at once.
        if not self._steps:
            self._advance()

    @property
    def scene(self) -> Scene:
        """The scene of the batch."""
        return self._batch.scene

    def setup(self) -> WorldSetup:
        """Return the world's inputs at its beginning."""
        # A replay begins with the world's first inputs, which do not say where robots stand by now.
        taken = "robots were in use before the recording began" if self.robots else ""
        return replace(batch_setup(self._batch, self._instance, self._shared.steps), why_not=taken)

    def record_orders(self) -> None:
        """Record the robots' commands in force, if the world is recorded."""
        if self.recorder is not None:
            groups = self._state.worlds.groups
            self.recorder.record_orders(self.scene, [orders_of(state, self._instance) for state in groups])

    def record_physics(self) -> None:
        """Record the physics after a control step, if the world is recorded."""
        if self.recorder is not None:
            physics = self._batch.physics(self._state)
            mine = jax.tree.map(lambda x: np.asarray(x)[self._instance], physics)
            record_step(self, mine, self._shared.steps * self.period)

    @property
    def _state(self) -> BatchState:
        return self._shared.state

    @_state.setter
    def _state(self, state: BatchState) -> None:
        self._shared.state = state

    def warm_up(self) -> None:
        """Compile all programs: activate, read and command a robot of each class, then restore the state."""
        before = self._state
        for group in self.scene.groups:
            pos = (0.0, 0.0, self.arena.floor + group.plan.clearance + PARKING_HEIGHT)
            robot = self._activate(int(group.slots[0]), group.robot, "nobody", pos, (0.0, 0.0, 0.0))
            self.observe([robot])
            self.set_command(robot, robot.command)
            self.state(robot)
            for index, effecter in enumerate(group.effecters):
                for opcode in effecter.opcodes:
                    self.operate(robot, index, opcode, opcode.default_val or 0.0)
            self.remove(robot)
        # A batch's state is immutable, so the old one is as good as untouched.
        self._state = before

    @property
    def steps(self) -> int:
        """Control steps since the world began; the count goes on when a world that diverged is reset."""
        return self._steps

    def one_world(self) -> tuple[World, PhysicsState]:
        """Return the world and its physics as they are now, without an axis over worlds; NumPy arrays."""
        # By identity: every change makes a new state, and an old one is never changed.
        if self._fetched is None or self._fetched[0] is not self._state:
            worlds, physics = self._state.worlds, self._batch.physics(self._state)
            # Typed random keys cannot become NumPy arrays, their data can.
            keyed = worlds.replace(key=jax.random.key_data(worlds.key))
            mine = select_world(self._instance, (keyed, physics))
            self._fetched = self._state, mine
        return self._fetched[1]

    def edit(self, robot: Robot, **fields: Any) -> None:  # noqa: ANN401 - PyTrees of one robot
        """Replace fields of the robot's part of its group's state."""
        group, member = self.scene.group_of(robot.slot)
        state: GroupState = self._state.worlds.groups[group]
        before = {name: getattr(state, name) for name in fields}
        new = write_member(before, fields, self._instance, member)
        self._state = self._batch.with_group(self._state, group, state.replace(**new))

    def spawn_at(self, robot: RobotSpec, name: str, poses: Sequence[tuple[Vec3, Vec3]]) -> Robot:
        """Activate a parked robot of that class at the first pose."""
        pos, angles = poses[0]
        self.check_position(pos)
        for group, state in zip(self.scene.groups, self._state.worlds.groups, strict=True):
            parked = np.flatnonzero(~np.asarray(state.active[self._instance]))
            if group.robot.name == robot.name and parked.size:
                slot = int(group.slots[parked[0]])
                return self._activate(slot, robot, name, pos, angles)
        raise UsageError(f"no parked {robot.name} left in the roster: add more of them to --roster")

    def _activate(self, slot: int, robot: RobotSpec, name: str, pos: Vec3, angles: Vec3) -> Robot:
        stance = stance_of(robot)
        touching = min(stance.height, kinematic_tree_of(robot).clearance)
        # A pose inside the floor would let contacts throw the robot out.
        lifted = floor_correction(name, pos[2] - touching, self.arena.floor)
        with numpy_backend():
            own = stances_in(self.scene.vary, self.one_world()[0].varied, robot, [slot])
        if own is not None:  # poses of clients are those of the class
            stance, lifted = replace(stance, tilt=own.tilt[0]), lifted + float(own.lift[0])
        command = jax.tree.map(np.array, idle_command(robot))
        new = Robot(slot=slot, name=name, suite=suite_of(robot), command=command, spawn_time=self.time)
        quat = stance.tilted(quat_from_angles(*angles))
        self._start(new, np.array((pos[0], pos[1], pos[2] + lifted)), quat)
        if self.recorder is not None:
            self.recorder.joined(slot, name, robot.name)
        return new

    def _start(self, robot: Robot, pos: np.ndarray, quat: np.ndarray) -> None:
        """Activate the robot of a free slot at a pose, in its initial state."""
        self._set_pose(robot.slot, pos, quat)
        self._homes[robot.slot] = pos, quat
        number, member = self.scene.group_of(robot.slot)
        group = self.scene.groups[number].part(np.array([member]))
        world, physics = self.one_world()
        with numpy_backend():
            since = np.full(1, world.step, np.int32)
            state = start_sensors(
                self.scene, world, physics, group, new_group_state(self.scene, group, True, since)
            )
        # As the state has it, not the class: stances may hold joints from the beginning.
        robot.command = jax.tree.map(lambda x: x[0], state.command)
        fields = {name: getattr(state, name) for name in INITIAL_FIELDS}
        self.edit(robot, **jax.tree.map(lambda x: x[0], fields))
        self.robots[robot.slot] = robot

    def _set_pose(self, slot: int, pos: np.ndarray, quat: np.ndarray) -> None:
        self._state = put_robot(self._batch, self._state, self._instance, slot, pos, quat)
        if self.recorder is not None:
            self.recorder.placed(slot, pos, np.asarray(quat))

    def remove(self, robot: Robot) -> None:
        """Park the robot again."""
        if self.robots.get(robot.slot) is robot:  # its slot may be another's by now
            if self.recorder is not None:
                self.recorder.event("leave", f"{robot.name} leaves", robot.name, robot.slot)
            del self.robots[robot.slot]
            self.edit(robot, active=False, command=jax.tree.map(np.array, idle_command(robot.spec)))

    def switch(self, instance: int) -> None:
        """Serve another world of the batch; the clients' robots come along in their initial state.

        Raises:
            UsageError: There is no such world, another server serves it, or a robot of it that a client would
                need is taken; nothing has changed then.
        """
        check_instances([instance], self._batch.worlds)
        # Two servers on one world would record its steps, and give its robots away, twice.
        if any(world._instance == instance for world in self._shared.served if world is not self):
            raise UsageError(f"world {instance} is served on other ports")
        robots = list(self.robots.values())
        taken = [robot.name for robot in robots if self._is_taken(instance, robot.slot)]
        if taken:
            raise UsageError(f"world {instance} has no room for {', '.join(taken)}")
        # All states before all removals: removing parks a robot, and its pose is gone.
        states = [self.state(robot) for robot in robots]
        for robot in robots:
            self.remove(robot)
        if self.recorder is not None:
            self.recorder.interrupted(f"world {instance} is served instead")
        self._instance, self._episode = instance, int(self._state.worlds.episode[instance])
        self.arena = self._batch.arena_of(self._state, instance)
        for robot, state in zip(robots, states, strict=True):
            self._join_world(robot, state)

    def _is_taken(self, instance: int, slot: int) -> bool:
        """Return whether the robot of a slot of a world is in use."""
        group, member = self.scene.group_of(slot)
        return bool(self._state.worlds.groups[group].active[instance, member])

    def _join_world(self, robot: Robot, state: RobotState) -> None:
        """Move a client's robot into this world, with its pose of another."""
        # Readings of the world before must not be reported as this one's.
        robot.pending.clear()
        self._start(robot, np.asarray(state.pos), np.asarray(state.quat))

    def set_command(self, robot: Robot, command: RobotCommand) -> None:
        """Replace the robot's command."""
        # The world's step counter begins at 0 again after a reset, while the clients' time goes on.
        shift = int(self._state.worlds.step[self._instance]) - self._steps
        robot.command = command
        self.edit(robot, command=command.replace(flip_until=command.flip_until + shift))

    def step(self) -> None:
        """Advance all worlds of the batch by one control step."""
        self._advance()

    def _advance(self) -> None:
        # Another served world may have made this step of the batch already: `advance` makes it only once.
        self._steps += 1
        self._shared.advance(self._steps)
        episode = int(self._state.worlds.episode[self._instance])
        before, self._episode = self._episode, episode
        # The batch resets a world that went bad by itself; its episode's number is all that tells.
        if episode != before:
            self.recovery_log.resets += 1
            log.error("the physics of world %d was not finite: it is reset, robots parked", self._instance)
            for robot in list(self.robots.values()):
                self._drop(robot)

    def _drop(self, robot: Robot) -> None:
        """Forget a robot that was lost without its client's doing."""
        del self.robots[robot.slot]

    def prepare_reset(self) -> None:
        """Compile what `reset` needs; may run in a thread."""
        nowhere = jnp.zeros(self._batch.worlds, bool)
        # A reset of no world compiles the program and leaves the state as it is.
        jax.block_until_ready(self._batch.reset_where(self._state, nowhere).worlds)

    def reset(self) -> None:
        """Begin this world's next episode; clients' robots return to their spawn poses."""
        here = np.arange(self._batch.worlds) == self._instance
        if self.recorder is not None:
            self.recorder.reset()
        self._state = self._batch.reset_where(self._state, jnp.asarray(here))
        self._episode = int(self._state.worlds.episode[self._instance])
        self.arena = self._batch.arena_of(self._state, self._instance)
        for robot in self.robots.values():
            self._restart_robot(robot)
        self.forget()

    def _restart_robot(self, robot: Robot) -> None:
        """Restart a client's robot in a world that has just been reset."""
        robot.restart(robot.command)
        self._start(robot, *self._homes[robot.slot])

    def observe(self, due: list[Robot]) -> None:
        """Read all sensors of the batch that are due; store those of the robots that clients have."""
        del due  # one compiled function reads all robots
        self._shared.observe()

    def keep(self, readings: Readings) -> None:
        """Store the readings of the robots that clients have."""
        for robot in self.robots.values():
            group, member = self.scene.group_of(robot.slot)
            at = (self._instance, member)
            robot.drowned = bool(self._state.worlds.groups[group].drowned[at])
            mine = jax.device_get(jax.tree.map(lambda x, at=at: x[at], readings[group]))
            for sensor, reading in enumerate(mine):
                if reading.fresh:
                    store_reading(self, robot, sensor, reading.value)

    def met_objects(self, robot: Robot, sensor: int) -> list[MetObject]:
        """Return the objects that the beams of a robot's object sensor meet now."""
        if self._finder is None:
            self._finder = ObjectFinder(self.scene)
        names = {slot: one.name for slot, one in self.robots.items()}
        return self._finder.find(*self.one_world(), (robot.slot, sensor), names, self.arena)

    def links(self, radio: RadioSettings) -> Links:
        """Return the radio links as they are now, by slot; those of the batch, if it has a radio."""
        if self.scene.radio is None:
            return super().links(radio)
        # The state keeps the links, which are evaluated once in a control step, however many ask.
        self._state, links = self._batch.links(self._state)
        return jax.tree.map(lambda x: np.asarray(x[self._instance]), links)

    def snapshot(self, requests: Sequence[CameraRequest | ViewpointRequest]) -> Callable[[], list[Picture]]:
        """Take a snapshot of the world for pictures; return a function that renders them."""
        # A state is never changed, and this one is kept: the world goes on while another thread renders it.
        state, instance = self._state, self._instance

        def render(asked: CameraRequest | ViewpointRequest) -> Picture:
            size = {"width": asked.width, "height": asked.height}
            if isinstance(asked, ViewpointRequest):
                return jax.device_get(self._batch.render_view(state, instance, asked.viewpoint, **size))
            camera = asked.robot.slot, asked.camera
            return jax.device_get(self._batch.render_robot(state, instance, *camera, **size))

        return lambda: [render(asked) for asked in requests]

    def operate(self, robot: Robot, effecter: int, opcode: Opcode, value: float) -> str:
        """Carry out a SET command on an effecter, by the batch's own program."""
        group, member = self.scene.group_of(robot.slot)
        at = (self._instance, member)
        # A mask over all robots of the group: the batch's program has the same shapes for each of them.
        where = np.zeros(self._state.worlds.groups[group].active.shape, bool)
        where[at] = True
        name = robot.effecters[effecter].mount.name
        what = name, opcode.name, np.array(value, np.float32)
        self._state, outcome = self._batch.operate(self._state, group, *what, where)
        command = jax.tree.map(lambda x: np.array(x[at]), self._state.worlds.groups[group].command)
        # The flip's end stays in the clients' time; the batch's own step count may have begun anew.
        robot.command = command.replace(flip_until=robot.command.flip_until)
        return status_of(jax.tree.map(lambda x: x[at], outcome))


def floor_correction(name: str, low: float, floor: float) -> float:
    """Return the lift of a robot with its lowest point at `low` [m] to the floor [m], and log it."""
    raised = max(0.0, floor - low)
    if raised > 0:
        log.info("%s would start %.3f m inside the floor: raised", name, raised)
    return raised


class InstanceSwitch:
    """Reads numbers of worlds from a terminal; a `gamebots.server.Service`.

    Args:
        world: The served world.
        worlds: Number of worlds in its batch.
        stream: The terminal.
    """

    def __init__(self, world: BatchWorld, worlds: int, stream: TextIO = sys.stdin) -> None:
        self._world, self._worlds, self._stream = world, worlds, stream
        self._listening = False

    async def start(self) -> list[str]:
        """Listen, if the stream is a terminal."""
        self._listening = self._stream.isatty()
        if not self._listening:
            return []
        asyncio.get_running_loop().add_reader(self._stream, self._read)
        return [f"another world: type its number, 0 to {self._worlds - 1}"]

    def _read(self) -> None:
        # A terminal hands over whole lines: this does not wait for the rest of one.
        line = self._stream.readline()
        if not line:  # the terminal has gone
            self.stop()
        elif line.strip():
            self.select(line.strip())

    def select(self, line: str) -> None:
        """Serve the world of that number; log the reason if it cannot be served."""
        try:
            if not line.isdecimal():
                raise UsageError(f"{line!r} is not the number of a world")
            self._world.switch(int(line))
        except UsageError as error:
            log.warning("the world stays: %s", error)
        else:
            print(f"usarmjx: world {line} is served now", flush=True)

    def tick(self) -> None:
        """Do nothing."""

    def stop(self) -> None:
        """Stop listening."""
        if self._listening:
            self._listening = False
            asyncio.get_running_loop().remove_reader(self._stream)
