"""A served world on C MuJoCo: robots of any class are added and removed while it runs."""

import logging
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.process import return_freed_memory
from usarmjx.base.transforms import Vec3, quat_from_angles
from usarmjx.engines import PhysicsState
from usarmjx.models.compile.physics import Physics
from usarmjx.models.effecters import Opcode, Vacuum
from usarmjx.models.types.arena import ArenaSpec, LooseObject
from usarmjx.models.types.robot import RobotSpec
from usarmjx.recording.inputs import WorldSetup
from usarmjx.sensors.cameras.picture import Picture
from usarmjx.sensors.cameras.programs import PicturePrograms
from usarmjx.sensors.suite import suite_of
from usarmjx.server.protocol.reports import STATUS_OK
from usarmjx.server.worlds.met_objects import MetObject, ObjectNames, met_objects
from usarmjx.server.worlds.recorded import record_step, single_setup, store_reading
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import CameraRequest, ServedWorld, ViewpointRequest, status_of
from usarmjx.sim.configure import update_robot_spec
from usarmjx.sim.control import RobotCommand, idle_command
from usarmjx.sim.scene import Scene, build_scene
from usarmjx.sim.single_world import SingleWorld
from usarmjx.sim.world import GroupState, World

log = logging.getLogger(__name__)

MAX_NAMES = 5
"""Number of kept names of the last recovered robots and objects."""


class DynamicWorld(ServedWorld):
    """One world on C MuJoCo.

    Args:
        arena: The arena.
        physics: Solver and time settings; None: the reference.
        seed: Seed of all random numbers.
        number: Number of the corresponding world of a batch with that seed.
        max_robots: Most robots at once.

    Attributes:
        programs: Compiled programs that render pictures; None without an accelerator: there they take more
            processor time than C MuJoCo's rays do, and tens of seconds before the first picture.
    """

    def __init__(
        self,
        arena: ArenaSpec,
        physics: Physics | None = None,
        seed: int = 0,
        *,
        number: int = 0,
        max_robots: int = 16,
    ) -> None:
        scene = build_scene(arena, (), physics)
        self._single = SingleWorld(scene, seed, number, max_robots)
        self._origin = seed, number, max_robots
        self._began = 0
        self.arena, self.period, self.robots = scene.arena, scene.physics.period, {}
        self.programs = None if jax.default_backend() == "cpu" else PicturePrograms()

    def setup(self) -> WorldSetup:
        """Return the world's inputs at its beginning."""
        return single_setup(self, self._origin)

    @property
    def scene(self) -> Scene:
        """The scene with the present robots."""
        return self._single.scene

    @property
    def steps(self) -> int:
        """Control steps since the world began."""
        return self._began + self._single.steps

    def one_world(self) -> tuple[World, PhysicsState]:
        """Return the world and its physics as they are now."""
        return self._single.world, self._single.physics

    def beside_physics(self) -> World:
        """Return the world as it is now, without its physics."""
        return self._single.world

    def edit(self, robot: Robot, **fields: Any) -> None:  # noqa: ANN401 - PyTrees of one robot
        """Replace fields of the robot's state."""
        self._single.edit(robot.slot, **fields)

    def set_command(self, robot: Robot, command: RobotCommand) -> None:
        """Replace the robot's command."""
        # The world's step counter begins at 0 again after a reset, while the clients' time goes on.
        robot.command = command
        self.edit(robot, command=command.replace(flip_until=command.flip_until - self._began))

    def reset(self) -> None:
        """Return robots to their spawn poses and all else to its beginning, with full batteries."""
        if self.recorder is not None:
            self.recorder.reset()
        # Before the reset, which sets the count of the single world to 0: the clients' time goes on.
        self._began = self.steps
        self._single.reset()
        for slot, robot in self.robots.items():
            robot.restart(self._single.state_of(slot).command)
        self.forget()

    def spawn_at(self, robot: RobotSpec, name: str, poses: Sequence[tuple[Vec3, Vec3]]) -> Robot:
        """Add a robot to the running world; the states of the others are kept bit for bit."""
        # All of them first: a refusal must come before anything is recorded or added.
        for pos, _ in poses:
            self.check_position(pos)
        self.prepare(robot)
        asked = [(pos, quat_from_angles(*angles)) for pos, angles in poses]
        # Before it is added, so that a replay adds it in front of the step that it takes part in.
        if self.recorder is not None:
            self.recorder.adding(robot, name, asked)
        slot = self._single.add(robot, name, asked)
        if self.recorder is not None:
            self.recorder.joined(slot, name, robot.name)
        with numpy_backend():
            command = idle_command(robot)
        new = Robot(slot=slot, name=name, suite=suite_of(robot), command=command, spawn_time=self.time)
        self.robots[slot] = new
        pos = self.state(new).pos
        if not any(np.allclose(pos, wanted, atol=1e-3) for wanted, _ in poses):
            # No pose had room, and the world took a free place near the first one.
            new.refused = poses[0][0]
        return new

    def update_robot_spec(self, robot: Robot, spec: RobotSpec) -> None:
        """Replace the description of a robot while it runs; the states of all are kept."""
        self.prepare(spec)
        update_robot_spec(self._single, robot.slot, spec)
        if self.recorder is not None:
            self.recorder.redescribed(robot.slot, spec)
        robot.suite = suite_of(spec)

    def remove(self, robot: Robot) -> None:
        """Remove a robot from the running world."""
        # The slot may have another robot by now.
        if self.robots.get(robot.slot) is robot:
            del self.robots[robot.slot]
            if self.recorder is not None:
                self.recorder.removed(robot.slot, robot.name)
            self._single.remove(robot.slot)
            # Models of several megabytes are replaced with each robot; the C library keeps what it frees.
            return_freed_memory()

    def move_robot(self, robot: Robot, pos: Vec3, quat: np.ndarray) -> None:
        """Put a robot at a pose, at rest."""
        self._single.move_robot(robot.slot, pos, quat)
        if self.recorder is not None:
            self.recorder.placed(robot.slot, np.array(pos), quat)

    def set_stiffness(self, robot: Robot, joint: int, share: float) -> None:
        """Set how stiff a joint's servo is."""
        self._single.set_stiffness(robot.slot, joint, share)

    def move_loose(self, index: int, pos: Vec3, quat: np.ndarray) -> None:
        """Put a loose object at a pose, at rest."""
        self._single.move_loose(index, pos, quat)
        if self.recorder is not None:
            self.recorder.placed_loose(index, np.array(pos), quat)

    def add_loose(self, thing: LooseObject, *, held: bool) -> None:
        """Add a loose object."""
        # Before it is added, as of robots: see `spawn_at`.
        if self.recorder is not None:
            self.recorder.adding_loose(thing, held=held)
        self._single.add_loose(thing, held=held)

    def remove_loose(self, index: int) -> None:
        """Remove a loose object."""
        self._single.remove_loose(index)
        if self.recorder is not None:
            self.recorder.removed_loose(index)

    def set_conveyors(self, name: str, share: float) -> None:
        """Set the speed of the arena's conveyors of a name, as a share of their own."""
        self._single.set_conveyors(share, name)
        if self.recorder is not None:
            self.recorder.set_conveyors(name, share)

    def step(self) -> None:
        """Advance by one control step; robots that diverge return to their spawn poses."""
        # Before the orders are recorded: moves are inputs of the step, too.
        self.advance_objects()
        if self.recorder is not None:
            self.recorder.record_orders(self.scene, [_orders(one) for one in self._single.world.groups])
        put_back = self._single.step()
        # With all digits: C MuJoCo computes in double precision, and a replay compares bits.
        record_step(self, self._single.engine.data)
        if put_back:
            self.recovery_log.put_back += len(put_back.robots) + len(put_back.others)
            names = [self.robots[slot].name for slot in sorted(put_back.robots)]
            self.recovery_log.names = (*self.recovery_log.names, *names, *put_back.others)[-MAX_NAMES:]
            log.error("the physics of %s went bad: put back", ", ".join([*names, *put_back.others]))
            if self.recorder is not None:
                self.recorder.event("put back", f"{', '.join([*names, *put_back.others])}: put back")
        # A robot that was put back has lost its command, of which its client knows nothing.
        for slot in put_back.robots:
            self.robots[slot].command = self._single.state_of(slot).command

    def observe(self, due: list[Robot]) -> None:
        """Read the sensors of the robots that are about to report."""
        readings, time = self._single.observe(robot.slot for robot in due), self.time
        for robot in due:
            group, member = self.scene.group_of(robot.slot)
            robot.drowned = bool(self._single.world.groups[group].drowned[member])
            for sensor, reading in enumerate(readings[robot.slot]):
                if reading.fresh:
                    store_reading(self, robot, sensor, np.asarray(reading.value), time)

    def met_objects(self, robot: Robot, sensor: int) -> list[MetObject]:
        """Return the objects that the beams of a robot's scanner meet."""
        single, robots = self._single, {slot: one.name for slot, one in self.robots.items()}
        names = ObjectNames(robots, single.robots, self.arena, np.asarray(self.scene.victims.owner))
        return met_objects(single.engine, single.met_geoms(robot.slot, sensor), names)

    def operate(self, robot: Robot, effecter: int, opcode: Opcode, value: float) -> str:
        """Carry out a SET command on an effecter."""
        # A vacuum holds what it touches in C MuJoCo's world, beside the state that operations change.
        if isinstance(robot.effecters[effecter], Vacuum):
            return self._suck(robot, effecter, closes=Vacuum.closes(opcode, value))
        outcome = self._single.operate(robot.slot, effecter, opcode, value)
        command = self._single.state_of(robot.slot).command
        # The world's own time counts from its last reset, the robot's from the beginning: see `set_command`.
        robot.command = command.replace(flip_until=robot.command.flip_until)
        return status_of(outcome)

    def _suck(self, robot: Robot, effecter: int, *, closes: bool) -> str:
        if self.recorder is not None:
            self.recorder.set_vacuum(robot.slot, effecter, closes=closes)
        self._single.suck(robot.slot, effecter, closes=closes)
        return STATUS_OK

    def sucks(self, robot: Robot, effecter: int) -> bool:
        """Return whether a robot's vacuum is closed."""
        return self._single.sucks(robot.slot, effecter)

    def snapshot(self, requests: Sequence[CameraRequest | ViewpointRequest]) -> Callable[[], list[Picture]]:
        """Take a snapshot of the world for pictures; return a function that renders them.

        It renders on NumPy, with the rays of C MuJoCo, unless there is an accelerator with a finished
        program.
        """
        scene = self._single.render_scene()
        views = [(self.viewpoint(request), request.width, request.height) for request in requests]
        compiled = None if self.programs is None else self.programs.find(scene, views)
        if compiled is not None:
            return compiled
        sight = self._single.sight()
        return lambda: [sight.render(scene, *view) for view in views]


def _orders(state: GroupState) -> dict[str, Any]:
    """Return the fields of robots' states that clients set between control steps, to be recorded."""
    soft = {} if state.stiffness is None else {"stiffness": state.stiffness}
    return {"command": state.command, **soft}
