"""A served world whose robots a policy drives; clients take over some of them.

All worlds of the batch do the policy's task. It reads sensors once for each action, as in training, and
clients get the same readings, so clients change nothing for the policy. Sensors of their class that the task
leaves out are read for them alone.
"""

import asyncio
import logging
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base import random
from usarmjx.base.backend import Array, numpy_backend
from usarmjx.base.errors import UsageError
from usarmjx.base.program_cache import PrecompiledProgram, compile_program
from usarmjx.base.transforms import Vec3
from usarmjx.engines import PhysicsState
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.drives.base import RobotState
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.base import Reading
from usarmjx.sensors.suite import SensorMemory, Suite, suite_of
from usarmjx.server.worlds.batch_world import BatchWorld, SharedBatch
from usarmjx.server.worlds.recorded import store_reading
from usarmjx.server.worlds.robot import Robot
from usarmjx.sim.actions import apply_actions
from usarmjx.sim.batch import select_worlds
from usarmjx.sim.control import idle_command
from usarmjx.sim.radio import update_links
from usarmjx.sim.reset import new_group_state, start_sensors
from usarmjx.sim.scene import RobotGroup, Scene
from usarmjx.sim.world import World, observe
from usarmjx.train.envs.env import Env, command
from usarmjx.train.envs.recipe import spec_of
from usarmjx.train.envs.task import Policy, TaskView, TeamMaps
from usarmjx.train.learning.checkpoint import Checkpoints
from usarmjx.train.policies.sources import PolicySource, load_policy


def join_memories(first: SensorMemory, second: SensorMemory) -> SensorMemory:
    """Return the memory of two suites of one robot, one after the other; NumPy arrays."""
    return SensorMemory(
        due=np.concatenate([first.due, second.due]),
        lead=np.concatenate([first.lead, second.lead]),
        armed=np.concatenate([first.armed, second.armed]),
        own=(*first.own, *second.own),
        last=(*first.last, *second.last),
    )


def split_memory(memory: SensorMemory, count: int) -> tuple[SensorMemory, SensorMemory]:
    """Return the memories of the first sensors and of the others: the inverse of `join_memories`."""
    parts = slice(count), slice(count, None)
    first, second = (
        SensorMemory(**{name: getattr(memory, name)[part] for name in vars(memory)}) for part in parts
    )
    return first, second


@dataclass
class _Memories:
    """Memories of a group's further sensors in one episode of one world.

    Attributes:
        episode: Number of the world, and of its episode.
        held: Memories (robots, ...).
    """

    episode: tuple[int, int]
    held: SensorMemory


class ClassSensors:
    """Sensors that robots of a scene would have by their classes, beside those of the scene.

    They are read for one world at a time, and only when a client's robot reports. The first reading of a
    class compiles its program; `prepare` does that ahead.

    Args:
        scene: A task's scene.
        classes: The descriptions that its robots were made from, with all sensors.
    """

    def __init__(self, scene: Scene, classes: Sequence[RobotSpec]) -> None:
        by_name = {robot.name: robot for robot in classes}
        self._scene = scene
        self._groups = tuple(_further(group, by_name.get(group.robot.name)) for group in scene.groups)
        self.suites = tuple(
            _joined(own, further) for own, further in zip(scene.groups, self._groups, strict=True)
        )
        """All sensors of each group's robots: the scene's own first."""
        self._memories: dict[int, _Memories] = {}
        self._programs = [
            # A kept program would have to be known by the classes, too: these are compiled anew.
            compile_program(partial(self._read, group), None, "ClassSensors")
            for group in range(len(self._groups))
        ]

    def has(self, group: int) -> bool:
        """Return whether robots of a group have further sensors."""
        return bool(self._groups[group].suite.sensors)

    def _scene_of(self, group: int) -> Scene:
        """Return a scene in which the robots of a group have their further sensors, and the others none."""
        groups = [_without_sensors(one) for one in self._scene.groups]
        groups[group] = self._groups[group]
        return self._scene.with_robots(self._scene.model, self._scene.roster, tuple(groups))

    def _read(
        self, group: int, world: World, physics: PhysicsState, memory: SensorMemory
    ) -> tuple[SensorMemory, tuple[Reading, ...]]:
        """Read what is due of the robots of a group; traced, for one world."""
        scene = self._scene_of(group)
        nothing = [suite_memory(len(one.slots)) for one in self._scene.groups]
        # The other groups read nothing, and their memories must have the shapes of that.
        states = [state.replace(memory=none) for state, none in zip(world.groups, nothing, strict=True)]
        states[group] = states[group].replace(memory=memory)
        after, readings = observe(scene, world.replace(groups=tuple(states), mail=None), physics)
        return after.groups[group].memory, readings[group]

    def prepare(self, group: int, world: World, physics: PhysicsState, started: SensorMemory) -> None:
        """Compile the program of a group; nothing is read. May run in a thread."""
        jax.block_until_ready(self._programs[group](world, physics, started))

    def start(self, group: int, world: World, physics: PhysicsState) -> SensorMemory:
        """Return the memories of a group whose further sensors start now; of one world, NumPy arrays."""
        further = self._groups[group]
        with numpy_backend():
            since = np.full(len(further.slots), world.step, np.int32)
            state = new_group_state(self._scene, further, True, since)
            return start_sensors(self._scene_of(group), world, physics, further, state).memory

    def restart(self, group: int, member: int, now: tuple[World, PhysicsState], world: int) -> None:
        """Let a robot's further sensors start now, for the client that takes it over."""
        fresh = self.start(group, *now)
        self.store(group, member, jax.tree.map(lambda x: np.asarray(x)[member], fresh), now, world)

    def memory(self, group: int, member: int, now: tuple[World, PhysicsState], world: int) -> SensorMemory:
        """Return the memory of a robot's further sensors; NumPy arrays."""
        held = self._held(group, now, world).held
        return jax.tree.map(lambda x: np.asarray(x)[member], held)

    def store(
        self, group: int, member: int, memory: SensorMemory, now: tuple[World, PhysicsState], world: int
    ) -> None:
        """Replace the memory of a robot's further sensors."""

        def put(old: Any, new: Any) -> np.ndarray:  # noqa: ANN401 - arrays
            # A copy, as arrays from the device cannot be written to.
            changed = np.array(old)
            changed[member] = new
            return changed

        kept = self._held(group, now, world)
        kept.held = jax.tree.map(put, kept.held, memory)

    def read(
        self,
        group: int,
        now: tuple[World, PhysicsState],
        traced: tuple[World, PhysicsState],
        world: int,
    ) -> tuple[Reading, ...]:
        """Read what is due of the robots of a group; by sensor, NumPy arrays (robots, ...).

        Args:
            group: Index of the group.
            now: World and physics as NumPy arrays.
            traced: The same for compiled programs.
            world: Number of the world.
        """
        kept = self._held(group, now, world)
        kept.held, readings = self._programs[group](*traced, kept.held)
        return jax.device_get(readings)

    def _held(self, group: int, now: tuple[World, PhysicsState], world: int) -> _Memories:
        """Return the memories of a group, new ones in another episode or world."""
        episode = world, int(now[0].episode)
        kept = self._memories.get(group)
        # Sensors start anew with an episode: drift and timers of the one before must not go on.
        if kept is None or kept.episode != episode:
            kept = self._memories[group] = _Memories(episode, self.start(group, *now))
        return kept


def suite_memory(robots: int) -> SensorMemory:
    """Return the memory of robots without sensors (robots, 0)."""
    none = np.zeros((robots, 0), np.int32)
    return SensorMemory(due=none, lead=none, armed=none.astype(bool), own=(), last=())


def _further(group: RobotGroup, robot: RobotSpec | None) -> RobotGroup:
    """Return a group with the sensors of its class that it lacks, and no others."""
    # In lower case, as types and names match without case on the wire.
    had = {(mount.kind.lower(), mount.name.lower()) for mount in group.robot.sensors}
    missing = [
        mount
        for mount in (robot.sensors if robot is not None else ())
        if (mount.kind.lower(), mount.name.lower()) not in had
    ]
    return _equipped(group, replace(group.robot, sensors=tuple(missing)))


def _without_sensors(group: RobotGroup) -> RobotGroup:
    return _equipped(group, replace(group.robot, sensors=()))


def _equipped(group: RobotGroup, robot: RobotSpec) -> RobotGroup:
    return replace(group, plan=kinematic_tree_of(robot), suite=suite_of(robot))


def _joined(own: RobotGroup, further: RobotGroup) -> Suite:
    """Return a suite of both groups' sensors, of a robot with both groups' mounts."""
    if not further.robot.sensors:
        return own.suite
    robot = replace(own.robot, sensors=(*own.robot.sensors, *further.robot.sensors))
    return Suite(kinematic_tree_of(robot), (*own.suite.sensors, *further.suite.sensors))


log = logging.getLogger(__name__)

INTERVAL = 2.0
"""Interval between two looks into a run's folder [s]."""
COMPILERS = 2
"""Threads that compile while the next program is traced."""
Readings = tuple[tuple[Reading, ...], ...]
Parts = tuple[World, PhysicsState, Readings]
"""Parts of a `TaskView` that change (worlds, ...)."""


class PolicyState(struct.PyTreeNode, kw_only=True):
    """State of the task and its policy in all worlds.

    Attributes:
        task: The task's memory (worlds, ...).
        policy: The policy's memory (worlds, ...).
        length: Actions since the task began (worlds,).
        score: The task's score so far (worlds,).
        episode: Number of the task's episode (worlds,).
    """

    task: Any
    policy: Any
    length: Array
    score: Array
    episode: Array


def _blank(one: jax.ShapeDtypeStruct) -> Array:
    """Return an array of a shape; its values count for nothing."""
    kind: Any = one.dtype
    is_key = bool(jnp.issubdtype(kind, jax.dtypes.prng_key))
    # Random keys have a type that NumPy does not know.
    blank = jnp.broadcast_to(random.key(0), one.shape) if is_key else np.zeros(one.shape, kind)
    return blank  # pyright: ignore[reportUnknownVariableType] - NumPy has no type for `kind`


class PolicyBatch(SharedBatch):
    """A task's batch with a policy in it, of which some worlds are served.

    All worlds of the batch do the policy's task; its actions leave out the robots that clients have. When the
    task is over, by success or by time, it is reset with the robots at their present poses, so that no client
    loses its robot; the arena stays.

    Args:
        env: The task.
        policy: The policy.
        seed: Seed of the policy's random numbers and those of later episodes of the task.

    Attributes:
        claimed: Which robots clients have (worlds, robots).
        measured: The control step after which sensors were last read.
        readings: Their values, as NumPy arrays, by group and sensor (worlds, robots of the group).
    """

    def __init__(self, env: Env, policy: Policy, seed: int = 0) -> None:
        super().__init__(env.batch)
        self.env, self._policy = env, policy
        self.claimed = np.zeros((env.worlds, env.scene.num_robots), bool)
        self._key = random.key(seed)
        self._sense_all = PrecompiledProgram(
            compile_program(jax.vmap(self._sense), env.program_cache, "PolicyBatch")
        )
        # Only traced, within `_advance`: it needs no program that is compiled ahead.
        self._begin_all = jax.jit(self._of_views(self._begin))
        self._advance_all = self._program(self._advance, precise=False)
        self._apply_actions_all = self._program(self._of_views(self._apply_actions), precise=True)
        self._act = PrecompiledProgram(jax.jit(policy.act))
        self._maps_of: Callable[..., Any] = jax.jit(self._map_world)
        self._maps: dict[int, tuple[int, TeamMaps | None]] = {}
        self._episodes = np.asarray(self.state.worlds.episode)
        self._task_keys = self._keys_of_task()
        with ThreadPoolExecutor(COMPILERS, "compile") as pool:
            self._policy_state = self._compile_all(pool)
            super()._step()  # a client that comes at once finds a world that has begun
            self._act_on(self._views(), np.ones(env.worlds, bool))

    def _compile_all(self, pool: Executor) -> PolicyState:
        """Trace all programs in turn while others compile; return a state before the first episode."""
        count = self.env.worlds
        physics = self.batch.physics(self.state)
        worlds, readings = self._sense_all.compile_in(pool, self.state.worlds, physics)
        # Shapes stand for values from here on: nothing is computed before all programs are compiled.
        parts = worlds, jax.eval_shape(lambda: physics), readings
        zero = np.zeros(count, np.int32)
        task = jax.eval_shape(self._begin_all, parts, self._task_keys, zero)
        blank = PolicyState(
            task=jax.tree.map(_blank, task),
            policy=self._policy.initial_carry(count),
            length=zero,
            score=np.zeros(count, np.float32),
            # Below 0 stands for no episode yet: the first advance begins one everywhere.
            episode=zero - 1,
        )
        again = np.ones(count, bool)
        advanced = self._advance_all.compile_in(pool, parts, blank, self._task_keys, again)
        key = jax.random.fold_in(self._key, 0)
        actions = self._act.compile_in(pool, blank.policy, advanced[1], key)[1]
        self._apply_actions_all.compile_in(pool, parts, advanced[0].task, actions, self.claimed)
        return blank

    def _program(self, function: Callable[..., Any], *, precise: bool) -> PrecompiledProgram:
        """Return a function of all worlds as a program that can be compiled before it is called."""
        return PrecompiledProgram(
            compile_program(function, self.env.program_cache, "PolicyBatch", precise=precise)
        )

    def _of_views(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function of one world's view and more as one of the parts of all worlds' views."""

        def of_parts(parts: Parts, *rest: Any) -> Any:  # noqa: ANN401
            world, physics, readings = parts
            return function(
                TaskView(world=world, physics=physics, readings=readings, scene=self.env.scene), *rest
            )

        # The cache of programs knows each one by its name.
        of_parts.__name__ = function.__name__
        return jax.vmap(of_parts)

    def use_policy(self, policy: Policy) -> None:
        """Replace the policy; it is compiled before its first action. May be called in a thread.

        Its memory must be of the same shapes as that of the one before, and goes on.
        """
        # A new program beside the old one, which drives until this one is compiled.
        act = PrecompiledProgram(jax.jit(policy.act))
        # By the arguments of the last action: their shapes are those of the next one, too.
        act.compile(*self._act_example)
        # One assignment at the end: the loop's thread may act at any moment.
        self._act, self._policy = act, policy

    # The functions up to `_advance` are traced, all but the last for one world.

    def _sense(self, world: World, physics: PhysicsState) -> tuple[World, Readings]:
        world, readings = observe(self.env.scene, world, physics)
        if self.env.scene.radio is not None:
            world = world.replace(links=update_links(self.env.scene, world, physics))
        return world, readings

    def _map_world(self, memory: Any, world: int) -> Any:  # noqa: ANN401
        return self.env.task.maps(self.env.scene, jax.tree.map(lambda x: x[world], memory))

    def _begin(self, view: TaskView, key: jax.Array, episode: jax.Array) -> Any:  # noqa: ANN401 - task memory
        return self.env.task.start(view, jax.random.fold_in(key, episode))

    def _apply_actions(
        self,
        view: TaskView,
        memory: Any,  # noqa: ANN401
        actions: tuple[jax.Array, ...],
        claimed: Array,
    ) -> tuple[World, Any]:
        """Apply actions to the robots that no client has claimed (robots,); return the task's memory, too."""
        task, scene = self.env.task, self.env.scene
        commands, memory = command(task, view, memory, actions)
        sends = task.reports_itself
        return apply_actions(
            scene, view.world, view.physics, commands, where=~claimed, all_send=sends
        ), memory

    def _advance(
        self, parts: Parts, before: PolicyState, keys: jax.Array, again: Array
    ) -> tuple[PolicyState, Any, jax.Array]:
        """Evaluate the last actions of all worlds, begin what is over, observe.

        Args:
            parts: Parts of the worlds' views.
            before: State before those actions.
            keys: Random keys of the task (worlds,).
            again: Worlds whose physics began anew (worlds,).

        Returns:
            The state now, the observations, and the worlds that begin an episode (worlds,).
        """
        result = self._of_views(self.env.task.evaluate)(parts, before.task)
        over = result.terminated | (before.length + 1 >= self.env.episode_steps)
        began = over | again | (before.episode < 0)
        episode = before.episode + began
        fresh = self._begin_all(parts, keys, episode)
        task = jax.tree.map(partial(select_worlds, began), fresh, result.memory)
        state = PolicyState(
            task=task,
            policy=before.policy,
            length=jnp.where(began, 0, before.length + 1),
            # Before the first episode the memory is blank, and so its score means nothing.
            score=jnp.where(before.episode < 0, 0.0, result.score),
            episode=episode,
        )
        # Numbers without a type of their own would compile the next call again.
        state = jax.tree.map(lambda new, old: new.astype(old.dtype), state, before)
        return state, self._of_views(self.env.task.observe)(parts, state.task), began

    # The methods below run on the host.

    def _step(self) -> None:
        """Advance by one control step; at the end of each action the policy acts."""
        super()._step()
        if self.steps % self.env.task.repeat == 0:
            episodes = np.asarray(self.state.worlds.episode)
            # The batch resets a world that went bad by itself: there the task begins anew.
            again, self._episodes = episodes != self._episodes, episodes
            self._act_on(self._views(), again)

    def _views(self) -> Parts:
        """Read the sensors of all worlds; return the parts of the task's views."""
        physics = self.batch.physics(self.state)
        worlds, readings = self._sense_all(self.state.worlds, physics)
        self.measured, self.readings = self.steps, jax.device_get(readings)
        return worlds, physics, readings

    def _act_on(self, parts: Parts, again: np.ndarray) -> None:
        """Apply the policy's actions, with a fresh memory where an episode begins.

        Args:
            parts: Parts of the worlds' views.
            again: Worlds whose physics began anew (worlds,).
        """
        state, obs, began = self._advance_all(parts, self._policy_state, self._task_keys, again)
        initial = self._policy.initial_carry(self.env.worlds)
        memory = jax.tree.map(partial(select_worlds, began), initial, state.policy)
        # Kept for `use_policy`, which compiles by it.
        self._act_example = memory, obs, jax.random.fold_in(self._key, self.steps)
        memory, actions = self._act(*self._act_example)
        worlds, task = self._apply_actions_all(parts, state.task, actions, self.claimed)
        self.state = self.state.replace(worlds=worlds)
        self._policy_state = state.replace(policy=memory, task=task)

    def maps(self, world: int) -> TeamMaps | None:
        """Return the maps that the robots of a world are building, as of the last action."""
        before = self._maps.get(world)
        # Once for each reading of the sensors, however many ask.
        if before is None or before[0] != self.measured:
            maps = self._maps_of(self._policy_state.task, world)
            self._maps[world] = before = self.measured, jax.device_get(maps)
        return before[1]

    def task_memory(self, world: int) -> Any:  # noqa: ANN401 - the task's own
        """Return the task's memory of a world as of the last action."""
        return jax.tree.map(lambda x: x[world], self._policy_state.task)

    def _keys_of_task(self) -> jax.Array:
        # Actions fold the step into the same key: a number beyond all steps keeps the two streams apart.
        return jax.random.split(jax.random.fold_in(self._key, 1 << 30), self.env.worlds)

    def score(self, world: int) -> float:
        """Return the task's score of a world so far."""
        return float(self._policy_state.score[world])

    def time_left(self, world: int) -> float:
        """Return the time until the episode of a world ends at the latest [s]."""
        return float(self.env.episode_steps - int(self._policy_state.length[world])) * self.env.period


class PolicyWorld(BatchWorld):
    """World `instance` of a task's batch, with a policy in it.

    INIT with the name of one of the task's robots takes that robot over at its present pose. Any other name
    gets the first unclaimed robot of its class, at the pose of the INIT. Until its client leaves, the
    policy's actions leave that robot out; then the policy drives it again.

    Args:
        shared: The batch and its policy; several worlds of it may be served.
        instance: Number of the served world.

    Attributes:
        policy_batch: The batch and its policy.

    Raises:
        UsageError: The batch has no such world.
    """

    def __init__(self, shared: PolicyBatch, instance: int = 0) -> None:
        super().__init__(shared, instance)
        self.policy_batch = shared
        self._class_sensors = ClassSensors(self.scene, [spec_of(one) for one in shared.env.task.robots])
        self._agents = {slot: self._robot(slot, name) for name, slot in self.agents().items()}

    @property
    def present(self) -> dict[int, Robot]:
        """All robots of the task, by slot: the clients', and those that the policy drives."""
        return {**self._agents, **self.robots}

    def _robot(self, slot: int, name: str) -> Robot:
        """Return one of the task's robots without a command or readings."""
        number, _ = self.scene.group_of(slot)
        suite = self._class_sensors.suites[number]
        command = jax.tree.map(np.array, idle_command(suite.plan.robot))
        return Robot(slot=slot, name=name, suite=suite, command=command, spawn_time=self.time)

    def prepare(self, robot: RobotSpec) -> None:
        """Compile what reads the sensors of a class that the task leaves out; may run in a thread."""
        super().prepare(robot)
        for number, group in enumerate(self.scene.groups):
            if group.robot.name == robot.name and self._class_sensors.has(number):
                started = self._class_sensors.start(number, *self.one_world())
                self._class_sensors.prepare(number, *self._traced_world(), started)

    def _traced_world(self) -> tuple[World, PhysicsState]:
        """Return the world and its physics as compiled programs take them, without an axis over worlds."""
        now = self._state.worlds, self._batch.physics(self._state)
        return jax.tree.map(lambda x: x[self._instance], now)

    def memory(self, robot: Robot) -> SensorMemory:
        """Return the memory of the robot's sensors, those that the task reads first; NumPy arrays."""
        group, member = self.scene.group_of(robot.slot)
        own = super().memory(robot)
        if not self._class_sensors.has(group):
            return own
        further = self._class_sensors.memory(group, member, self.one_world(), self._instance)
        return join_memories(own, further)

    def edit(self, robot: Robot, **fields: Any) -> None:  # noqa: ANN401 - PyTrees of one robot
        """Replace fields of the robot's part of its group's state."""
        group, member = self.scene.group_of(robot.slot)
        memory = fields.get("memory")
        own = len(self.scene.groups[group].suite.sensors)
        # A memory longer than the scene's sensors is a joined one, from `memory`.
        if memory is not None and len(memory.own) > own:
            fields["memory"], further = split_memory(memory, own)
            self._class_sensors.store(group, member, further, self.one_world(), self._instance)
        super().edit(robot, **fields)

    def _store_readings(self) -> None:
        """Store the last readings: for the reports of clients' robots, and as the latest of the others."""
        for slot, robot in self.present.items():
            group, member = self.scene.group_of(slot)
            for sensor, reading in enumerate(self.policy_batch.readings[group]):
                if reading.fresh[self._instance, member]:
                    value = np.asarray(reading.value[self._instance, member])
                    if slot in self.robots:
                        store_reading(self, robot, sensor, value)
                    else:
                        robot.latest[sensor] = self.time, value

    @property
    def score(self) -> float:
        """The task's score of the served world so far."""
        return self.policy_batch.score(self._instance)

    @property
    def time_left(self) -> float:
        """Time until the episode ends at the latest [s]."""
        return self.policy_batch.time_left(self._instance)

    @property
    def maps(self) -> TeamMaps | None:
        """The maps that the task's robots are building; None without maps."""
        return self.policy_batch.maps(self._instance)

    def agents(self) -> dict[str, int]:
        """Return the names of the task's robots, and their slots."""
        named = enumerate(self.scene.roster)
        return {entry.name or f"{entry.spec.name}{slot}": slot for slot, entry in named}

    def spawn_at(self, robot: RobotSpec, name: str, poses: Sequence[tuple[Vec3, Vec3]]) -> Robot:
        """Take over the robot of that name as it stands, or activate the first free one of its class."""
        pos, angles = poses[0]
        self.check_position(pos)
        slots = {agent.lower(): slot for agent, slot in self.agents().items()}
        slot = slots.get(name.lower())
        new = (
            self._put_first(robot, name, pos, angles) if slot is None else self._take_over(slot, robot, name)
        )
        # Before the next action, which would replace the client's command by the policy's.
        self.policy_batch.claimed[self._instance, new.slot] = True
        group, member = self.scene.group_of(new.slot)
        if self._class_sensors.has(group):
            self._class_sensors.restart(group, member, self.one_world(), self._instance)
        # Sensors are read once per action: the first report comes right after a reading, not before.
        new.spawn_time = self.policy_batch.measured * self.period
        return new

    def _put_first(self, robot: RobotSpec, name: str, pos: Vec3, angles: Vec3) -> Robot:
        for group in self.scene.groups:
            free = [int(slot) for slot in group.slots if int(slot) not in self.robots]
            if group.robot.name == robot.name and free:
                new = self._activate(free[0], robot, name, pos, angles)
                # The scene's own sensors come first in it, as in the readings; the suite of the class has
                # another order.
                new.suite = self._robot(new.slot, name).suite
                return new
        raise UsageError(f"no {robot.name} left to take over; the robots here: {', '.join(self.agents())}")

    def _take_over(self, slot: int, robot: RobotSpec, name: str) -> Robot:
        number, _ = self.scene.group_of(slot)
        group = self.scene.groups[number]
        if group.robot.name != robot.name or slot in self.robots:
            what = "taken" if slot in self.robots else f"a {group.robot.name}, not a {robot.name}"
            raise UsageError(f"{name} is {what}")
        # With an idle command: that of the policy would go on until the client drives.
        new = self.robots[slot] = self._robot(slot, name)
        self.set_command(new, new.command)
        return new

    def _is_taken(self, instance: int, slot: int) -> bool:
        # All robots of a task are active: a claim alone tells that a client has one.
        return bool(self.policy_batch.claimed[instance, slot])

    def _join_world(self, robot: Robot, state: RobotState) -> None:
        """Take over the robot with the same slot in this world, at its present pose."""
        # Readings of the world before must not be reported as this one's.
        robot.pending.clear()
        self.robots[robot.slot] = robot
        # The policy's last command is still in force; the robot stands until its client drives.
        self.set_command(robot, jax.tree.map(np.array, idle_command(robot.spec)))
        self.policy_batch.claimed[self._instance, robot.slot] = True

    def _restart_robot(self, robot: Robot) -> None:
        """Leave a client's robot at the new episode's pose; the task begins with the next action."""
        robot.restart(jax.tree.map(np.array, idle_command(robot.spec)))
        self.set_command(robot, robot.command)

    def remove(self, robot: Robot) -> None:
        """Return the robot to the policy; it stands still until the next action."""
        if self.robots.get(robot.slot) is robot:
            # The client's last command would drive on until the next action.
            self.set_command(robot, jax.tree.map(np.array, idle_command(robot.spec)))
            del self.robots[robot.slot]
            self.policy_batch.claimed[self._instance, robot.slot] = False

    def _drop(self, robot: Robot) -> None:
        super()._drop(robot)
        self.policy_batch.claimed[self._instance, robot.slot] = False

    def step(self) -> None:
        """Advance all worlds by one control step; at the end of each action the policy acts."""
        super().step()
        # After other steps the last readings are still the same, and would be reported twice.
        if self.policy_batch.measured == self._steps:
            self._store_readings()

    def observe(self, due: list[Robot]) -> None:
        """Read the sensors that the task leaves out; what it reads is pending since the last action."""
        for robot in due:
            group, member = self.scene.group_of(robot.slot)
            robot.drowned = bool(self._state.worlds.groups[group].drowned[self._instance, member])
        for group in {self.scene.group_of(robot.slot)[0] for robot in due}:
            if self._class_sensors.has(group):
                self._read_further(group)

    def _read_further(self, group: int) -> None:
        """Read and store the sensors that the task leaves out, of the clients' robots of a group."""
        readings = self._class_sensors.read(group, self.one_world(), self._traced_world(), self._instance)
        first = len(self.scene.groups[group].suite.sensors)
        for robot in self.robots.values():
            number, member = self.scene.group_of(robot.slot)
            for sensor, reading in enumerate(readings, first) if number == group else ():
                if reading.fresh[member]:  # a recording has the scene's sensors alone
                    robot.pending[sensor] = value = np.asarray(reading.value[member])
                    robot.latest[sensor] = self.time, value


def newest(run: Path) -> str | None:
    """Return the name of a run's newest checkpoint; None without one."""
    try:
        return Checkpoints(run).find("last").name
    except UsageError:
        # A run that has just begun has no checkpoint yet.
        return None


def wait_for_run(run: Path, interval: float = INTERVAL) -> PolicySource:
    """Return the policy of a run's newest checkpoint, as soon as there is one.

    Raises:
        UsageError: A checkpoint cannot be read, and remains the newest.
    """
    while True:
        found = newest(run)
        try:
            if found is not None:
                return load_policy(str(run), "last")
        except UsageError:
            if newest(run) == found:  # otherwise training has replaced it by a newer one meanwhile
                raise
        time.sleep(interval)


class PolicyFollower:
    """Drives a served batch by the newest checkpoint of a run; a `gamebots.server.Service`.

    It reads and compiles the policy in a thread; the world goes on meanwhile.

    Args:
        shared: The batch.
        run: Folder of the run.
        interval: Interval between two looks into the folder [s].
    """

    def __init__(self, shared: PolicyBatch, run: Path, interval: float = INTERVAL) -> None:
        self._shared, self._run, self._interval = shared, run, interval
        self._driving = newest(run)
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> list[str]:
        """Begin to watch the folder."""
        self._task = asyncio.create_task(self._watch())
        return [f"the newest checkpoint of {self._run} drives"]

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(self._interval)
            found = newest(self._run)
            # Without a checkpoint, as in a folder that is being replaced, the present policy drives on.
            if found not in (None, self._driving):
                await self._take(found)

    async def _take(self, name: str | None) -> None:
        try:
            # Reading and compiling take seconds, in which the loop must step on.
            await asyncio.to_thread(self._load)
        except (UsageError, OSError) as error:  # training may have replaced it by a newer one
            # It does not count as driving: the next look tries it again, or a newer one.
            log.warning("%s: %s", self._run, error)
            return
        self._driving = name
        log.info("checkpoint %s drives", name)

    def _load(self) -> None:
        self._shared.use_policy(load_policy(str(self._run), "last").policy(self._shared.env))

    def tick(self) -> None:
        """Do nothing."""

    def stop(self) -> None:
        """Stop watching."""
        if self._task is not None:
            self._task.cancel()
