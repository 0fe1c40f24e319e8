"""Readings of sensors as ROS messages, each in the frame of its mount; calibration of cameras."""

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np

from usarmjx.base.transforms import GRAVITY, mat_from_angles, quat_from_angles
from usarmjx.models.roads.network import LatLon
from usarmjx.sensors.attitude import Ahrs
from usarmjx.sensors.base import Sensor
from usarmjx.sensors.cameras.mounts import Camera
from usarmjx.sensors.gps import MIN_FIX_SATELLITES, Gps, geographic_coordinates
from usarmjx.sensors.inertial import Imu
from usarmjx.sensors.motion import GroundTruth, Ins, Odometry
from usarmjx.sensors.ranging import Ir, RangeScanner, ScannerSettings, Sonar
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.motion import (
    MAP,
    UNKNOWN,
    frame_name,
    optical_name,
    pose_of_angles,
    quaternion,
    vector,
)

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
    first = -settings.scan_fov / 2
    return {
        "header": version.header(time, f"{robot}/{frame_name(sensor.mounts[0].name)}"),
        "angle_min": first,
        "angle_max": first + (len(ranges) - 1) * settings.resolution,
        "angle_increment": settings.resolution,
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
        return message if version == RosVersion.ROS1 else {**message, "variance": 0.0}

    return make


def imu(sensor: Sensor, version: RosVersion, time: float, robot: str, value: np.ndarray) -> RosMessage:
    """Return an Imu; the sensor has no orientation."""
    return {
        "header": version.header(time, f"{robot}/{frame_name(sensor.mounts[0].name)}"),
        "orientation": quaternion(np.eye(4)[0]),
        "orientation_covariance": [UNKNOWN, *[0.0] * 8],
        "angular_velocity": vector(value[:3]),
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
    up = mat_from_angles(roll, pitch, yaw).T @ np.array([0.0, 0.0, GRAVITY])
    sin_roll, cos_roll, sin_pitch, cos_pitch = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
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
    variance = (settings.max_noise / 3) ** 2 if fixed else 0.0
    return {
        "header": version.header(time, f"{robot}/{frame_name(sensor.mounts[0].name)}"),
        "status": {"status": FIX if fixed else NO_FIX, "service": SERVICE_GPS},
        "latitude": coordinates[0],
        "longitude": coordinates[1],
        "altitude": None,
        "position_covariance": [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 0.0],
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
    focal = width / 2 / math.tan(fov / 2)
    # ROS counts pixels by their centres: the first is 0, so the picture's centre is half a pixel short of
    # half its side.
    across, down = (width - 1) / 2, (height - 1) / 2
    lens = {
        "d": [*distortion, 0.0, 0.0, 0.0],
        "k": [focal, 0.0, across, 0.0, focal, down, 0.0, 0.0, 1.0],
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [focal, 0.0, across, 0.0, 0.0, focal, down, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
    if version == RosVersion.ROS1:
        lens = {name.upper(): values for name, values in lens.items()}
    return {
        "header": version.header(time, frame),
        "height": height,
        "width": width,
        "distortion_model": "plumb_bob",
        **lens,
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }
