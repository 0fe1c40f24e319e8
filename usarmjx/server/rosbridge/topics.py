"""The topics of a served world: their messages, and the revision of the data in each.

Readings of sensors are in the frame of their mount. Cameras have their calibration, and pictures as Image and
CompressedImage.
"""

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.transforms import GRAVITY, mat_from_angles, quat_from_angles
from usarmjx.models.compile.raster import Grid, floor_map
from usarmjx.models.roads.network import LatLon
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.sensors.base import Sensor
from usarmjx.sensors.cameras.mounts import Camera
from usarmjx.sensors.gps import MIN_FIX_SATELLITES, Gps, geographic_coordinates
from usarmjx.sensors.inertial import Ahrs, Imu
from usarmjx.sensors.motion import GroundTruth, Ins, Odometry
from usarmjx.sensors.ranging import Ir, RangeScanner, ScannerSettings, Sonar
from usarmjx.server.pictures.views import CompositeView, ViewImages, robot_view
from usarmjx.server.protocol.images import format_number, jpeg
from usarmjx.server.rosbridge import motion
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.encodings import BridgeFrame, Compression, publication
from usarmjx.server.rosbridge.motion import (
    MAP,
    UNKNOWN,
    can_follow,
    drift_of,
    estimate_of,
    frame_name,
    odometry_sensor,
    optical_name,
    pose,
    pose_of_angles,
    quaternion,
    vector,
)
from usarmjx.server.rosbridge.robot_description import urdf
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld

ULTRASOUND, INFRARED = 0, 1
"""Values of Range's radiation_type."""
FLOAT32 = 7
"""PointField's number of the type."""
NO_FIX, FIX, SERVICE_GPS, APPROXIMATED = -1, 0, 1, 1
"""NavSatStatus's status and service, and NavSatFix's position_covariance_type."""
DISCHARGING, FULL, HEALTHY, EMPTY, TECHNOLOGY_UNKNOWN = 2, 4, 1, 3, 0
"""Values of BatteryState: of its status, of its health, and of its technology."""
ReadingMaker: TypeAlias = Callable[[RosVersion, float, str, np.ndarray], RosMessage]
"""Makes a message of a version, a time [s], the robot's name in frames, and a reading."""


class SensorTopic(NamedTuple):
    """A topic of a sensor.

    Attributes:
        name: Its name below its robot.
        type: Short type of its messages.
        make: Makes a message.
    """

    name: str
    type: str
    make: ReadingMaker


def sensor_topics(sensor: Sensor, origin: LatLon | None) -> Iterator[SensorTopic]:
    """Yield the topics of a sensor; none if ROS has no usual message for it.

    Args:
        sensor: The sensor.
        origin: Latitude and longitude of the arena's origin [degrees], if the arena has them.
    """
    name = sensor.mounts[0].name
    if isinstance(sensor, RangeScanner) and isinstance(sensor.settings[0], ScannerSettings):
        yield SensorTopic(name, "sensor_msgs/LaserScan", partial(scan, sensor))
    elif isinstance(sensor, Sonar | Ir):
        radiation = INFRARED if isinstance(sensor, Ir) else ULTRASOUND
        for index, mount in enumerate(sensor.mounts):
            yield SensorTopic(mount.name, "sensor_msgs/Range", ranger(sensor, index, radiation))
    elif isinstance(sensor, Imu):
        yield SensorTopic(name, "sensor_msgs/Imu", partial(imu, sensor))
    elif isinstance(sensor, Ahrs):
        yield SensorTopic(name, "sensor_msgs/Imu", partial(ahrs, sensor))
    elif isinstance(sensor, Gps):
        yield SensorTopic(name, "sensor_msgs/NavSatFix", partial(_fix, sensor, origin))
    elif isinstance(sensor, Odometry | Ins | GroundTruth):
        yield SensorTopic(name, "geometry_msgs/PoseStamped", partial(_estimate, sensor))


def scan(sensor: Sensor, version: RosVersion, time: float, robot: str, value: np.ndarray) -> RosMessage:
    """Return a LaserScan; our beams go from right to left, as ROS's do."""
    settings, ranges = sensor.settings[0], value.reshape(-1)
    # Zero is straight ahead, and angles grow to the left, in both.
    first = -settings.scan_fov / 2
    return {
        "header": version.header(time, f"{robot}/{frame_name(sensor.mounts[0].name)}"),
        "angle_min": first,
        "angle_max": first + (len(ranges) - 1) * settings.resolution,
        "angle_increment": settings.resolution,
        # All beams of a scan are of one moment.
        "time_increment": 0.0,
        "scan_time": settings.scan_interval,
        "range_min": settings.min_range,
        "range_max": settings.max_range,
        "ranges": np.asarray(ranges, float).tolist(),
        "intensities": [],
    }


def scan_points(scan: RosMessage) -> RosMessage:
    """Return the echoes of a LaserScan as a PointCloud2 in its frame, without the beams that met nothing."""
    ranges = np.asarray(scan["ranges"], float)
    angles = scan["angle_min"] + np.arange(len(ranges)) * scan["angle_increment"]
    points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles), np.zeros(len(ranges))], -1)
    # Little-endian on any machine, as is_bigendian says.
    points = points[ranges < scan["range_max"]].astype("<f4")
    step = points.itemsize * 3
    return {
        "header": scan["header"],
        "height": 1,
        "width": len(points),
        "fields": [
            {"name": name, "offset": index * points.itemsize, "datatype": FLOAT32, "count": 1}
            for index, name in enumerate("xyz")
        ],
        "is_bigendian": False,
        "point_step": step,
        "row_step": step * len(points),
        "data": points.tobytes(),
        # No point is NaN: beams without an echo are left out.
        "is_dense": True,
    }


def ranger(sensor: Sensor, index: int, radiation: int) -> ReadingMaker:
    """Return what makes the Range of one of a sensor's mounts."""
    settings = sensor.settings[index]

    def make(version: RosVersion, time: float, robot: str, value: np.ndarray) -> RosMessage:
        message = {
            "header": version.header(time, f"{robot}/{frame_name(sensor.mounts[index].name)}"),
            "radiation_type": radiation,
            "field_of_view": getattr(settings, "beam_angle", 0.0),
            "min_range": settings.min_range,
            "max_range": settings.max_range,
            "range": float(value[index]),
        }
        # ROS 2 alone has `variance`, where 0 stands for an unknown one.
        return message if version == RosVersion.ROS1 else {**message, "variance": 0.0}

    return make


def imu(sensor: Sensor, version: RosVersion, time: float, robot: str, value: np.ndarray) -> RosMessage:
    """Return an Imu; the sensor has no orientation."""
    return {
        "header": version.header(time, f"{robot}/{frame_name(sensor.mounts[0].name)}"),
        "orientation": quaternion(np.eye(4)[0]),
        "orientation_covariance": [UNKNOWN, *[0.0] * 8],
        "angular_velocity": vector(value[:3]),
        # By sensor_msgs/Imu a matrix of zeros stands for an unknown covariance.
        "angular_velocity_covariance": [0.0] * 9,
        "linear_acceleration": vector(value[3:]),
        "linear_acceleration_covariance": [0.0] * 9,
    }


def ahrs(sensor: Sensor, version: RosVersion, time: float, robot: str, value: np.ndarray) -> RosMessage:
    """Return an Imu with the orientation of the chassis; its acceleration has that of gravity (REP 145).

    Rates of roll, pitch and yaw become angular velocities about the axes of the chassis.
    """
    force, rates, _, angles = np.asarray(value, float).reshape(4, 3)
    roll, pitch, yaw = map(float, angles)
    # An accelerometer at rest shows gravity upwards; the AHRS of the manual leaves it out.
    up = mat_from_angles(roll, pitch, yaw).T @ np.array([0.0, 0.0, GRAVITY])
    sin_roll, cos_roll, sin_pitch, cos_pitch = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    # Euler rates are about three different axes; this matrix turns them into rates about the chassis's own.
    to_body = np.array(
        [
            [1.0, 0.0, -sin_pitch],
            [0.0, cos_roll, sin_roll * cos_pitch],
            [0.0, -sin_roll, cos_roll * cos_pitch],
        ]
    )
    return {
        **imu(sensor, version, time, robot, np.concatenate([to_body @ rates, force + up])),
        "header": version.header(time, f"{robot}/base_link"),
        "orientation": quaternion(quat_from_angles(roll, pitch, yaw)),
        "orientation_covariance": [0.0] * 9,
    }


def _fix(
    sensor: Sensor, origin: LatLon | None, version: RosVersion, time: float, robot: str, value: np.ndarray
) -> RosMessage:
    """Return a NavSatFix; the sensor has no altitude, which becomes null in JSON."""
    *position, satellites = map(float, value)
    settings, fixed = sensor.settings[0], satellites >= MIN_FIX_SATELLITES
    coordinates = geographic_coordinates(settings, position, origin) if fixed else (0.0, 0.0)
    # The largest noise counts as three deviations.
    variance = (settings.max_noise / 3) ** 2 if fixed else 0.0
    return {
        "header": version.header(time, f"{robot}/{frame_name(sensor.mounts[0].name)}"),
        "status": {"status": FIX if fixed else NO_FIX, "service": SERVICE_GPS},
        "latitude": coordinates[0],
        "longitude": coordinates[1],
        "altitude": None,
        "position_covariance": [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 0.0],
        # 0 stands for an unknown covariance: there is no position.
        "position_covariance_type": APPROXIMATED if fixed else 0,
    }


def _estimate(sensor: Sensor, version: RosVersion, time: float, robot: str, value: np.ndarray) -> RosMessage:
    """Return a sensor's estimate of its robot's pose, or of its mount's."""
    frame = f"{robot}/start" if isinstance(sensor, Odometry) else MAP
    return pose_estimate(version, time, frame, value)


def pose_estimate(version: RosVersion, time: float, frame: str, value: np.ndarray) -> RosMessage:
    """Return an estimate in a frame: of x, y and the heading (3,), or of a position and angles (6,)."""
    numbers = [float(one) for one in value]
    if len(numbers) == 3:
        x, y, heading = numbers
        numbers = [x, y, 0.0, 0.0, 0.0, heading]
    return {"header": version.header(time, frame), "pose": pose_of_angles(numbers)}


def battery_state(version: RosVersion, time: float, robot: str, life: float, remaining: float) -> RosMessage:
    """Return the BatteryState of a robot with some time of its battery's life left [s].

    Fields that a battery has no number for are NaN.
    """
    unknown = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity")
    share = remaining / life if life else 0.0
    return {
        "header": version.header(time, f"{robot}/base_link"),
        # None becomes NaN in bytes and null in JSON: BatteryState's value of what is not measured.
        **dict.fromkeys(unknown),
        "percentage": share,
        "power_supply_status": FULL if share >= 1.0 else DISCHARGING,
        "power_supply_health": HEALTHY if remaining > 0.0 else EMPTY,
        "power_supply_technology": TECHNOLOGY_UNKNOWN,
        "present": True,
        "cell_voltage": [],
        "cell_temperature": [],
        "location": "",
        "serial_number": "",
    }


def has_info(camera: Camera) -> bool:
    """Return whether CameraInfo can describe a camera: one with one eye, and no mirror."""
    return camera.lens == "pinhole" and len(camera.eye_offsets) == 1


def camera_info(
    version: RosVersion, time: float, robot: str, camera: Camera, fov: float, size: tuple[int, int]
) -> RosMessage:
    """Return the CameraInfo of a camera.

    Args:
        version: Version of its field names.
        time: Simulated time [s].
        robot: Its robot's name, in frames.
        camera: The camera.
        fov: Its horizontal field of view now [rad].
        size: Width and height of its pictures [pixels].
    """
    name = optical_name(f"{robot}/{frame_name(camera.mount.name)}")
    bent = camera.imaging.distortion
    k1, k2 = (0.0, 0.0) if bent is None else (float(one) for one in bent)
    return pinhole_info(version, time, name, fov, size, (k1, k2))


def pinhole_info(
    version: RosVersion,
    time: float,
    frame: str,
    fov: float,
    size: tuple[int, int],
    distortion: tuple[float, float] = (0.0, 0.0),
) -> RosMessage:
    """Return the CameraInfo of a pinhole.

    Args:
        version: Version of its field names.
        time: Simulated time [s].
        frame: Name of the optical frame.
        fov: Its horizontal field of view [rad].
        size: Width and height of its pictures [pixels].
        distortion: k1 and k2 of a plumb bob.
    """
    width, height = size
    # In pixels; pixels are square, so it is the same for both axes.
    focal = width / 2 / math.tan(fov / 2)
    # ROS counts pixels by their centres: the first is 0, so the picture's centre is half a pixel short of
    # half its side.
    across, down = (width - 1) / 2, (height - 1) / 2
    lens = {
        # plumb_bob has five numbers: radial, radial, two tangential, radial.
        "d": [*distortion, 0.0, 0.0, 0.0],
        "k": [focal, 0.0, across, 0.0, focal, down, 0.0, 0.0, 1.0],
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [focal, 0.0, across, 0.0, 0.0, focal, down, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
    # ROS 1 spells them D, K, R and P.
    if version == RosVersion.ROS1:
        lens = {name.upper(): values for name, values in lens.items()}
    return {
        "header": version.header(time, frame),
        "height": height,
        "width": width,
        "distortion_model": "plumb_bob",
        **lens,
        # By CameraInfo binning of 0 is none, and a region of zeros is the whole picture.
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


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
        # Our maps have x first; ROS's rows run along x, so y comes first there.
        "data": (filled.T.reshape(-1).astype(int) * OCCUPIED).tolist(),
    }


@dataclass(frozen=True, eq=False)
class RosTopic:
    """A topic.

    Attributes:
        name: Its full name.
        type: Short type of its messages.
        revision: Returns a value that changes with the data; None: there is no data yet.
        make: Makes a message; None for pictures, see `PictureRequest`, and for topics that robots listen to.
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
            # Two names may become one without their special characters: the slot tells them apart.
            names[robot.slot] = f"{name}_{robot.slot}" if name in names.values() else name
        return names

    def _map_news(self) -> int:
        """Return the number of the map: worlds of a batch get other arenas at resets."""
        arena = self._world.arena
        # By identity: comparing whole arenas in every step would cost more than the map.
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
            # With every control step: nodes that use simulated time have no other clock.
            lambda: world.time,
            lambda version: {"clock": version.stamp(world.time)},
        )
        yield RosTopic("/tf", "tf2_msgs/TFMessage", self._tick, self._moving_frames)
        # The number of now: the lambda below must not see a later one, which belongs to topics made anew.
        changes = self._changes
        # Latched: a late subscriber must get the frames, too, although they change only with the robots.
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
            # A robot that gets another description gets another suite.
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
        # All full names first: a sensor that is itself called `scan` keeps the name.
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
            # The margin keeps 0.9999999 of a period from counting as none.
            lambda: int(world.time / BATTERY_PERIOD + 1e-6),
            lambda version: battery_state(
                version, world.time, name, robot.spec.battery_life, world.battery(robot)
            ),
        )

    def _of_camera(self, robot: Robot, index: int) -> Iterator[RosTopic]:
        camera, name = robot.cameras[index], self._names[robot.slot]
        where = f"/{name}/{motion.frame_name(camera.mount.name)}"
        # Names of image_transport, for which viewers look.
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
        # As of the battery: the time is a sum of floats.
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
        # Body 0 is the chassis.
        frames = [frame for frame in self._mounted[robot.slot] if bool(frame.body) == moving]
        if not frames:
            return iter(())
        bodies, name = self._world.bodies(robot), self._names[robot.slot]
        where = bodies.pos, bodies.mat
        return motion.sensor_transforms(version, self._world.time, name, frames, where)


FORMAT = format_number("good")


class PictureRequest(NamedTuple):
    """A requested picture message.

    Attributes:
        topic: Topic of its camera, compressed or raw.
        version: Version of its field names.
        compression: Its encoding.
    """

    topic: RosTopic
    version: RosVersion
    compression: Compression


def image_view(topic: RosTopic, size: tuple[int, int]) -> CompositeView:
    """Return the view of a topic's camera, of that width and height."""
    if topic.robot is None:
        raise UsageError(f"{topic.name} shows no camera")
    return robot_view(topic.robot, topic.robot.cameras[topic.camera].mount.name, size)


def picture_messages(
    asked: Sequence[PictureRequest],
    views: Mapping[RosTopic, CompositeView],
    time: float,
    pictures: ViewImages,
) -> list[BridgeFrame]:
    """Return the messages of topics with pictures; may run in another thread.

    Args:
        asked: The requests.
        views: View of each topic.
        time: Simulated time of the views [s].
        pictures: The pictures.
    """
    made: dict[PictureRequest, BridgeFrame] = {}
    for one in asked:
        # Clients that ask for the same share one encoding.
        if one not in made:
            topic, version, compression = one
            message = picture_message(topic, version, time, pictures[views[topic]])
            made[one] = publication(topic.name, topic.type, message, version, compression, time)
    return [made[one] for one in asked]


def picture_message(topic: RosTopic, version: RosVersion, time: float, pixels: np.ndarray) -> RosMessage:
    """Return the message of a topic with a picture (height, width, 3), taken at a simulated time [s]."""
    header = version.header(time, optical_name(topic.name.strip("/").rpartition("/")[0]))
    return {"header": header, **_image(topic.type, pixels)}


def _image(kind: str, pixels: np.ndarray) -> RosMessage:
    if kind != RAW_IMAGE:
        return {"format": "jpeg", "data": jpeg(FORMAT, pixels)}
    height, width = pixels.shape[:2]
    size = {"height": height, "width": width}
    return {
        **size,
        "encoding": "rgb8",
        "is_bigendian": 0,
        "step": 3 * width,
        "data": np.ascontiguousarray(pixels, np.uint8).tobytes(),
    }
