"""One served world as the adapter sees it: robots come and go, take commands and report.

Three worlds implement it: `dynamic_world.DynamicWorld` (a `sim.single_world.SingleWorld`: any class at any
time), `batch_world.BatchWorld` (one world of a running `sim.batch.Batch`, where robots wait parked) and
`policy_world.PolicyWorld` (the same with a policy driving the robots that no client has claimed). The shared
methods call the simulator's pure functions on NumPy.
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
from usarmjx.base.errors import PlaceError, UsageError
from usarmjx.base.transforms import Vec3
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.links import Links, no_links
from usarmjx.comms.walls import count_walls
from usarmjx.engines import PhysicsState
from usarmjx.models.compile.kinematic_tree import BodyPoses, forward_kinematics, robot_state
from usarmjx.models.drives.base import RobotState
from usarmjx.models.effecters import Opcode, effecters_of
from usarmjx.models.types.arena import ArenaSpec, LooseObject, StartPose
from usarmjx.models.types.robot import RobotSpec
from usarmjx.recording.inputs import WorldSetup
from usarmjx.recording.recorder import WorldRecorder
from usarmjx.sensors.base import SensorInput
from usarmjx.sensors.cameras.mounts import cameras_of
from usarmjx.sensors.cameras.picture import Picture, Viewpoint, camera_viewpoint
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.sensors.suite import SensorMemory, suite_of
from usarmjx.server.gamebots.victims import initial_tag_texts
from usarmjx.server.gamebots.world_objects import CreatedObject
from usarmjx.server.protocol.reports import STATUS_FAILED, STATUS_OK
from usarmjx.server.protocol.viewports import MultiView, ViewBindings
from usarmjx.server.worlds.met_objects import MetObject
from usarmjx.server.worlds.object_motion import ObjectMotion
from usarmjx.server.worlds.robot import Robot, Traces
from usarmjx.sim.control import CommandUpdate, RobotCommand, update_command
from usarmjx.sim.operate import NO_NUMBER, OperationResult
from usarmjx.sim.radio import radio_obstacles, update_links
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import World, sense_self

ROBOT_FIELDS = ("state", "bodies", "hits")
"""Fields of a group's `SensorInput` with a leading axis over robots."""
MAX_COORDINATE = 1000.0
"""Largest coordinate of a spawn pose [m]: single precision gets coarse beyond it."""


@dataclass
class RecoveryLog:
    """Recoveries of a world's physics so far.

    Attributes:
        put_back: Robots and objects that diverged and were returned to their initial poses.
        resets: Number of resets of the whole world for that reason.
        names: Names of the last recovered robots and objects.
    """

    put_back: int = 0
    resets: int = 0
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class CameraRequest:
    """Picture of a robot's camera to render.

    Attributes:
        robot: Robot with the camera.
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
    """Picture of a free viewpoint to render.

    Attributes:
        viewpoint: The viewpoint; NumPy arrays.
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

    A subclass sets the attributes in its constructor and implements the abstract methods: robots that come
    and go (`spawn`, `remove`: both keep `robots`), the step, sensors that are read into `Robot.pending`, the
    present state, changes of a robot's state, operations, and pictures. Compilation before the first use
    goes into `warm_up`, if it needs no robot class, and into `prepare`.
    One thread calls all methods, the server's loop, except `prepare` and the result of `snapshot`.

    Attributes:
        arena: The arena.
        period: Length of a control step [s].
        robots: The clients' robots, by slot.
        multi_view: Division of a picture among all robots' cameras, if they share one.
        recorder: Recorder of the world; None: it is not recorded.
    """

    arena: ArenaSpec
    period: float
    robots: dict[int, Robot]
    multi_view: MultiView | None = None
    recorder: WorldRecorder | None = None

    @property
    @abstractmethod
    def scene(self) -> Scene:
        """The scene; on C MuJoCo it is replaced whenever a robot joins or leaves."""

    # Made at its first use, as the next ones are: this class has no constructor that subclasses must call.
    @cached_property
    def view_bindings(self) -> ViewBindings:
        """Cameras that the views of image clients are bound to."""
        return ViewBindings()

    @cached_property
    def traces(self) -> Traces:
        """Points of the robots' traces."""
        return Traces()

    @cached_property
    def tag_texts(self) -> dict[int, str]:
        """Memory of RFID tags, by ID; tags that are absent are empty."""
        return initial_tag_texts(self.arena)

    @cached_property
    def created(self) -> dict[str, CreatedObject]:
        """Objects that world controllers have created, by name in lower case."""
        return {}

    @cached_property
    def motions(self) -> dict[str, ObjectMotion]:
        """Motions of loose objects that world controllers have set going, by name in lower case."""
        return {}

    def advance_objects(self) -> None:
        """Move the objects that are in motion by a control step."""
        if not self.motions:
            return
        names, poses = [thing.name.lower() for thing in self.scene.arena.loose], self.loose_poses()
        for name, motion in self.motions.items():
            # By name, each time: indices shift when an object is created or removed.
            index = names.index(name)
            moved = motion.advance(poses[index], self.period)
            if moved is not None:
                (x, y, z), quat = moved[0].tolist(), moved[1]
                self.move_loose(index, (x, y, z), quat)

    @cached_property
    def recovery_log(self) -> RecoveryLog:
        """Recoveries of its physics."""
        return RecoveryLog()

    @property
    @abstractmethod
    def steps(self) -> int:
        """Control steps since the world began."""

    @property
    def time(self) -> float:
        """Simulated time since the world began [s]."""
        return self.steps * self.period

    def warm_up(self) -> None:  # noqa: B027 - nothing to compile is fine
        """Compile all programs that need no client, before the first one comes; the world stays as it is."""

    def prepare(self, robot: RobotSpec) -> None:
        """Do slow work before the first robot of a class can be spawned; may run in a thread.

        Raises:
            UsageError: No robot can be built of that class.
        """
        # Their caches keep the results: an INIT then finds them.
        for resolve in (suite_of, cameras_of, effecters_of):
            resolve(robot)

    def spawn(self, robot: RobotSpec, name: str, pos: Vec3, angles: Vec3) -> Robot:
        """Spawn a robot of that class at one pose; see `spawn_at`."""
        return self.spawn_at(robot, name, [(pos, angles)])

    @abstractmethod
    def spawn_at(self, robot: RobotSpec, name: str, poses: Sequence[tuple[Vec3, Vec3]]) -> Robot:
        """Spawn a robot of that class at the first pose with room for it.

        Args:
            robot: Its class.
            name: Its name.
            poses: Positions [m] and angles (roll, pitch, yaw) [rad] to choose from, the best first; worlds
                that do not search for room take the first.

        Raises:
            UsageError: There is no room for it, or the position is out of reach.
        """

    def starts_for(self, robot: RobotSpec) -> list[StartPose]:
        """Return the arena's start poses, those that another robot stands near last.

        Near is half of both robots' lengths or widths, whichever are longer.
        """
        own = max(robot.dimensions[:2])
        occupied = [
            (self.state(other).pos[:2].tolist(), (max(other.spec.dimensions[:2]) + own) / 2)
            for other in self.robots.values()
        ]

        def is_taken(start: StartPose) -> bool:
            return any(math.dist(start.at[:2], pos) <= apart for pos, apart in occupied)

        # A stable sort: free poses stay in the arena's order.
        return sorted(self.arena.starts, key=is_taken)

    @property
    def present(self) -> dict[int, Robot]:
        """All robots of the world, by slot: the clients', and those that a policy drives."""
        return self.robots

    def agents(self) -> dict[str, int]:
        """Return the names and slots of the robots that a policy drives unless a client takes them over."""
        return {}

    @abstractmethod
    def remove(self, robot: Robot) -> None:
        """Remove the robot from the world."""

    def battery(self, robot: Robot) -> float:
        """Return the remaining time of the robot's battery [s]; 0 when water has shorted it."""
        if robot.drowned:
            return 0.0
        group, member = self.scene.group_of(robot.slot)
        world = self.beside_physics()
        # Both are of the world's own count, which a reset sets to 0; the clients' time goes on.
        age = int(world.step) - int(world.groups[group].battery_start[member])
        return max(0.0, robot.spec.battery_life - age * self.period)

    def loose_poses(self) -> np.ndarray:
        """Return positions [m] and orientations, w first, of the arena's loose objects (objects, 7)."""
        return np.asarray(self.one_world()[1].qpos, float)[self.scene.loose_geoms.root_qposadr]

    def forget(self) -> None:
        """Remove the robots' marks, traces and texts on tags, and stop what controllers have set going."""
        self.motions.clear()
        self.traces.clear()
        self.tag_texts.clear()
        self.tag_texts.update(initial_tag_texts(self.arena))

    def free_tile(self, robot: RobotSpec) -> int:
        """Return the tile of the MultiView for a new robot of a class; -1 when there is none."""
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
            Whether the field of view is the requested one; not so for 0 and values beyond the limits
            (KRobot.uc).
        """
        robot.fovs[camera] = float(robot.cameras[camera].clamp(np.array(fov)))
        # A robot's state has one array for all its cameras, so all of them are written.
        self.edit(robot, fov=np.array(robot.fovs, np.float32))
        # An angle that was granted is kept in single precision, which changes its last digits.
        return abs(robot.fovs[camera] - fov) < 1e-6

    def viewpoint(self, request: CameraRequest | ViewpointRequest) -> Viewpoint:
        """Return the present viewpoint of a picture; NumPy arrays."""
        if isinstance(request, ViewpointRequest):
            return request.viewpoint
        robot, camera = request.robot, request.robot.cameras[request.camera]
        slot = np.array(robot.slot, np.int32)
        fov = np.array(robot.fovs[request.camera], np.float32)
        return camera_viewpoint(camera, self.bodies(robot), slot, fov)

    @abstractmethod
    def snapshot(self, requests: Sequence[CameraRequest | ViewpointRequest]) -> Callable[[], list[Picture]]:
        """Take a snapshot of the world for pictures; return a function that renders them.

        The first half is quick. The function may run in another thread, while the world goes on.
        """

    def set_command(self, robot: Robot, command: RobotCommand) -> None:
        """Replace the robot's command."""
        robot.command = command
        self.edit(robot, command=command)

    def update_command(self, robot: Robot, update: CommandUpdate) -> None:
        """Change a part of the robot's command.

        Raises:
            UnknownNameError: A key of DRIVE or a joint that it does not have; lists those it has.
        """
        with numpy_backend():
            # On NumPy: JAX would compile at a robot's first command, while all clients of the world wait.
            self.set_command(robot, update_command(robot.plan, robot.command, update))

    def setup(self) -> WorldSetup:
        """Return the world's inputs at its beginning, for a replay."""
        raise NotImplementedError

    @abstractmethod
    def step(self) -> None:
        """Advance by one control step."""

    def prepare_reset(self) -> None:  # noqa: B027 - nothing to compile is fine
        """Compile what `reset` needs; may run in a thread."""

    @abstractmethod
    def reset(self) -> None:
        """Restart the world; clients keep their robots, and their time goes on."""

    @abstractmethod
    def observe(self, due: list[Robot]) -> None:
        """Read the sensors of the robots that are about to report; add fresh readings to `pending`."""

    @abstractmethod
    def one_world(self) -> tuple[World, PhysicsState]:
        """Return the world and its physics as they are now, without an axis over worlds; NumPy arrays."""

    def beside_physics(self) -> World:
        """Return the world as `one_world` does, without its physics, which costs more."""
        return self.one_world()[0]

    @abstractmethod
    def edit(self, robot: Robot, **fields: Any) -> None:  # noqa: ANN401 - PyTrees of one robot
        """Replace fields of the robot's part of its `GroupState`."""

    def update_robot_spec(self, robot: Robot, spec: RobotSpec) -> None:
        """Replace the description of a robot while it runs; see `sim.configure.update_robot_spec`.

        Raises:
            UsageError: The world cannot do that, or not with this description.
        """
        del spec
        raise UsageError(f"{robot.name} is compiled: only in a world of engine c do descriptions change")

    def state(self, robot: Robot, physics: PhysicsState | None = None) -> RobotState:
        """Return pose and motion of the robot; NumPy arrays.

        Args:
            robot: The robot.
            physics: Present state of the physics, if it is known already.
        """
        group, member = self.scene.group_of(robot.slot)
        physics = self.one_world()[1] if physics is None else physics
        return robot_state(self.scene.groups[group].indices[member], physics.qpos, physics.qvel)

    def bodies(self, robot: Robot) -> BodyPoses:
        """Return the poses of the robot's bodies; NumPy arrays."""
        with numpy_backend():
            return forward_kinematics(robot.plan, self.state(robot))

    def memory(self, robot: Robot) -> SensorMemory:
        """Return the memory of the robot's sensors; NumPy arrays."""
        group, member = self.scene.group_of(robot.slot)
        return jax.tree.map(lambda x: x[member], self.one_world()[0].groups[group].memory)

    def sensor_input(self, robot: Robot) -> SensorInput:
        """Return the robot's sensor input without rays; NumPy arrays."""
        group, member = self.scene.group_of(robot.slot)
        world, physics = self.one_world()
        with numpy_backend():
            # A group of one, as sensing works on groups; the axis goes again below.
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

    def move_robot(self, robot: Robot, pos: Vec3, quat: np.ndarray) -> None:
        """Put a robot at a pose, at rest: position [m] and orientation, w first (4,).

        Raises:
            UsageError: The world cannot do that, or there is no room.
        """
        del pos, quat
        raise UsageError(f"{robot.name} stays: only a single world of engine c moves things")

    def set_stiffness(self, robot: Robot, joint: int, share: float) -> None:
        """Set the share of its gains and torque that the servo of a joint exerts: 0 to 1.

        Raises:
            UsageError: The world cannot do that.
        """
        del joint, share
        raise UsageError(f"{robot.name} keeps its gains: only in a single world of engine c do they change")

    def move_loose(self, index: int, pos: Vec3, quat: np.ndarray) -> None:
        """Put a loose object of the arena, by its index, at a pose, at rest; see `move_robot`."""
        del pos, quat
        name = self.scene.arena.loose[index].name
        raise UsageError(f"{name} stays: only a single world of engine c moves things")

    def add_loose(self, thing: LooseObject, *, held: bool) -> None:
        """Add a loose object, whose name no other has.

        Args:
            thing: The object.
            held: Whether it hangs in its place and passes through floor and walls.

        Raises:
            UsageError: The world cannot do that, or there is no room.
        """
        del held
        raise UsageError(f"no {thing.name}: only a single world of engine c adds objects")

    def remove_loose(self, index: int) -> None:
        """Remove a loose object of the arena, by its index; see `add_loose`."""
        name = self.scene.arena.loose[index].name
        raise UsageError(f"{name} stays: only a single world of engine c removes objects")

    def set_conveyors(self, name: str, share: float) -> None:
        """Set the speed of the arena's conveyors of a name, as a share of their own.

        Raises:
            UsageError: The world cannot do that.
        """
        del share
        raise UsageError(f"{name} keeps its speed: only in a single world of engine c does it change")

    def door_angles(self) -> np.ndarray:
        """Return the angles of the arena's doors [rad] (doors,)."""
        return np.asarray(self.one_world()[1].qpos[self.scene.door_qpos])

    def links(self, radio: RadioSettings) -> Links:
        """Return the radio links as they are now, by slot; numpy arrays.

        Args:
            radio: The constants, in a world whose scene has none of its own.
        """
        world, physics = self.one_world()
        scene = self.scene if self.scene.radio is not None else replace(self.scene, radio=radio)
        with numpy_backend():
            # Links carry what they were at the last evaluation; a world that never had any begins without.
            before = no_links(scene.num_robots) if world.links is None else world.links
            return update_links(scene, world.replace(links=before), physics)

    def solids_between(self, start: Vec3, end: Vec3) -> int:
        """Return the number of solids that weaken radio between two positions [m]."""
        world, physics = self.one_world()
        with numpy_backend():
            solids = radio_obstacles(self.scene, world, physics)
            ends = (np.array([point], np.float32) for point in (start, end))
            return int(count_walls(solids, *ends)[0])

    def sketches(self) -> list[OverlayLines]:
        """Return the overlays of the robots' sensors; NumPy arrays."""
        overlays: list[OverlayLines] = []
        for robot in self.robots.values():
            drawn = [index for index, sensor in enumerate(robot.suite.sensors) if sensor.has_overlay]
            own = self.memory(robot).own if drawn else ()
            overlays += [robot.suite.sensors[index].overlay(own[index]) for index in drawn]
        # One call for all: it starts every transfer before it waits for the first.
        return jax.device_get(overlays)

    @abstractmethod
    def met_objects(self, robot: Robot, sensor: int) -> list[MetObject]:
        """Return the objects that the beams of a robot's object sensor meet, by the sensor's index."""

    def sucks(self, robot: Robot, effecter: int) -> bool:
        """Return whether a robot's vacuum, by its index among the effecters, is closed."""
        del robot, effecter
        return False

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
            PlaceError: Names the position and the reach.
        """
        if not all(math.isfinite(v) and abs(v) <= MAX_COORDINATE for v in pos):
            text = f"start position {{}} is out of reach: at most {MAX_COORDINATE} m from the origin"
            raise PlaceError(text, pos)
