"""One served world as the adapter sees it: robots come and go, take commands and report.

Three worlds implement it: `dynamic_world.DynamicWorld` (a `sim.single_world.SingleWorld`: any class at any
time), `batch_world.BatchWorld` (one world of a running `sim.batch.Batch`, where robots wait parked) and
`policy_world.PolicyWorld` (the same with a policy driving the robots that nobody has claimed). What is here
calls the simulator's pure functions on NumPy, of whichever world.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsageError
from usarmjx.base.transforms import Vec3
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.links import Links, no_links
from usarmjx.comms.walls import count_walls
from usarmjx.engines import PhysicsState
from usarmjx.models.compile.kinematic_tree import BodyPoses, forward_kinematics, robot_state
from usarmjx.models.drives.base import RobotState
from usarmjx.models.effecters import Opcode, effecters_of
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.robot import RobotSpec
from usarmjx.recording.inputs import WorldSetup
from usarmjx.recording.recorder import WorldRecorder
from usarmjx.sensors.base import SensorInput
from usarmjx.sensors.cameras.mounts import cameras_of
from usarmjx.sensors.cameras.picture import Picture, Viewpoint, camera_viewpoint
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.sensors.suite import SensorMemory, suite_of
from usarmjx.server.gamebots.victims import initial_tag_texts
from usarmjx.server.protocol.reports import STATUS_FAILED, STATUS_OK
from usarmjx.server.protocol.viewports import MultiView, ViewBindings
from usarmjx.server.worlds.robot import Robot, Traces
from usarmjx.sim.control import CommandUpdate, RobotCommand, update_command
from usarmjx.sim.operate import NO_NUMBER, OperationResult
from usarmjx.sim.radio import radio_obstacles, update_links
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import World, sense_self


@dataclass
class RecoveryLog:
    """What has happened to a world's physics so far.

    Attributes:
        put_back: Robots and objects that went bad and were put back.
        resets: How often the whole world was reset for that.
        names: What was put back last.
    """

    put_back: int = 0
    resets: int = 0
    names: tuple[str, ...] = ()


ROBOT_FIELDS = ("state", "bodies", "hits")
"""What of a group's `SensorInput` has a leading axis over robots."""
MAX_COORDINATE = 1000.0
"""Nobody spawns further from the origin than this [m]: single precision gets coarse there."""


@dataclass(frozen=True)
class CameraRequest:
    """A picture to render.

    Attributes:
        robot: Whose camera.
        camera: Index of the camera among `robot.cameras`.
        width: [pixels]
        height: [pixels]
    """

    robot: Robot
    camera: int
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class ViewpointRequest:
    """A picture to render from where no robot's camera need be.

    Attributes:
        viewpoint: From where; numpy arrays.
        width: [pixels]
        height: [pixels]
    """

    viewpoint: Viewpoint
    width: int
    height: int


def status_of(outcome: OperationResult) -> str:
    """Return the Status of RES for one robot's operation (manual 11)."""
    if not outcome.done:
        return STATUS_FAILED
    return STATUS_OK if outcome.number == NO_NUMBER else str(int(outcome.number))


class ServedWorld(ABC):
    """A world that clients share. Positions and angles are in our axes.

    A subclass sets the attributes in its constructor and implements what is abstract here: robots that come
    and go (`spawn`, `remove`: both keep `robots`), the step, sensors that are read into `Robot.pending`, the
    present state, changes of a robot's state, operations, and pictures. What takes long before it can be done
    the first time goes into `warm_up`, if it needs no robot class, and into `prepare`.
    All is called by one thread, the server's loop, except `prepare` and what `snapshot` returns.

    Attributes:
        scene: The scene; one of C MuJoCo is another whenever a robot joins or leaves.
        arena: Where it is.
        period: Length of a control step [s].
        robots: The clients' robots, by slot.
        multi_view: How all robots' cameras share a picture, if they do.
        recorder: What keeps all that happens; None: nothing does.
    """

    scene: Scene
    arena: ArenaSpec
    period: float
    robots: dict[int, Robot]
    multi_view: MultiView | None = None
    recorder: WorldRecorder | None = None

    @cached_property
    def view_bindings(self) -> ViewBindings:
        """Whose view is bound to which camera."""
        return ViewBindings()

    @cached_property
    def traces(self) -> Traces:
        """The points that robots have left behind."""
        return Traces()

    @cached_property
    def tag_texts(self) -> dict[int, str]:
        """What is written on RFID tags, by ID; the others are empty."""
        return initial_tag_texts(self.arena)

    @cached_property
    def mishaps(self) -> RecoveryLog:
        """How often its physics went bad."""
        return RecoveryLog()

    @property
    @abstractmethod
    def time(self) -> float:
        """Simulated time since the world began [s]."""

    def warm_up(self) -> None:  # noqa: B027 - nothing to compile is fine
        """Compile what the first client would else wait for, before any comes; the world stays as it is."""

    def prepare(self, robot: RobotSpec) -> None:
        """Do what takes long before the first robot of a class can appear; may run in a thread.

        Raises:
            UsageError: No robot can be built of that class.
        """
        for resolve in (suite_of, cameras_of, effecters_of):
            resolve(robot)

    def spawn(self, robot: RobotSpec, name: str, pos: Vec3, angles: Vec3) -> Robot:
        """Put a robot of that class there; see `spawn_at`."""
        return self.spawn_at(robot, name, [(pos, angles)])

    @abstractmethod
    def spawn_at(self, robot: RobotSpec, name: str, poses: Sequence[tuple[Vec3, Vec3]]) -> Robot:
        """Put a robot of that class where there is room for it.

        Args:
            robot: Its class.
            name: Its name.
            poses: Positions [m] and angles (roll, pitch, yaw) [rad] to choose from, the best first; where
                robots are only put where they are told to be, the first is taken.

        Raises:
            UsageError: There is no room for it, or the position is out of reach.
        """

    def starts_for(self, robot: RobotSpec) -> list[StartPose]:
        """Return the arena's start poses, those that another robot stands near last.

        Near is half of both robots' lengths or widths, whichever are longer.
        """
        own = max(robot.dimensions[:2])
        places = [
            (self.state(other).pos[:2].tolist(), (max(other.spec.dimensions[:2]) + own) / 2)
            for other in self.robots.values()
        ]

        def is_taken(start: StartPose) -> bool:
            return any(math.dist(start.at[:2], place) <= apart for place, apart in places)

        return sorted(self.arena.starts, key=is_taken)

    @property
    def present(self) -> dict[int, Robot]:
        """All robots of the world, by slot: the clients', and those that a policy drives."""
        return self.robots

    def agents(self) -> dict[str, int]:
        """Return the names and slots of the robots that a policy drives unless somebody takes them over."""
        return {}

    @abstractmethod
    def remove(self, robot: Robot) -> None:
        """Take the robot out of the world."""

    def battery(self, robot: Robot) -> float:
        """Return for how long the robot's battery lasts yet [s]; 0 when water has killed it."""
        if robot.drowned:
            return 0.0
        group, member = self.scene.group_of(robot.slot)
        world, _ = self.one_world()
        age = int(world.step) * self.period - float(world.groups[group].battery_start[member])
        return max(0.0, robot.spec.battery_life - age)

    def forget(self) -> None:
        """Forget what robots have left behind: traces, and texts on tags."""
        self.traces.clear()
        self.tag_texts.clear()
        self.tag_texts.update(initial_tag_texts(self.arena))

    def free_tile(self, robot: RobotSpec) -> int:
        """Return the tile of the MultiView that a new robot of a class gets; -1 when there is none."""
        if self.multi_view is None or not robot.cameras:
            return -1
        taken = {other.tile for other in self.robots.values()}
        return next((n for n in range(self.multi_view.camera_num) if n not in taken), -1)

    def zoom(self, robot: Robot, camera: int, fov: float) -> bool:
        """Set a camera's field of view: 0 for its default, and never beyond its limits (manual 9.4).

        Args:
            robot: The robot.
            camera: Index of the camera.
            fov: [rad]

        Returns:
            Whether it has become what was asked for; 0 and what is beyond the limits is not (KRobot.uc).
        """
        robot.fovs[camera] = float(robot.cameras[camera].clamp(np.array(fov)))
        self.edit(robot, fov=np.array(robot.fovs, np.float32))
        return abs(robot.fovs[camera] - fov) < 1e-6

    def viewpoint(self, request: CameraRequest | ViewpointRequest) -> Viewpoint:
        """Return from where a picture would be rendered now; numpy arrays."""
        if isinstance(request, ViewpointRequest):
            return request.viewpoint
        robot, camera = request.robot, request.robot.cameras[request.camera]
        slot = np.array(robot.slot, np.int32)
        fov = np.array(robot.fovs[request.camera], np.float32)
        return camera_viewpoint(camera, self.bodies(robot), slot, fov)

    @abstractmethod
    def snapshot(self, requests: Sequence[CameraRequest | ViewpointRequest]) -> Callable[[], list[Picture]]:
        """Take a snapshot of what pictures show; return a function that renders them.

        The first half is quick. The function may run in another thread, while the world goes on.
        """

    def set_command(self, robot: Robot, command: RobotCommand) -> None:
        """Replace the robot's command."""
        robot.command = command
        self.edit(robot, command=command)

    def update_command(self, robot: Robot, update: CommandUpdate) -> None:
        """Tell the robot something new.

        Raises:
            UnknownNameError: A key of DRIVE or a joint that it does not have; lists those it has.
        """
        with numpy_backend():
            self.set_command(robot, update_command(robot.plan, robot.command, update))

    def setup(self) -> WorldSetup:
        """Return what the world was made of, for who computes it again."""
        raise NotImplementedError

    @abstractmethod
    def step(self) -> None:
        """Advance by one control step."""

    def prepare_reset(self) -> None:  # noqa: B027 - nothing to compile is fine
        """Compile what `reset` needs; may run in a thread."""

    @abstractmethod
    def reset(self) -> None:
        """Put the world back to its start; clients keep their robots, and their time goes on."""

    @abstractmethod
    def observe(self, due: list[Robot]) -> None:
        """Read the sensors of the robots that are about to report; put fresh readings into `pending`."""

    @abstractmethod
    def one_world(self) -> tuple[World, PhysicsState]:
        """Return the world and its physics as they are now, without an axis over worlds; NumPy arrays."""

    @abstractmethod
    def edit(self, robot: Robot, **fields: Any) -> None:  # noqa: ANN401 - PyTrees of one robot
        """Replace fields of the robot's part of its `GroupState`."""

    def redescribe(self, robot: Robot, spec: RobotSpec) -> None:
        """Give a robot another description while it runs; see `sim.redescribe`.

        Raises:
            UsageError: The world cannot, or not so.
        """
        del spec
        raise UsageError(f"{robot.name} is compiled: only in a world of engine c do descriptions change")

    def state(self, robot: Robot) -> RobotState:
        """Return where the robot is and how it moves; numpy arrays."""
        group, member = self.scene.group_of(robot.slot)
        _, physics = self.one_world()
        return robot_state(self.scene.groups[group].indices[member], physics.qpos, physics.qvel)

    def bodies(self, robot: Robot) -> BodyPoses:
        """Return where the robot's bodies are; numpy arrays."""
        with numpy_backend():
            return forward_kinematics(robot.plan, self.state(robot))

    def memory(self, robot: Robot) -> SensorMemory:
        """Return what the robot's sensors remember; numpy arrays."""
        group, member = self.scene.group_of(robot.slot)
        return jax.tree.map(lambda x: x[member], self.one_world()[0].groups[group].memory)

    def sensor_input(self, robot: Robot) -> SensorInput:
        """Return what the robot senses of itself, no rays cast; numpy arrays."""
        group, member = self.scene.group_of(robot.slot)
        world, physics = self.one_world()
        with numpy_backend():
            alone = self.scene.groups[group].part(np.array([member]))
            inputs = sense_self(self.scene, world, physics, alone)
        own = {name: getattr(inputs, name) for name in ROBOT_FIELDS}
        return inputs.replace(**jax.tree.map(lambda x: x[0], own))

    def operate_sensor(self, robot: Robot, sensor: int, opcode: str, params: tuple[float, ...]) -> bool:
        """Carry out a SET command on a sensor; return whether it was valid."""
        inputs, memory = self.sensor_input(robot), self.memory(robot)
        with numpy_backend():
            after = robot.suite.handle_set(sensor, opcode, params, inputs, memory)
        if after is not None:
            self.edit(robot, memory=after)
        return after is not None

    def door_angles(self) -> np.ndarray:
        """Return how far the arena's doors are open now [rad] (doors,)."""
        return np.asarray(self.one_world()[1].qpos[self.scene.door_qpos])

    def links(self, radio: RadioSettings) -> Links:
        """Return the radio links as they are now, by slot; numpy arrays.

        Args:
            radio: The constants, in a world whose scene has none of its own.
        """
        world, physics = self.one_world()
        scene = self.scene if self.scene.radio is not None else replace(self.scene, radio=radio)
        with numpy_backend():
            before = no_links(scene.num_robots) if world.links is None else world.links
            return update_links(scene, world.replace(links=before), physics)

    def solids_between(self, start: Vec3, end: Vec3) -> int:
        """Return how many solids that weaken radio are between two positions [m]."""
        world, physics = self.one_world()
        with numpy_backend():
            solids = radio_obstacles(self.scene, world, physics)
            ends = (np.array([point], np.float32) for point in (start, end))
            return int(count_walls(solids, *ends)[0])

    def sketches(self) -> list[OverlayLines]:
        """Return what the robots' sensors draw into pictures; numpy arrays."""
        overlays = []
        for robot in self.robots.values():
            drawn = [index for index, sensor in enumerate(robot.suite.sensors) if sensor.has_overlay]
            own = self.memory(robot).own if drawn else ()
            overlays += [robot.suite.sensors[index].overlay(own[index]) for index in drawn]
        return jax.device_get(overlays)

    @abstractmethod
    def operate(self, robot: Robot, effecter: int, opcode: Opcode, value: float) -> str:
        """Carry out a SET command on an effecter.

        Args:
            robot: The robot.
            effecter: Index among `effecters_of` its class.
            opcode: One of the effecter's operations.
            value: Its parameter.

        Returns:
            The Status of RES (manual 11): `STATUS_OK`, `STATUS_FAILED`, or a number.
        """

    @staticmethod
    def check_position(pos: Vec3) -> None:
        """Refuse positions out of reach.

        Raises:
            UsageError: Names the position and the reach.
        """
        if not all(math.isfinite(v) and abs(v) <= MAX_COORDINATE for v in pos):
            raise UsageError(
                f"start position {pos} is out of reach: at most {MAX_COORDINATE} m from the origin"
            )
