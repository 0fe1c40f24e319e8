"""Sensors of robots' classes that a task leaves out: read for the clients that take robots over."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.program_cache import compile_program
from usarmjx.engines import PhysicsState
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.base import Reading
from usarmjx.sensors.suite import SensorMemory, Suite, suite_of
from usarmjx.sim.reset import new_group_state, start_sensors
from usarmjx.sim.scene import RobotGroup, Scene
from usarmjx.sim.world import World, observe


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
        if kept is None or kept.episode != episode:
            kept = self._memories[group] = _Memories(episode, self.start(group, *now))
        return kept


def suite_memory(robots: int) -> SensorMemory:
    """Return the memory of robots without sensors (robots, 0)."""
    none = np.zeros((robots, 0), np.int32)
    return SensorMemory(due=none, lead=none, armed=none.astype(bool), own=(), last=())


def _further(group: RobotGroup, robot: RobotSpec | None) -> RobotGroup:
    """Return a group with the sensors of its class that it lacks, and no others."""
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
