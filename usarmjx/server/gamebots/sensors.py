"""Messages of sensors and robots: SEN, STA and MISSTA of their state, GEO and CONF of their parts."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence, Set
from functools import cache, partial
from typing import Any, TypeVar, cast

import numpy as np

from usarmjx.base.backend import Array
from usarmjx.models.compile.kinematic_tree import KinematicTree
from usarmjx.models.compile.parts import joint_names, part_name
from usarmjx.models.effecters import Effecter, effecters_of
from usarmjx.models.roads.network import LatLon
from usarmjx.models.types.robot import Link, MissionPackage, Mount, RobotSpec, camel_case, field_names
from usarmjx.sensors.base import NoisySensorSettings, Quantity, Sensor
from usarmjx.sensors.cameras.mounts import Camera, cameras_of
from usarmjx.sensors.gps import MIN_FIX_SATELLITES, geographic_coordinates
from usarmjx.server.gamebots import victims
from usarmjx.server.protocol import reports
from usarmjx.server.protocol.descriptions import (
    ConfField,
    LinkConfiguration,
    LinkGeometry,
    RobotConfiguration,
    RobotGeometry,
    conf_effecters,
    conf_items,
    conf_mispkg,
    conf_nothing,
    conf_robot,
    geo_items,
    geo_mispkg,
    geo_nothing,
    geo_robot,
)
from usarmjx.server.protocol.dialects import ACTUATOR_TYPE, LATER_TYPES, MANUAL, PACKAGE_TYPE
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector, wrap_angles
from usarmjx.server.protocol.grammar import Message, Segment, check_word, four_decimals, four_decimals_list
from usarmjx.sim.control import RobotCommand

T = TypeVar("T")

PACKAGE_TYPES = MANUAL.package_types
"""Types that ask for mission packages, lower case."""

_COMMON = frozenset(field.name for field in dataclasses.fields(NoisySensorSettings))
"""Settings of every sensor, which CONF leaves out."""
_FORMATS: dict[str, Callable[[Sequence[float]], str]] = {
    "number": lambda numbers: four_decimals(numbers[0]),
    "count": lambda numbers: str(round(numbers[0])),
    "flag": lambda numbers: str(bool(numbers[0])),
    "yaw": lambda numbers: four_decimals(flip_wire_angles((0.0, 0.0, numbers[0]))[2]),
    "vector": lambda numbers: four_decimals_list(flip_wire_vector(numbers)),
    "angles": lambda numbers: four_decimals_list(flip_wire_angles(numbers)),
}
"""Text of each of `sensors.quantities.FORMS`, in the wire's axes."""


def lookup_by_type(kind: type[Sensor], table: Mapping[str, T]) -> T | None:
    """Return the entry of a sensor type, or of the nearest base class that has one.

    None: there is none, or a nearer class declares its own quantities.
    """
    for base in kind.__mro__:
        own = vars(base)
        # A class of a user that declares quantities must not inherit the fixed line of the manual's sensor.
        if own.get("quantities"):
            return None
        if own.get("kind") in table:
            return table[own["kind"]]
    return None


def of_type(kind: str, message: Message) -> Message:
    """Return a SEN with another type."""
    if ("Type", kind) in message.segments:
        return message
    segments = tuple((key, kind if key == "Type" else text) for key, text in message.segments)
    return Message(message.kind, segments)


def generic_report(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    """Return the SEN of a reading: its quantities, as `Sensor.quantities` lists them, in that order.

    Without such a list all numbers are one `{Value ...}`. Sensors that report together have a segment each,
    `{Name F1 Range 1.0000}`, others a segment for each quantity.

    Args:
        sensor: The sensor.
        value: Its reading, in our axes (...,); of a group (mounts, ...).
        time: Simulated time [s]; None leaves it out.
    """
    head: tuple[Segment, ...] = () if time is None else (("Time", four_decimals(time)),)
    # A row for each mount of a group, else one for all.
    rows = np.asarray(value, float).reshape(len(sensor.mounts) if sensor.grouped else 1, -1).tolist()
    segments: list[Segment] = []
    for mount, row in zip(sensor.mounts, rows, strict=False):
        pairs = _pairs(sensor.quantities, row)
        if sensor.grouped:
            words = " ".join(f"{key} {text}" for key, text in pairs)
            segments.append(("Name", f"{check_word(mount.name)} {words}"))
        else:
            segments += [("Name", mount.name), *pairs]
    return Message("SEN", (*head, ("Type", sensor.kind), *segments))


def _pairs(quantities: Sequence[Quantity], numbers: Sequence[float]) -> list[Segment]:
    """Return key and text of each quantity."""
    if not quantities:
        return [("Value", four_decimals_list(numbers))]
    pairs: list[Segment] = []
    start = 0
    for quantity in quantities:
        end = start + quantity.size
        pairs.append((quantity.key, _FORMATS[quantity.form](numbers[start:end])))
        start = end
    return pairs


def generic_fields(settings: object) -> list[ConfField]:
    """Return the CONF of a sensor's own settings, those of one number or word."""
    names = field_names(type(settings)).items()
    pairs = [(camel_case(name), getattr(settings, field)) for name, field in names if field not in _COMMON]
    return [(key, value) for key, value in pairs if isinstance(value, bool | int | float | str)]


# Reports: (sensor, its value, time or None) -> message.


def _range(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    pairs = [(mount.name, v) for mount, v in zip(sensor.mounts, value.tolist(), strict=True)]
    return reports.sen_range(sensor.kind, time, pairs)


def _scanner(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    settings = sensor.settings[0]
    scan = reports.RangeScan(sensor.mounts[0].name, settings.resolution, settings.scan_fov, value.tolist())
    return reports.sen_scanner(sensor.kind, time, scan)


def _scanner_3d(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    settings = sensor.settings[0]
    scan = reports.RangeScan3D(
        sensor.mounts[0].name, settings.resolution, settings.fov, value.reshape(-1).tolist()
    )
    return reports.sen_scanner_3d(time, scan)


def _lidar(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    settings, (ranges, echoes) = sensor.settings[0], value.reshape(2, -1).tolist()
    scan = reports.RangeScan3D(sensor.mounts[0].name, settings.resolution, settings.fov, ranges)
    return reports.sen_lidar(time, scan, echoes)


def _odometry(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    x, y, heading = value.tolist()
    # As vector and angle in space: the wire's axes are turned about x, not mirrored on the floor.
    (x, y, _), (_, _, heading) = flip_wire_vector((x, y, 0.0)), flip_wire_angles((0.0, 0.0, heading))
    return reports.sen_odometry(time, sensor.mounts[0].name, (x, y, heading))


def _ins(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    return reports.sen_ins(
        time,
        sensor.mounts[0].name,
        flip_wire_vector(value[:3].tolist()),
        wrap_angles(flip_wire_angles(value[3:].tolist())),
    )


def _ground_truth(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    return reports.sen_ground_truth(
        time,
        sensor.mounts[0].name,
        flip_wire_vector(value[:3].tolist()),
        wrap_angles(flip_wire_angles(value[3:].tolist())),
    )


def _encoder(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    ticks = [(mount.name, int(v)) for mount, v in zip(sensor.mounts, value, strict=True)]
    return reports.sen_encoder(time, ticks)


def _tachometer(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    spins, angles = value.reshape(2, -1).tolist()
    return reports.sen_tachometer(time, sensor.mounts[0].name, spins, angles)


def _ahrs(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    (ahead, left, up), *rest = value.reshape(4, 3).tolist()
    rates, changes, angles = (flip_wire_angles(one) for one in rest)
    # Only this vector points upward on the wire (IMU.uc).
    return reports.sen_ahrs(time, sensor.mounts[0].name, (ahead, -left, up), rates, changes, angles)


def _line_laser(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    place, angles, *points = np.asarray(value, float).tolist()
    orientation = wrap_angles(flip_wire_angles(angles))
    line = [flip_wire_vector(point) for point in points]
    return reports.sen_line_laser(time, sensor.mounts[0].name, flip_wire_vector(place), orientation, line)


def _kinect(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    frame, *depths = value.tolist()
    return reports.sen_kinect(time, sensor.mounts[0].name, int(frame), depths)


def _point_cloud(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    points = [flip_wire_vector(point) for point in np.asarray(value, float).tolist()]
    return reports.sen_point_cloud(time, sensor.mounts[0].name, points)


def _no_objects(sensor: Sensor, value: np.ndarray, time: float | None) -> None:
    """Return no message: only the world knows what the beams meet; see `reporter.objects_report`."""
    del sensor, value, time


def _touch(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    touched = [(mount.name, bool(v)) for mount, v in zip(sensor.mounts, value, strict=True)]
    return reports.sen_touch(time, touched)


def _gps(sensor: Sensor, value: np.ndarray, time: float | None, origin: LatLon | None = None) -> Message:
    *position, satellites = value.tolist()
    has_fix = satellites >= MIN_FIX_SATELLITES
    coordinates = geographic_coordinates(sensor.settings[0], position, origin) if has_fix else None
    return reports.sen_gps(time, sensor.mounts[0].name, coordinates, int(satellites))


REPORTS: dict[str, Callable[[Sensor, np.ndarray, float | None], Message | None]] = {
    "Sonar": _range,
    "IR": _range,
    "RangeScanner": _scanner,
    "IRScanner": _scanner,
    "RangeScanner3D": _scanner_3d,
    "Lidar": _lidar,
    "Odometry": _odometry,
    "INS": _ins,
    "GroundTruth": _ground_truth,
    "Encoder": _encoder,
    "Tachometer": _tachometer,
    "AHRS": _ahrs,
    "LineLaser": _line_laser,
    "Kinect": _kinect,
    "ObjectSensor": _no_objects,
    "PCL": _point_cloud,
    "Touch": _touch,
    "GPS": _gps,
    **victims.REPORTS,
}

_SCANNER_FIELDS = (
    ("MaxRange", "max_range"),
    ("MinRange", "min_range"),
    ("Resolution", "resolution"),
    ("Fov", "scan_fov"),
    ("Paning", "yaw"),
    ("Tilting", "pitch"),
)
_SCANNER_3D_FIELDS = (
    ("MaxRange", "max_range"),
    ("MinRange", "min_range"),
    ("Resolution", "resolution"),
    ("FOV", "fov"),  # in capitals, unlike the others': Player's driver looks for this key
)
CONFIGURATION: dict[str, tuple[tuple[str, str], ...]] = {
    "Sonar": (("MaxRange", "max_range"), ("MinRange", "min_range"), ("BeamAngle", "beam_angle")),
    "IR": (("MaxRange", "max_range"), ("MinRange", "min_range")),
    "RangeScanner": _SCANNER_FIELDS,
    "IRScanner": _SCANNER_FIELDS,
    "RangeScanner3D": _SCANNER_3D_FIELDS,
    "Lidar": _SCANNER_3D_FIELDS,
    "Odometry": (("ScanInterval", "scan_interval"), ("EncoderResolution", "encoder_resolution")),
    "GPS": (("ScanInterval", "scan_interval"),),
    "INS": (("ScanInterval", "scan_interval"),),
    "GroundTruth": (("ScanInterval", "scan_interval"),),
    "Encoder": (("Resolution", "resolution"),),
    "Tachometer": (("ScanInterval", "scan_interval"),),
    "AHRS": (("ScanInterval", "scan_interval"),),
    "LineLaser": (
        ("MaxRange", "max_range"),
        ("MinRange", "min_range"),
        ("FOV", "fov"),
        ("Resolution", "beams"),
    ),
    "ObjectSensor": _SCANNER_FIELDS,
    "Kinect": (*_SCANNER_3D_FIELDS[:-1], ("Fov", "fov")),
    "PCL": (
        ("MaxRange", "max_range"),
        ("NumberOfBeams", "number_of_beams"),
        ("HFieldOfView", "h_field_of_view"),
        ("VFieldOfView", "v_field_of_view"),
        ("SpinRate", "spin_rate"),
    ),
    "Touch": (("Diameter", "diameter"),),
    **victims.CONFIGURATION,
}
"""CONF of sensors: wire key -> settings field, in the order of captured lines.

Fov and Paning are spelled so in those lines.
"""


# Kept by type: every reading asks for it.
@cache
def _report_of(kind: type[Sensor]) -> Callable[[Any, np.ndarray, float | None], Message | None]:
    """Return what makes the SEN of a sensor type."""
    return lookup_by_type(kind, REPORTS) or generic_report


def sensor_report(
    sensor: Sensor,
    value: np.ndarray,
    time: float,
    origin: LatLon | None = None,
    texts: victims.TagTexts | None = None,
    *,
    stamped: bool = False,
) -> Message | None:
    """Return the SEN message of a reading, with its time if the sensor is set so; None without a message.

    A type that is not in `REPORTS` uses the function of its nearest base class, or `generic_report`.

    Args:
        sensor: The sensor.
        value: Its reading.
        time: Simulated time [s].
        origin: Latitude and longitude of the arena's origin [degrees], if the arena has them.
        texts: Memory of RFID tags.
        stamped: Whether to add the time regardless of the sensor's setting.
    """
    report = _report_of(type(sensor))
    # Only these two need the world's data; all other reports share one signature.
    if report is _gps:
        report = partial(_gps, origin=origin)
    elif report is victims.tags:
        report = partial(victims.tags, texts=texts)
    message = report(sensor, value, time if stamped or sensor.settings[0].with_time_stamp else None)
    return None if message is None else of_type(sensor.kind, message)


def _asked(kind: str, name: str, item_kind: str, item_name: str) -> bool:
    """Whether a query selects the item: types and names match without case, no name means all."""
    # Later versions call some types otherwise; both names match, and the answer has the one asked for.
    kinds = {item_kind.lower(), LATER_TYPES.get(item_kind, item_kind).lower()}
    return kind.lower() in kinds and (not name or item_name.lower() == name.lower())


def _mounts(mounts: Sequence[Mount], kind: str, name: str) -> list[Mount]:
    return [mount for mount in mounts if _asked(kind, name, mount.kind, mount.name)]


def _package_type(kind: str) -> str:
    """Return the type of the answer about mission packages: MisPkg, or Actuator if that was asked for."""
    return next((known for known in (PACKAGE_TYPE, ACTUATOR_TYPE) if known.lower() == kind.lower()), kind)


def _effecters(robot: RobotSpec, kind: str, name: str) -> list[Effecter]:
    # By `is_type`, not by the kind: a vacuum counts as a gripper, too.
    own = (effecter for effecter in effecters_of(robot) if effecter.is_type(kind))
    return [effecter for effecter in own if not name or effecter.mount.name.lower() == name.lower()]


def _packages(robot: RobotSpec, name: str) -> list[MissionPackage]:
    return [package for package in robot.packages if not name or package.name.lower() == name.lower()]


def geometry(
    plan: KinematicTree, kind: str, name: str, package_types: Set[str] = PACKAGE_TYPES
) -> list[Message]:
    """Return the answers to GETGEO, one line per category that matches (KRobot.uc); an echo without any.

    Args:
        plan: The robot's class.
        kind: Type asked for.
        name: Name asked for, "" for all of the type.
        package_types: Types that ask for mission packages, lower case.
    """
    robot = plan.robot
    if kind.lower() == "robot":
        return [
            geo_robot(
                RobotGeometry(
                    kind=robot.drive.vehicle,
                    name=robot.name,
                    dimensions=robot.dimensions,
                    # Mounts and tips are described in USARSim's axes already; this one is computed in ours.
                    cog=flip_wire_vector(plan.centre_of_mass),
                    wheel_radius=robot.wheel_radius,
                    wheel_separation=robot.wheel_separation,
                    wheel_base=robot.wheel_base,
                )
            )
        ]
    answers: list[Message] = []
    effecters = [effecter.mount for effecter in _effecters(robot, kind, name)]
    for matching in (_mounts(robot.sensors, kind, name), effecters, _mounts(robot.cameras, kind, name)):
        if matching:
            # Under the type that was asked for, which may be the later versions' name.
            answers.append(geo_items(kind, [(m.name, m.at, m.direction, m.parent) for m in matching]))
    packages = _packages(robot, name) if kind.lower() in package_types else []
    if packages:
        links = [
            (p.name, [LinkGeometry(k.number, k.parent, k.location, k.orientation) for k in p.links])
            for p in packages
        ]
        type_name = _package_type(kind)
        tips = {one.name: one.tip for one in packages if type_name == ACTUATOR_TYPE}
        answers.append(geo_mispkg(links, type_name, tips))
    return answers or [geo_nothing(kind, name)]


def _sensor_fields(sensor: Sensor, index: int) -> list[ConfField]:
    settings: Any = sensor.settings[index]
    fields: list[ConfField] = [("Name", sensor.mounts[index].name)]
    known = lookup_by_type(type(sensor), CONFIGURATION)
    if known is None:
        fields += generic_fields(settings)
    for key, field in known or ():
        value = getattr(settings, field)
        pair = isinstance(value, tuple)  # vertical and horizontal
        fields.append((key, four_decimals_list(cast(tuple[float, ...], value)) if pair else value))
    # Without any option it would read as the echo of a name that is not there.
    return fields if len(fields) > 1 else [*fields, ("ScanInterval", settings.scan_interval)]


def _camera_fields(camera: Camera, fov: float) -> list[ConfField]:
    return [
        ("CameraDefFov", camera.default_fov),
        ("CameraMinFov", camera.min_fov),
        ("CameraMaxFov", camera.max_fov),
        ("CameraFov", fov),
    ]


def _camera_configuration(kind: str, cameras: Sequence[tuple[Camera, float]], *, has_names: bool) -> Message:
    """Return the CONF of cameras: the manual's has no names, so only several are named unless asked."""
    named = has_names or len(cameras) > 1
    names: list[list[ConfField]] = [[("Name", one.mount.name)] if named else [] for one, _ in cameras]
    options = [_camera_fields(*one) for one in cameras]
    return conf_items(kind, [[*name, *option] for name, option in zip(names, options, strict=True)])


def configuration(
    robot: RobotSpec,
    sensors: Sequence[Sensor],
    fovs: Sequence[float],
    kind: str,
    name: str,
    package_types: Set[str] = PACKAGE_TYPES,
    *,
    has_camera_names: bool = False,
) -> list[Message]:
    """Return the answers to GETCONF, as `geometry` does for GETGEO.

    Args:
        robot: The robot's class.
        sensors: Its sensors.
        fovs: Field of view in force of each of its cameras [rad].
        kind: Type asked for.
        name: Name asked for, "" for all of the type.
        package_types: Types that ask for mission packages, lower case.
        has_camera_names: Whether a single camera has a name in the answer, too.
    """
    if kind.lower() == "robot":
        return [
            conf_robot(
                RobotConfiguration(
                    kind=robot.drive.vehicle,
                    name=robot.name,
                    steering=robot.drive.steering,
                    mass=robot.mass,
                    max_speed=robot.drive.max_speed,
                    max_torque=robot.max_torque,
                    max_front_steer=robot.drive.max_steering[0],
                    max_rear_steer=robot.drive.max_steering[1],
                )
            )
        ]
    answers: list[Message] = []
    fields = [
        _sensor_fields(sensor, index)
        for sensor in sensors
        for index, mount in enumerate(sensor.mounts)
        if _asked(kind, name, sensor.kind, mount.name)
    ]
    if fields:
        answers.append(conf_items(kind, fields))
    cameras = [
        (camera, fov)
        for camera, fov in zip(cameras_of(robot), fovs, strict=True)
        if _asked(kind, name, camera.mount.kind, camera.mount.name)
    ]
    if cameras:
        answers.append(_camera_configuration(kind, cameras, has_names=has_camera_names))
    effecters = _effecters(robot, kind, name)
    if effecters:
        answers.append(conf_effecters([(e.mount.name, _operations(e)) for e in effecters], kind))
    packages = _packages(robot, name) if kind.lower() in package_types else []
    if packages:
        links = [(p.name, [_link_configuration(k) for k in p.links]) for p in packages]
        answers.append(conf_mispkg(links, _package_type(kind)))
    return answers or [conf_nothing(kind, name)]


def _operations(effecter: Effecter) -> list[tuple[str, float, float]]:
    return [(opcode.name, opcode.max_val, opcode.min_val) for opcode in effecter.opcodes]


def _link_configuration(link: Link) -> LinkConfiguration:
    return LinkConfiguration(
        link=link.number,
        joint=link.joint,
        max_speed=link.max_speed,
        max_torque=link.max_torque,
        min_range=link.min_range,
        max_range=link.max_range,
    )


def robot_report(
    plan: KinematicTree, command: RobotCommand, joints: Array, time: float, battery: int, view: int = -1
) -> Message:
    """Return a robot's STA: its steering angles, flippers, headlight and battery (manual 9.3).

    Args:
        plan: The robot's class.
        command: Its command.
        joints: Its joint positions [rad or m] (joints,).
        time: Simulated time [s].
        battery: Time left [s].
        view: Its tile of the MultiView, -1 without one.
    """
    drive, light = plan.robot.drive, bool(command.light)
    angles = dict(zip(plan.parts[1:], joints.tolist(), strict=True))
    angles_of: dict[str, Any] = drive.steering_angles(angles, command.setpoint)
    return reports.sta(
        drive.vehicle,
        reports.RobotStatus(
            time=time,
            light=light,
            intensity=100 if light else 0,
            battery=battery,
            view=view,
            joints=tuple((name, angles[name]) for name in plan.robot.reported_joints),
            **angles_of,
        ),
    )


def package_report(plan: KinematicTree, joints: Array, efforts: Array, time: float) -> list[Message]:
    """Return the MISSTA messages of a robot's mission packages.

    Args:
        plan: The robot's class.
        joints: Its joint positions [rad or m] (joints,).
        efforts: Torque or force on its joints [N m or N] (joints,).
        time: Simulated time [s].
    """
    states = dict(zip(plan.parts[1:], zip(joints.tolist(), efforts.tolist(), strict=True), strict=True))
    return [
        reports.missta(
            time, package.name, [(link.number, *states[part_name(package, link)]) for link in package.links]
        )
        for package in plan.robot.packages
    ]


def link_joint(robot: RobotSpec, package: str, number: int) -> int | None:
    """Return the joint of a mission package's link, None when there is none; names match without case."""
    for candidate in robot.packages:
        for link in candidate.links:
            if candidate.name.lower() == package.lower() and link.number == number:
                return joint_names(robot).index(part_name(candidate, link))
    return None
