"""The topics of a served world: their messages, and the revision of the data in each."""

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from usarmjx.models.compile.raster import Grid, floor_map
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.server.rosbridge import motion
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.motion import MAP, can_follow, drift_of, estimate_of, odometry_sensor, pose
from usarmjx.server.rosbridge.readings import (
    ReadingMaker,
    battery_state,
    camera_info,
    has_info,
    sensor_topics,
)
from usarmjx.server.rosbridge.robot_description import urdf
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld

OCCUPIED = 100
"""Value of an occupied square in an OccupancyGrid [percent]."""
STATE_PERIOD = 0.04
"""Interval between two messages about poses and joints [s]."""
BATTERY_PERIOD = 1.0
"""Interval between two messages about a battery [s]."""
TWIST, RAW_IMAGE, IMAGE = "geometry_msgs/Twist", "sensor_msgs/Image", "sensor_msgs/CompressedImage"
TRAJECTORY = "trajectory_msgs/JointTrajectory"
LISTENED = (TWIST, TRAJECTORY)
"""Types of the topics that robots listen to."""
USUAL_NAMES = {
    "sensor_msgs/LaserScan": "scan",
    "sensor_msgs/Imu": "imu",
    "sensor_msgs/NavSatFix": "fix",
}
"""Names below a robot that ROS's programs expect of its first sensor of a type."""


def occupancy_grid(version: RosVersion, floor: float, grid: Grid, filled: np.ndarray) -> RosMessage:
    """Return a map as an OccupancyGrid on a floor of that height [m]: rows along x, from the lowest y on."""
    origin = pose((*grid.low, floor), np.eye(4)[0])
    return {
        "header": version.header(0.0, MAP),
        "info": {
            "map_load_time": version.stamp(0.0),
            "resolution": grid.cell,
            "width": grid.shape[0],
            "height": grid.shape[1],
            "origin": origin,
        },
        "data": (filled.T.reshape(-1).astype(int) * OCCUPIED).tolist(),
    }


@dataclass(frozen=True, eq=False)
class RosTopic:
    """A topic.

    Attributes:
        name: Its full name.
        type: Short type of its messages.
        revision: Returns a value that changes with the data; None: there is no data yet.
        make: Makes a message; None for pictures, which `images` makes, and for topics that robots listen to.
        robot: The robot that it drives or shows.
        camera: Index of the camera that it shows.
        is_latched: Whether a new subscriber gets its last message, however old that is.
    """

    name: str
    type: str
    revision: Callable[[], Hashable] = lambda: None
    make: Callable[[RosVersion], RosMessage] | None = None
    robot: Robot | None = None
    camera: int = -1
    is_latched: bool = False

    @property
    def is_listened_to(self) -> bool:
        """Whether a robot listens to it."""
        return self.type in LISTENED


class WorldTopics:
    """The topics of a world, by their names; they change when robots come and go.

    Args:
        world: The world.
        size: Width and height of pictures [pixels].
    """

    def __init__(self, world: ServedWorld, size: tuple[int, int]) -> None:
        self._world, self._size = world, size
        self._drawn: tuple[ArenaSpec, Grid, np.ndarray] | None = None
        self._maps = 0
        self._known: Sequence[tuple[Robot, Hashable]] = ()
        self._changes = 0
        self._by_name: dict[str, RosTopic] = {}
        self._names: dict[int, str] = {}
        self._mounted: dict[int, list[motion.SensorFrame]] = {}

    def all(self) -> dict[str, RosTopic]:
        """Return all present topics."""
        world = self._world
        # By the suite's identity, too: `editactor` gives a robot another description with other sensors. By
        # whether a client has it: then its odometry comes from its wheels.
        known = [
            (robot, (id(robot.suite), odometry_sensor(world, robot))) for robot in world.present.values()
        ]
        if not self._by_name or known != self._known:
            self._known, self._changes = known, self._changes + 1
            self._names = self._named(robot for robot, _ in known)
            self._mounted = {robot.slot: motion.frames_of(robot) for robot, _ in known}
            self._by_name = {topic.name: topic for topic in self._all()}
        return self._by_name

    def name_of(self, robot: Robot) -> str:
        """Return the name of a robot in topics and frames."""
        self.all()
        return self._names[robot.slot]

    def robots(self) -> dict[str, Robot]:
        """Return the robots by their names in topics and frames."""
        self.all()
        return {self._names[robot.slot]: robot for robot in self._world.present.values()}

    def transforms(self, version: RosVersion) -> list[RosMessage]:
        """Return the transforms of all frames."""
        self.all()
        moving, fixed = self._moving_frames(version), self._fixed_frames(version)
        return [*moving["transforms"], *fixed["transforms"]]

    @staticmethod
    def _named(robots: Iterable[Robot]) -> dict[int, str]:
        names: dict[int, str] = {}
        for robot in robots:
            name = motion.frame_name(robot.name)
            names[robot.slot] = f"{name}_{robot.slot}" if name in names.values() else name
        return names

    def _map_news(self) -> int:
        """Return the number of the map: worlds of a batch get other arenas at resets."""
        arena = self._world.arena
        if self._drawn is None or self._drawn[0] is not arena:
            self._drawn, self._maps = (arena, *floor_map(arena)), self._maps + 1
        return self._maps

    def _map(self, version: RosVersion) -> RosMessage:
        self._map_news()
        assert self._drawn is not None
        arena, grid, filled = self._drawn
        return occupancy_grid(version, arena.floor, grid, filled)

    def _all(self) -> Iterator[RosTopic]:
        world = self._world
        yield RosTopic(
            "/clock",
            "rosgraph_msgs/Clock",
            lambda: world.time,
            lambda version: {"clock": version.stamp(world.time)},
        )
        yield RosTopic("/tf", "tf2_msgs/TFMessage", self._tick, self._moving_frames)
        changes = self._changes
        yield RosTopic(
            "/tf_static", "tf2_msgs/TFMessage", lambda: changes, self._fixed_frames, is_latched=True
        )
        yield RosTopic("/map", "nav_msgs/OccupancyGrid", self._map_news, self._map, is_latched=True)
        for robot in world.present.values():
            yield from self._of_robot(robot)

    def _of_robot(self, robot: Robot) -> Iterator[RosTopic]:
        world, name = self._world, self._names[robot.slot]
        yield RosTopic(
            f"/{name}/odom",
            "nav_msgs/Odometry",
            self._tick,
            lambda version: motion.odometry(version, world.time, name, estimate_of(world, robot)),
        )
        yield RosTopic(
            f"/{name}/joint_states",
            "sensor_msgs/JointState",
            self._tick,
            lambda version: motion.joint_states(version, world.time, robot, world.state(robot)),
        )
        if can_follow(robot.spec.drive):
            yield RosTopic(f"/{name}/cmd_vel", TWIST, robot=robot)
        if len(robot.plan.parts) > 1:
            yield RosTopic(f"/{name}/joint_trajectory", TRAJECTORY, robot=robot)
        yield self._of_battery(robot)
        yield RosTopic(
            f"/{name}/robot_description",
            "std_msgs/String",
            lambda: id(robot.suite),
            lambda version: {"data": urdf(robot.spec)},
            is_latched=True,
        )
        yield from self._of_sensors(robot)
        for index in range(len(robot.cameras)):
            yield from self._of_camera(robot, index)

    def _of_sensors(self, robot: Robot) -> Iterator[RosTopic]:
        """Yield the topics of a robot's sensors; the first of a type has its usual name, too."""
        above, found = self._names[robot.slot], list[RosTopic]()
        for index, sensor in enumerate(robot.suite.sensors):
            for below, kind, make in sensor_topics(sensor, self._world.arena.gps):
                where = f"/{above}/{motion.frame_name(below)}"
                found.append(self._of_sensor(robot, index, where, kind, make))
        yield from found
        taken = {topic.name for topic in found}
        for topic in found:
            usual = f"/{above}/{USUAL_NAMES.get(topic.type)}"
            if topic.type in USUAL_NAMES and usual not in taken:
                taken.add(usual)
                yield replace(topic, name=usual)

    def _of_battery(self, robot: Robot) -> RosTopic:
        world, name = self._world, self._names[robot.slot]
        return RosTopic(
            f"/{name}/battery_state",
            "sensor_msgs/BatteryState",
            lambda: int(world.time / BATTERY_PERIOD + 1e-6),
            lambda version: battery_state(
                version, world.time, name, robot.spec.battery_life, world.battery(robot)
            ),
        )

    def _of_camera(self, robot: Robot, index: int) -> Iterator[RosTopic]:
        camera, name = robot.cameras[index], self._names[robot.slot]
        where = f"/{name}/{motion.frame_name(camera.mount.name)}"
        for below, kind in (("compressed", IMAGE), ("image_raw", RAW_IMAGE)):
            yield RosTopic(f"{where}/{below}", kind, self._tick, robot=robot, camera=index)

        def info(version: RosVersion) -> RosMessage:
            fov = float(robot.fovs[index])
            return camera_info(version, self._world.time, name, camera, fov, self._size)

        if has_info(camera):
            yield RosTopic(f"{where}/camera_info", "sensor_msgs/CameraInfo", self._tick, info)

    def _of_sensor(self, robot: Robot, index: int, where: str, kind: str, make: ReadingMaker) -> RosTopic:
        name = self._names[robot.slot]

        def revision() -> Hashable:
            return robot.latest[index][0] if index in robot.latest else None

        def message(version: RosVersion) -> RosMessage:
            time, value = robot.latest[index]
            return make(version, time, name, value)

        return RosTopic(where, kind, revision, message)

    def _tick(self) -> int:
        return int(self._world.time / STATE_PERIOD + 1e-6)

    def _moving_frames(self, version: RosVersion) -> RosMessage:
        """Return the transforms of all robots, of odom frames that drift, and of sensors on moving parts."""
        world, transforms = self._world, list[RosMessage]()
        for robot in world.present.values():
            name = self._names[robot.slot]
            state, estimate = world.state(robot), estimate_of(world, robot)
            if odometry_sensor(world, robot) is not None:
                where = drift_of(state, estimate)
                transforms.append(motion.odom_transform(version, world.time, name, where))
            transforms.append(motion.base_transform(version, world.time, name, estimate))
            floor = world.arena.floor
            transforms.append(motion.footprint_transform(version, world.time, name, robot.spec, state, floor))
            transforms += self._frames(version, robot, moving=True)
        return {"transforms": transforms}

    def _fixed_frames(self, version: RosVersion) -> RosMessage:
        """Return the transforms of odom frames that are the map's, and of sensors on the chassis."""
        world, transforms = self._world, list[RosMessage]()
        for robot in world.present.values():
            if odometry_sensor(world, robot) is None:
                transforms.append(motion.odom_transform(version, world.time, self._names[robot.slot]))
            transforms += self._frames(version, robot, moving=False)
        return {"transforms": transforms}

    def _frames(self, version: RosVersion, robot: Robot, *, moving: bool) -> Iterator[RosMessage]:
        frames = [frame for frame in self._mounted[robot.slot] if bool(frame.body) == moving]
        if not frames:
            return iter(())
        bodies, name = self._world.bodies(robot), self._names[robot.slot]
        where = bodies.pos, bodies.mat
        return motion.sensor_transforms(version, self._world.time, name, frames, where)
