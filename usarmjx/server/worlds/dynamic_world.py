"""A served world on C MuJoCo: robots of any class are added and removed while it runs.

Nothing here depends on the roster's shape: sensors are compiled once per robot class, against arrays of
geoms with capacity to spare, so that a new robot costs a recompilation of the MuJoCo model (tens of
milliseconds) and none of the sensors. When the capacity no longer suffices it doubles, and what depends on it
is compiled in `prepare`, in a thread.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.transforms import Vec3, quat_from_angles
from usarmjx.cameras.picture import Picture, render_picture_jit
from usarmjx.engines.c import buffer_warnings, move_geoms
from usarmjx.models.build.body_plan import BodyPoses, kinematic_tree_of, lowest_point, robot_state
from usarmjx.models.build.compose import Physics, add_robot, new_spec, remove_robot
from usarmjx.models.build.compose_arena import VICTIM_PREFIX
from usarmjx.models.build.layout import RobotIndex, index_robot
from usarmjx.models.build.materials import materials_of
from usarmjx.models.build.pieces import ray_primitives_of
from usarmjx.models.build.tags import tag_table
from usarmjx.models.build.victims import segment_poses, victim_table
from usarmjx.models.drives.state import RobotState
from usarmjx.models.effecters import Effecter, Opcode, no_dropped_tags
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.models.spec.shapes import OPAQUE, SKY
from usarmjx.sensors.base import Sensor, SensorInput
from usarmjx.sensors.rays.raycast import NO_HITS, RayQuery, cast_rays
from usarmjx.sensors.rays.targets import PADDING_DISTANCE, BlockKey, GeomBlock, Geoms, indices_by_key
from usarmjx.sensors.suite import SensorMemory, suite_of
from usarmjx.sensors.surroundings import Surroundings, surroundings_at
from usarmjx.server.worlds.compiled import RAY_BATCH_SIZE, CompiledRobot, materials_present
from usarmjx.server.worlds.dynamic_world_view import dynamic_render_scene
from usarmjx.server.worlds.served_world import CameraRequest, Robot, ServedWorld, ViewpointRequest, status_of
from usarmjx.sim.control import RobotCommand, idle_command
from usarmjx.sim.operate import EffecterState, Operation, apply_operation, effecter_position
from usarmjx.sim.scene import prefix_of
from usarmjx.sim.scene_geoms import door_qpos

log = logging.getLogger(__name__)

SPARE_GEOMS = 8
"""Geoms of each type for which there is always room."""


class DynamicWorld(ServedWorld):
    """One world on C MuJoCo.

    Args:
        arena: The arena.
        physics: Solver and time settings.
        key: Random key of the world's noise.
        max_robots: Most robots at once.

    Attributes:
        other_worlds: The other worlds of the batch, which are stepped along.
        tags: RFID tags that robots have dropped; numpy arrays.
    """

    def __init__(self, arena: ArenaSpec, physics: Physics, key: jax.Array, max_robots: int = 16) -> None:
        self.arena, self.period, self.robots = arena, physics.period, {}
        self.other_worlds: tuple[DynamicWorld, ...] = ()
        self.tags = no_dropped_tags(np)
        self._physics, self._key, self._max_robots = physics, key, max_robots
        self._spec = new_spec(arena, physics)
        # We count and reset worlds that go bad; C MuJoCo would do it without a word.
        self._spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._victims = victim_table(arena.victims, arena.false_alarms)
        self._tags = tag_table(arena.tags)
        self._swinging = np.flatnonzero(self._victims.swing > 0)
        if len(self._swinging):  # see `move_geoms`
            self._spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
        self._model = self._spec.compile()
        self._free_bones()
        self._data = mujoco.MjData(self._model)
        # What dropped things fall on: the arena without anything loose.
        self._ground = new_spec(replace(arena, loose=(), doors=()), physics).compile()
        self._ground_data = mujoco.MjData(self._ground)
        mujoco.mj_kinematics(self._ground, self._ground_data)
        sky = np.array(materials_of(self._ground, arena), object) == SKY
        self._ground.geom_rgba[sky, 3] = 0.0  # C MuJoCo's rays pass what is invisible
        self._steps = 0
        self._spawned = 0
        self._index: dict[int, RobotIndex] = {}
        self._memory: dict[int, SensorMemory] = {}
        self._stock: dict[int, np.ndarray] = {}
        self._spawn_qpos: dict[int, np.ndarray] = {}
        self._compiled: dict[str, CompiledRobot] = {}
        self._sort_pieces()
        self._capacity = _capacity_for(self._piece_indices)
        self._cast = jax.jit(cast_rays)
        self._compile_cast(self._capacity, materials_present(Sensor.transparent, arena))

    @property
    def time(self) -> float:
        """Simulated time since the world began [s]."""
        return self._steps * self.period

    def prepare(self, robot: RobotSpec) -> None:
        """Compile the sensors and the drive of a class; takes seconds the first time."""
        if robot.name not in self._compiled:
            surroundings = self._surroundings() if suite_of(robot).needs_surroundings else None
            self._compiled[robot.name] = CompiledRobot(robot, self.arena, self.period, surroundings)
        for passes, _ in self._compiled[robot.name].ray_queries:
            self._compile_cast(self._grown_capacity(robot), passes)

    def _grown_capacity(self, robot: RobotSpec) -> dict[BlockKey, int]:
        """Return the capacity for what is there and one more robot of that class; never less than now."""
        kinds = kinematic_tree_of(robot).geom_type
        wanted = _capacity_for(self._piece_indices, indices_by_key(kinds, [OPAQUE] * len(kinds)))
        return {key: max(n, wanted.get(key, 0)) for key, n in (wanted | self._capacity).items()}

    def _compile_cast(self, capacity: dict[BlockKey, int], passes: frozenset[str]) -> None:
        rays = np.ones((RAY_BATCH_SIZE, 3), np.float32)
        self._cast(_blank_geoms(capacity), rays, rays, _ray_query(passes, 0))

    def _sort_pieces(self) -> None:
        """Find out what rays see of the present model."""
        everything = np.arange(self._model.ngeom)
        self._pieces = ray_primitives_of(self._model, everything, materials_of(self._model, self.arena))
        self._piece_indices = indices_by_key(self._pieces.kind, self._pieces.material.tolist())

    def spawn(self, robot: RobotSpec, name: str, pos: Vec3, angles: Vec3) -> Robot:
        """Add a robot to the running model; the states of the others are kept bit for bit."""
        self.check_position(pos)
        free = [slot for slot in range(self._max_robots) if slot not in self.robots]
        if not free:
            raise UsageError(f"no seat left for another robot: {self._max_robots} are taken")
        self.prepare(robot)
        slot, self._capacity = free[0], self._grown_capacity(robot)
        add_robot(self._spec, robot, prefix_of(slot), pos)
        self._recompile()
        index = self._index[slot] = index_robot(self._model, robot, prefix_of(slot))
        root = slice(index.root_qposadr, index.root_qposadr + 7)
        self._data.qpos[root] = (*pos, *quat_from_angles(*angles))
        mujoco.mj_kinematics(self._model, self._data)
        low = lowest_point(self._model, self._data, np.isin(self._model.geom_bodyid, index.body_ids))
        self._data.qpos[index.root_qposadr + 2] += self.floor_correction(name, low, self.arena.floor)
        self._spawn_qpos[slot] = self._data.qpos[root].copy()
        command = jax.tree.map(np.array, idle_command(robot))
        new = Robot(slot=slot, name=name, suite=suite_of(robot), command=command, spawn_time=self.time)
        self.robots[slot] = new
        self._stock[slot] = np.array([effecter.initial_stock for effecter in new.effecters], np.int32)
        self._spawned += 1
        self._memory[slot] = self._compiled[robot.name].start(
            self._sensor_input(new), self._noise_key(new, self._spawned)
        )
        return new

    def remove(self, robot: Robot) -> None:
        """Take a robot out of the running model."""
        if self.robots.get(robot.slot) is robot:
            del self.robots[robot.slot]
            remove_robot(self._spec, prefix_of(robot.slot))
            for table in (self._index, self._memory, self._stock, self._spawn_qpos):
                table.pop(robot.slot)
            self._recompile()

    def _recompile(self) -> None:
        # The state of all that stays is kept, but indices into it shift: whatever holds some is made again.
        self._model, self._data = self._spec.recompile(self._model, self._data)
        self._free_bones()
        self._sort_pieces()
        for slot, robot in self.robots.items():
            self._index[slot] = index_robot(self._model, robot.spec, prefix_of(slot))

    def _free_bones(self) -> None:
        """Find the victims' boxes that move in the present model, and let them; see `move_geoms`."""
        self._bones = [self._model.geom(f"{VICTIM_PREFIX}{i}").id for i in self._swinging]
        self._model.geom_sameframe[self._bones] = 0

    def _move_victims(self) -> None:
        if len(self._swinging):
            pos, quat = segment_poses(self._victims, np.array(self.time, np.float32))
            move_geoms(self._model, self._bones, pos[self._swinging], quat[self._swinging])

    def set_command(self, robot: Robot, command: RobotCommand) -> None:
        """Replace the robot's command."""
        robot.command = command

    def step(self) -> None:
        """Advance by one control step; a world that goes bad is reset, with robots where they appeared."""
        for world in self.other_worlds:
            world.step()
        data = self._data
        for slot, robot in self.robots.items():
            index, targets = self._index[slot], list(self._index[slot].actadr)
            act, time = data.act[targets].astype(np.float32), np.float32(self.time)
            powered = np.bool_(self.battery(robot) > 0)
            inputs, drowned = self._compiled[robot.spec.name].drive(
                robot.command, self._state(slot), act, time, powered
            )
            robot.drowned |= bool(drowned)
            data.ctrl[list(index.actuator_ids)] = inputs.ctrl
            data.ctrl[list(index.hold_actuator_ids)] = inputs.hold
            data.act[targets] = inputs.act
            data.xfrc_applied[index.body_ids[0]] = inputs.wrench
        self._move_victims()
        before = buffer_warnings(data)
        mujoco.mj_step(self._model, data, nstep=self._physics.substeps)
        self._steps += 1
        if buffer_warnings(data) > before:
            log.error("contact buffers overflowed: contacts were lost")
        if not (np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()):
            self._reset()

    def _reset(self) -> None:
        log.error("the physics is not finite any more: robots go back to where they appeared")
        mujoco.mj_resetData(self._model, self._data)
        for slot, qpos in self._spawn_qpos.items():
            start = self._index[slot].root_qposadr
            self._data.qpos[start : start + 7] = qpos

    def observe(self, due: list[Robot]) -> None:
        """Read the sensors of the robots that are about to report."""
        self._move_victims()
        mujoco.mj_kinematics(self._model, self._data)
        geoms = self._geoms()
        around = self._surroundings() if any(robot.suite.needs_surroundings for robot in due) else None
        for robot in due:
            compiled = self._compiled[robot.spec.name]
            state = self._state(robot.slot)
            surroundings = around if robot.suite.needs_surroundings else None
            bodies, origin, direction = compiled.bodies_and_rays(state, surroundings)
            hits = NO_HITS
            for passes, mine in compiled.ray_queries:
                seen = self._cast(geoms, origin, direction, _ray_query(passes, robot.slot))
                hits = seen if hits is NO_HITS else jax.tree.map(partial(jnp.where, mine), seen, hits)
            time = np.array(self.time - robot.spawn_time, np.float32)
            inputs = SensorInput(time=time, state=state, bodies=bodies, hits=hits, surroundings=surroundings)
            key = self._noise_key(robot, self._steps)
            memory, readings = compiled.read(inputs, self._memory[robot.slot], key)
            self._memory[robot.slot] = memory
            for sensor, reading in enumerate(jax.device_get(readings)):
                if reading.fresh:
                    robot.pending[sensor] = reading.value

    def _noise_key(self, robot: Robot, count: int) -> jax.Array:
        return jax.random.fold_in(jax.random.fold_in(self._key, count), robot.slot)

    def _state(self, slot: int) -> RobotState:
        qpos, qvel = self._data.qpos.astype(np.float32), self._data.qvel.astype(np.float32)
        return robot_state(self._index[slot], qpos, qvel)

    def _sensor_input(self, robot: Robot) -> SensorInput:
        state = self._state(robot.slot)
        around = self._surroundings() if robot.suite.needs_surroundings else None
        bodies, _, _ = self._compiled[robot.spec.name].bodies_and_rays(state, around)
        time = np.array(self.time - robot.spawn_time, np.float32)
        return SensorInput(time=time, state=state, bodies=bodies, hits=NO_HITS, surroundings=around)

    def _surroundings(self) -> Surroundings:
        """Return the victims and tags as they are now."""
        time, floor = np.array(self.time, np.float32), np.array(self.arena.floor, np.float32)
        around = surroundings_at(self._victims, self._tags, self.tags, time, floor, np)
        return jax.tree.map(lambda x: x.astype(np.float32) if x.dtype == np.float64 else x, around)

    def _geoms(self) -> Geoms:
        """Return what rays can hit now, padded to the capacity."""
        model, data = self._model, self._data
        owner_of_body = np.full(model.nbody, -1, np.int32)
        for slot, index in self._index.items():
            owner_of_body[list(index.body_ids)] = slot
        pieces, geoms = self._pieces, _blank_geoms(self._capacity)
        pos, mat = pieces.world_poses(data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3))
        owner = owner_of_body[model.geom_bodyid[pieces.geom]]
        for kind, material, block in zip(geoms.kinds, geoms.materials, geoms.blocks, strict=True):
            members = self._piece_indices.get((kind, material), np.zeros(0, int))
            n = len(members)
            block.pos[:n], block.mat[:n] = pos[members], mat[members]
            block.size[:n], block.owner[:n] = pieces.size[members], owner[members]
        return geoms

    def state(self, robot: Robot) -> RobotState:
        """Return where the robot is and how it moves."""
        return self._state(robot.slot)

    def memory(self, robot: Robot) -> SensorMemory:
        """Return what the robot's sensors remember."""
        return self._memory[robot.slot]

    def door_angles(self) -> np.ndarray:
        """Return how far the arena's doors are open now [rad] (doors,)."""
        return self._data.qpos[door_qpos(self._model, self.arena)].astype(np.float32)

    def snapshot(self, requests: Sequence[CameraRequest | ViewpointRequest]) -> Callable[[], list[Picture]]:
        """Take a snapshot of what pictures show; return a function that renders them."""
        self._move_victims()
        mujoco.mj_kinematics(self._model, self._data)
        lit = {
            slot: robot.spec
            for slot, robot in self.robots.items()
            if robot.command.light and self.battery(robot) > 0
        }
        geoms = self._pieces, self._piece_indices, self._capacity, self._index, lit
        render_scene = dynamic_render_scene(self.arena, self._data, *geoms)
        views = [(self.viewpoint(request), request.width, request.height) for request in requests]
        return lambda: [jax.device_get(render_picture_jit(render_scene, *view)) for view in views]

    def bodies(self, robot: Robot) -> BodyPoses:
        """Return where the robot's bodies are."""
        mujoco.mj_kinematics(self._model, self._data)
        body = list(self._index[robot.slot].body_ids)
        pos, mat = self._data.xpos[body], self._data.xmat[body].reshape(-1, 3, 3)
        poses: dict[str, Any] = {"pos": pos.astype(np.float32), "mat": mat.astype(np.float32)}
        return BodyPoses(**poses)  # NumPy's arrays: nothing here is traced

    def operate_sensor(self, robot: Robot, sensor: int, opcode: str, params: tuple[float, ...]) -> bool:
        """Carry out a SET command on a sensor."""
        memory = robot.suite.handle_set(
            sensor, opcode, params, self._sensor_input(robot), self._memory[robot.slot]
        )
        if memory is not None:
            self._memory[robot.slot] = memory
        return memory is not None

    def operate(self, robot: Robot, effecter: int, opcode: Opcode, value: float) -> str:
        """Carry out a SET command on an effecter."""
        one, stock = robot.effecters[effecter], self._stock[robot.slot]
        after, outcome = apply_operation(
            Operation(robot=robot.spec, effecter=one, opcode=opcode),
            np.array([value], np.float32),
            EffecterState(
                command=jax.tree.map(lambda x: x[None], robot.command),
                stock=stock[effecter : effecter + 1],
                tags=self.tags,
            ),
            mask=np.array([self.battery(robot) > 0]),
            ground=lambda: self._below(robot, one)[None],
            xp=np,
        )
        self.set_command(robot, jax.tree.map(lambda x: np.array(x[0]), after.command))
        stock[effecter], self.tags = after.stock[0], after.tags
        return status_of(jax.tree.map(lambda x: x[0], outcome))

    def _below(self, robot: Robot, effecter: Effecter) -> np.ndarray:
        """Return the ground below an effecter [m] (3,), infinitely low where there is none."""
        bodies = self._sensor_input(robot).bodies
        point = np.asarray(effecter_position(effecter, robot.plan, jax.device_get(bodies)), float)
        hit = np.zeros(1, np.int32)
        depth = mujoco.mj_ray(self._ground, self._ground_data, point, (0.0, 0.0, -1.0), None, 1, -1, hit)
        return point - (0.0, 0.0, depth if hit[0] >= 0 else np.inf)


def _capacity_for(*indices: dict[BlockKey, np.ndarray]) -> dict[BlockKey, int]:
    """Return for how many geoms of each kind to make room: the next power of two, with some to spare."""
    counts = {key: sum(len(some.get(key, ())) for some in indices) for key in set().union(*indices)}
    return {key: max(SPARE_GEOMS, 1 << (n + SPARE_GEOMS - 1).bit_length()) for key, n in counts.items()}


def _ray_query(transparent: frozenset[str], slot: int) -> RayQuery:
    return RayQuery(transparent=transparent, incidence=True, exclude_owner=np.array(slot, np.int32))


def _blank_geoms(capacity: dict[BlockKey, int]) -> Geoms:
    keys = sorted(capacity)
    blocks = tuple(
        GeomBlock(
            pos=np.full((n, 3), PADDING_DISTANCE, np.float32),
            mat=np.tile(np.eye(3, dtype=np.float32), (n, 1, 1)),
            size=np.zeros((n, 3), np.float32),
            owner=np.full(n, -1, np.int32),
        )
        for n in map(capacity.__getitem__, keys)
    )
    kinds, materials = tuple(kind for kind, _ in keys), tuple(material for _, material in keys)
    return Geoms(blocks=blocks, kinds=kinds, materials=materials)
