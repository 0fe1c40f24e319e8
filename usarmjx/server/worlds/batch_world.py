"""A served world that is one of a running batch: clients claim parked robots of the roster.

The batch's shape is fixed, so INIT can only activate a parked robot of the asked class; disconnecting parks
it again. All worlds of the batch run on; only the served one listens to clients.
"""

import logging
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.transforms import Vec3, quat_from_angles
from usarmjx.cameras.picture import Picture
from usarmjx.models.build.body_plan import BodyPoses, KinematicTree, forward_kinematics, kinematic_tree_of
from usarmjx.models.drives.state import RobotState
from usarmjx.models.effecters import Opcode
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.base import SensorInput
from usarmjx.sensors.suite import SensorMemory
from usarmjx.server.worlds.served_world import CameraRequest, Robot, ServedWorld, ViewpointRequest, status_of
from usarmjx.sim.batch import Batch
from usarmjx.sim.control import RobotCommand, idle_command
from usarmjx.sim.scene import PARKING_HEIGHT
from usarmjx.sim.world import GroupState, robot_states, sense_self, time_of

log = logging.getLogger(__name__)

ROBOT_FIELDS = ("state", "bodies", "hits")
"""What of a group's `SensorInput` has a leading axis over robots."""


class BatchWorld(ServedWorld):
    """World `instance` of a batch.

    Args:
        batch: The batch; its roster's parked robots can be claimed.
        instance: Which world to serve.

    Raises:
        UsageError: The batch has no such world.
    """

    def __init__(self, batch: Batch, instance: int) -> None:
        if not 0 <= instance < batch.worlds:
            raise UsageError(f"instance {instance} is not among worlds 0 to {batch.worlds - 1}")
        self.period, self.robots = batch.scene.physics.period, {}
        self._batch, self._instance = batch, instance
        self._state = batch.reset()
        self.arena = batch.arena_of(self._state, instance)
        self._steps = 0
        self._sense_self = [
            jax.jit(partial(sense_self, batch.scene, group=group)) for group in batch.scene.groups
        ]
        self._advance()

    def warm_up(self) -> None:
        """Let one robot of each class come, be read and take a command, and forget it all."""
        before = self._state
        for group in self._batch.scene.groups:
            pos = (0.0, 0.0, self.arena.floor + group.plan.clearance + PARKING_HEIGHT)
            robot = self._activate(int(group.slots[0]), group.robot, "nobody", pos, (0.0, 0.0, 0.0))
            self.observe([robot])
            self.set_command(robot, robot.command)
            self.state(robot)
            for index, effecter in enumerate(group.effecters):
                for opcode in effecter.opcodes:
                    self.operate(robot, index, opcode, opcode.default_val or 0.0)
            self.remove(robot)
        self._state = before

    @property
    def time(self) -> float:
        """Simulated time since the world began [s]; it goes on when a world that went bad is reset."""
        return self._steps * self.period

    def _sensor_input(self, robot: Robot) -> SensorInput:
        group, member = self._batch.scene.group_of(robot.slot)
        world, physics = jax.tree.map(
            lambda x: x[self._instance], (self._state.worlds, self._batch.physics(self._state))
        )
        inputs = self._sense_self[group](world, physics)
        own = {name: getattr(inputs, name) for name in ROBOT_FIELDS}
        return inputs.replace(**jax.tree.map(lambda x: x[member], own))

    def _edit(self, robot: Robot, **fields: Any) -> None:  # noqa: ANN401 - PyTrees of one robot
        """Replace fields of one robot's part of its group's state."""
        group, member = self._batch.scene.group_of(robot.slot)
        state: GroupState = self._state.worlds.groups[group]
        at = (self._instance, member)
        new = {
            name: jax.tree.map(lambda old, value: old.at[at].set(value), getattr(state, name), value)
            for name, value in fields.items()
        }
        self._state = self._batch.with_group(self._state, group, state.replace(**new))

    def spawn(self, robot: RobotSpec, name: str, pos: Vec3, angles: Vec3) -> Robot:
        """Activate a parked robot of that class and put it there."""
        self.check_position(pos)
        for group, state in zip(self._batch.scene.groups, self._state.worlds.groups, strict=True):
            parked = np.flatnonzero(~np.asarray(state.active[self._instance]))
            if group.robot.name == robot.name and parked.size:
                slot = int(group.slots[parked[0]])
                return self._activate(slot, robot, name, pos, angles)
        raise UsageError(f"no parked {robot.name} left in the roster: add more of them to --roster")

    def _activate(self, slot: int, robot: RobotSpec, name: str, pos: Vec3, angles: Vec3) -> Robot:
        lifted = self.floor_correction(name, pos[2] - kinematic_tree_of(robot).clearance, self.arena.floor)
        self._set_pose(slot, (pos[0], pos[1], pos[2] + lifted), quat_from_angles(*angles))
        number, _ = self._batch.scene.group_of(slot)
        group = self._batch.scene.groups[number]
        command = jax.tree.map(np.array, idle_command(robot))
        new = Robot(slot=slot, name=name, suite=group.suite, command=command, spawn_time=self.time)
        world_time = time_of(self._batch.scene, jax.tree.map(lambda x: x[self._instance], self._state.worlds))
        stock = np.array(group.releases, np.int32)
        fov = np.array(new.fovs, np.float32)
        self._edit(
            new,
            active=True,
            battery_start=world_time,
            drowned=False,
            command=command,
            releases=stock,
            fov=fov,
        )
        key = jax.random.fold_in(
            jax.random.fold_in(self._state.worlds.key[self._instance], self._steps), slot
        )
        self._edit(new, memory=group.suite.init_memory(self._sensor_input(new), key))
        self.robots[slot] = new
        return new

    def _set_pose(self, slot: int, pos: Vec3, quat: np.ndarray) -> None:
        scene = self._batch.scene
        group, member = scene.group_of(slot)
        index = scene.groups[group].indices[member]
        shape = (self._batch.worlds, scene.model.nq)
        pinned, qpos = np.zeros(shape, bool), np.zeros(shape, np.float32)
        pinned_dof = np.zeros((self._batch.worlds, scene.model.nv), bool)
        root = slice(index.root_qposadr, index.root_qposadr + 7)
        pinned[self._instance, root], qpos[self._instance, root] = True, (*pos, *quat)
        pinned_dof[self._instance, index.root_dofadr : index.root_dofadr + 6] = True
        engine = self._batch.engine
        self._state = self._state.replace(
            physics=engine.set_qpos(self._state.physics, pinned, pinned_dof, qpos)
        )

    def remove(self, robot: Robot) -> None:
        """Park the robot again."""
        if self.robots.get(robot.slot) is robot:  # its slot may be another's by now
            del self.robots[robot.slot]
            self._edit(robot, active=False, command=jax.tree.map(np.array, idle_command(robot.spec)))

    def set_command(self, robot: Robot, command: RobotCommand) -> None:
        """Replace the robot's command."""
        # The world's own time begins at 0 again when it is reset, that of its clients goes on.
        shift = jnp.asarray(self._world_time() - self.time)
        robot.command = command
        self._edit(robot, command=command.replace(flip_until=command.flip_until + shift))

    def _world_time(self) -> float:
        return float(self._state.worlds.step[self._instance]) * self.period

    def step(self) -> None:
        """Advance all worlds of the batch by one control step."""
        self._advance()

    def _advance(self) -> None:
        before = int(self._state.worlds.episode[self._instance])
        self._state = self._batch.step(self._state)
        self._steps += 1
        if int(self._state.worlds.episode[self._instance]) != before:
            log.error("the physics of world %d was not finite: it is reset, robots parked", self._instance)
            self.robots.clear()

    def observe(self, due: list[Robot]) -> None:
        """Read all sensors of the batch that are due; keep what the served world's clients will want."""
        del due  # one compiled function reads everybody
        self._state, readings = self._batch.observe(self._state)
        for robot in self.robots.values():
            group, member = self._batch.scene.group_of(robot.slot)
            at = (self._instance, member)
            robot.drowned = bool(self._state.worlds.groups[group].drowned[at])
            mine = jax.device_get(jax.tree.map(lambda x, at=at: x[at], readings[group]))
            for sensor, reading in enumerate(mine):
                if reading.fresh:
                    robot.pending[sensor] = reading.value

    def state(self, robot: Robot) -> RobotState:
        """Return where the robot is and how it moves."""
        group, member = self._batch.scene.group_of(robot.slot)
        physics = jax.tree.map(lambda x: x[self._instance], self._batch.physics(self._state))
        states = robot_states(self._batch.scene.groups[group], physics)
        return jax.tree.map(lambda x: np.asarray(x[member]), states)

    def bodies(self, robot: Robot) -> BodyPoses:
        """Return where the robot's bodies are."""
        return jax.device_get(_poses(robot.plan)(self.state(robot)))

    def memory(self, robot: Robot) -> SensorMemory:
        """Return what the robot's sensors remember."""
        group, member = self._batch.scene.group_of(robot.slot)
        return jax.tree.map(lambda x: x[self._instance, member], self._state.worlds.groups[group].memory)

    def door_angles(self) -> np.ndarray:
        """Return how far the arena's doors are open now [rad] (doors,)."""
        return np.asarray(self._batch.physics(self._state).qpos[self._instance, self._batch.scene.door_qpos])

    def zoom(self, robot: Robot, camera: int, fov: float) -> bool:
        """Set a camera's field of view, in the batch too."""
        done = super().zoom(robot, camera, fov)
        self._edit(robot, fov=np.array(robot.fovs, np.float32))
        return done

    def snapshot(self, requests: Sequence[CameraRequest | ViewpointRequest]) -> Callable[[], list[Picture]]:
        """Take a snapshot of what pictures show; return a function that renders them."""
        state, instance = self._state, self._instance

        def render(asked: CameraRequest | ViewpointRequest) -> Picture:
            size = {"width": asked.width, "height": asked.height}
            if isinstance(asked, ViewpointRequest):
                return jax.device_get(self._batch.render_view(state, instance, asked.viewpoint, **size))
            camera = asked.robot.slot, asked.camera
            return jax.device_get(self._batch.render_robot(state, instance, *camera, **size))

        return lambda: [render(asked) for asked in requests]

    def operate_sensor(self, robot: Robot, sensor: int, opcode: str, params: tuple[float, ...]) -> bool:
        """Carry out a SET command on a sensor."""
        memory = robot.suite.handle_set(sensor, opcode, params, self._sensor_input(robot), self.memory(robot))
        if memory is not None:
            self._edit(robot, memory=memory)
        return memory is not None

    def operate(self, robot: Robot, effecter: int, opcode: Opcode, value: float) -> str:
        """Carry out a SET command on an effecter, as the batch does it."""
        group, member = self._batch.scene.group_of(robot.slot)
        at = (self._instance, member)
        where = np.zeros(self._state.worlds.groups[group].active.shape, bool)
        where[at] = True
        name = robot.effecters[effecter].mount.name
        what = name, opcode.name, np.array(value, np.float32)
        self._state, outcome = self._batch.operate(self._state, group, *what, where)
        command = jax.tree.map(lambda x: np.array(x[at]), self._state.worlds.groups[group].command)
        robot.command = command.replace(flip_until=robot.command.flip_until)
        return status_of(jax.tree.map(lambda x: x[at], outcome))


@cache
def _poses(plan: KinematicTree) -> Callable[[RobotState], BodyPoses]:
    return jax.jit(partial(forward_kinematics, plan))
