"""Conditions of a drive: the settings of the physics and the engine, which make tracks."""

from dataclasses import dataclass, replace
from functools import lru_cache

import jax
import numpy as np

from benchmarks.fidelity.track import Ground, Order, Track
from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import EngineError
from usarmjx.models.compile.compose import LOOSE_PREFIX
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.standing import stance_of
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.batch import Batch, put_robot
from usarmjx.sim.calibration import ensure_calibrated
from usarmjx.sim.control import CommandUpdate, idle_command, set_drive, update_command
from usarmjx.sim.scene import build_scene
from usarmjx.sim.single_world import SingleWorld

REFERENCE = Physics()
OPEN = Ground()
"""A floor with one robot."""


@dataclass(frozen=True)
class Conditions:
    """Settings of the physics, and the engine that applies them.

    Attributes:
        physics: The settings.
        engine: Name of the engine. `c` drives a single world, as served ones are, others a batch of one.
    """

    physics: Physics = REFERENCE
    engine: str = "c"

    def track(self, robot: RobotSpec, ground: Ground = OPEN) -> Track:
        """Return a world with robots of a class on a piece of ground.

        Raises:
            UnknownNameError: No such engine.
            UnsupportedFeatureError: The engine cannot move such robots there.
        """
        if self.engine == "c":
            return SingleTrack(self.physics, robot, ground)
        return BatchTrack(self, robot, ground)


class SingleTrack(Track):
    """A single world of engine `c`.

    Args:
        physics: The settings.
        robot: The class.
        ground: The ground, and where robots are on it.

    Attributes:
        world: The world.
    """

    def __init__(self, physics: Physics, robot: RobotSpec, ground: Ground = OPEN) -> None:
        super().__init__(robot, physics.period)
        self.world = SingleWorld(build_scene(ground.arena(robot), [], physics), seats=len(ground.poses))
        stance = stance_of(robot)
        for i, (pos, quat) in enumerate(ground.places(stance.height)):
            slot = self.world.add(robot, f"robot{i}", [(pos, quat)])
            group, member = self.world.scene.group_of(slot)
            index = self.world.scene.groups[group].indices[member]
            # The world raises and moves what has no room, as wheels that stand on a slope: back to the place.
            self.world.engine.place(index, np.array(pos), stance.tilted(quat))

    def tell(self, order: Order, slot: int = 0) -> None:
        """Give a robot an order."""
        with numpy_backend():
            values = {key: np.array(value, np.float32) for key, value in order.items()}
            self.world.edit(slot, command=set_drive(self.robot, idle_command(self.robot), values))

    def move(self, targets: Order) -> None:
        """Tell joints of the first robot where to go [rad]."""
        with numpy_backend():
            plan = self.world.scene.groups[0].plan
            angles = {joint: np.array(angle, np.float32) for joint, angle in targets.items()}
            told = update_command(plan, self.world.state_of(0).command, CommandUpdate(joints=angles))
            self.world.edit(0, command=told)

    def advance(self, steps: int) -> None:
        """Let some control steps pass.

        Raises:
            EngineError: The physics went bad.
        """
        for _ in range(steps):
            if self.world.step():
                raise EngineError(f"the physics of {self.robot.name} went bad at {self.world.time:.2f} s")

    def root(self, slot: int = 0) -> np.ndarray:
        """Return position [m] and orientation of a robot (7,)."""
        group, member = self.world.scene.group_of(slot)
        return self.world.engine.pose(self.world.scene.groups[group].indices[member])

    def thing(self) -> np.ndarray:
        """Return where the first thing that lies there is now [m] (3,)."""
        name = f"{LOOSE_PREFIX}{self.world.scene.arena.loose[0].name}"
        return self.world.engine.data.xpos[self.world.engine.model.body(name).id].copy()

    def body(self, part: str) -> int:
        """Return the body of a part of the first robot."""
        group = self.world.scene.groups[0]
        return int(group.indices[0].body_ids[group.plan.parts.index(part)])


@lru_cache(maxsize=1)
def _batch(physics: Physics, engine: str, robot: RobotSpec, arena: ArenaSpec, robots: int) -> Batch:
    """Return a batch of one world; several manoeuvres in a row may share it, and what JAX compiles for it."""
    scene = build_scene(arena, [robot] * robots, physics)
    if engine == "planar":
        ensure_calibrated(scene)
    return Batch(scene, engine=engine)


class BatchTrack(Track):
    """A batch of one world of any engine, its robots without sensors and cameras.

    Args:
        conditions: The settings and the engine.
        robot: The class.
        ground: The ground, and where robots are on it.
    """

    def __init__(self, conditions: Conditions, robot: RobotSpec, ground: Ground = OPEN) -> None:
        super().__init__(robot, conditions.physics.period)
        blind = replace(robot, sensors=(), cameras=())
        stance = stance_of(robot)
        arena, places = ground.arena(robot), ground.places(stance.height)
        self._batch = _batch(conditions.physics, conditions.engine, blind, arena, len(places))
        self._state = self._batch.reset()
        for slot, (pos, quat) in enumerate(places):
            args = np.array(pos, np.float32), stance.tilted(quat)
            self._state = put_robot(self._batch, self._state, 0, slot, *args)

    def tell(self, order: Order, slot: int = 0) -> None:
        """Give a robot an order."""
        group, member = self._batch.scene.group_of(slot)
        members = self._state.worlds.groups[group]
        with numpy_backend():
            values = {key: np.array(value, np.float32) for key, value in order.items()}
            own = set_drive(self.robot, idle_command(self.robot), values)
        told = jax.tree.map(lambda rows, row: rows.at[0, member].set(row), members.command, own)
        self._state = self._batch.with_group(self._state, group, members.replace(command=told))

    def move(self, targets: Order) -> None:
        """Tell joints of the first robot where to go [rad]."""
        self._state = self._batch.move(self._state, 0, targets)

    def advance(self, steps: int) -> None:
        """Let some control steps pass.

        Raises:
            EngineError: The physics went bad.
        """
        for _ in range(steps):
            self._state = self._batch.step(self._state)
        if int(self._state.worlds.faults.not_finite[0]) or int(self._state.worlds.faults.runaway[0]):
            raise EngineError(f"the physics of {self.robot.name} went bad")

    def _qpos(self) -> np.ndarray:
        return np.asarray(self._batch.physics(self._state).qpos)[0]

    def root(self, slot: int = 0) -> np.ndarray:
        """Return position [m] and orientation of a robot (7,)."""
        group, member = self._batch.scene.group_of(slot)
        return self._qpos()[self._batch.scene.groups[group].root_qposadr[member]].astype(float)

    def thing(self) -> np.ndarray:
        """Return where the first thing that lies there is now [m] (3,)."""
        return self._qpos()[self._batch.scene.loose_geoms.root_qposadr[0]][:3]
