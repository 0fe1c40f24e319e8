"""Sensors and drives that URDF and SDF files state in Gazebo's elements and plugins."""

import math
from collections.abc import Callable, Iterator

import numpy as np

from usarmjx.models.files.mjcf_solids import Pose
from usarmjx.models.files.robot_source import RobotSource, SensorOnLink, StatedDrive, listed
from usarmjx.models.files.urdf import body_name
from usarmjx.models.files.xml_file import NO_POSE, LinedElement, numbers_of, pose_of
from usarmjx.models.types.robot import Options

SLIPPERY = 0.1
"""Friction coefficient up to which a solid slides like a caster."""
HALF_DEGREE = math.radians(0.5)
"""Smallest field of view of a scanner [rad]."""
MIN_CAMERA_FOV, MAX_CAMERA_FOV = 0.02, math.radians(179)
"""Bounds of a camera's field of view [rad]."""
PLAIN_SETTINGS = ("mu1", "mu2", "material", "sensor", "plugin")
"""Elements of `<gazebo>` that are read."""


def read_gazebo_elements(root: LinedElement, source: RobotSource, bodies: set[str]) -> None:
    """Add what the `<gazebo>`, `<ros2_control>` and `<transmission>` elements of a URDF file state.

    Args:
        root: The `<robot>` element.
        source: The robot, which is changed.
        bodies: Names of its links.
    """
    left_out: dict[str, LinedElement] = {}
    for element in root.all("gazebo"):
        link = body_name(element.get("reference", ""))
        for child in element.children():
            _read_setting(child, link if link in bodies else "", source, left_out)
    if left_out:
        first = next(iter(left_out.values()))
        source.notes.append(f"{first.place}: settings of Gazebo are left out: {listed([*left_out], 12)}")
    moved = [joint.get("name", "") for control in root.all("ros2_control") for joint in _commanded(control)]
    moved += [joint.get("name", "") for one in root.all("transmission") for joint in one.all("joint")]
    if moved:
        source.motors = (source.motors or set()) | set(moved)


def _read_setting(
    child: LinedElement, link: str, source: RobotSource, left_out: dict[str, LinedElement]
) -> None:
    """Add what an element of `<gazebo>` states about a link; empty: about none."""
    if child.tag == "plugin":
        read_plugin(child, source)
    elif child.tag == "sensor" and link:
        read_sensor(child, link, source)
    elif child.tag in ("mu1", "mu2") and link:
        if float(numbers_of(child, child.text, 1)[0]) <= SLIPPERY:
            source.slippery.add(link)
    elif child.tag not in PLAIN_SETTINGS:
        left_out.setdefault(child.tag, child)


def _commanded(control: LinedElement) -> Iterator[LinedElement]:
    for joint in control.all("joint"):
        if joint.first("command_interface") is not None:
            yield joint


def read_sensor(sensor: LinedElement, body: str, source: RobotSource, frame: Pose = NO_POSE) -> None:
    """Add a `<sensor>` element's sensor; one of an unknown type becomes a note.

    Args:
        sensor: The element.
        body: Body that holds it.
        source: The robot, which is changed.
        frame: Pose of the link's frame in the body.
    """
    kind, name = sensor.get("type", ""), sensor.get("name") or "Sensor"
    made = SENSOR_READERS.get(kind)
    found = None if made is None else made(sensor, source)
    if found is None:
        known = ", ".join(sorted(SENSOR_READERS))
        source.notes.append(f"{sensor.place}: sensor {name!r} of type {kind!r} is left out; known: {known}")
        return
    ours, options, turn = found
    given = sensor.first("pose")
    own = NO_POSE if given is None else pose_of(numbers_of(given, given.text, 6))
    pose = frame.then(own).then(Pose(np.zeros(3), turn))
    rate = sensor.number("update_rate", 0.0)
    if rate > 0 and ours in ("RangeScanner", "RangeScanner3D"):
        options = (*options, ("ScanInterval", 1.0 / rate))
    source.sensors.append(
        SensorOnLink(kind=ours, name=source.free_name(name), body=body, pose=pose, options=options)
    )
    for plugin in sensor.all("plugin"):
        source.notes.append(f"{plugin.place}: plugin {_called(plugin)} of sensor {name!r} is left out")


Found = tuple[str, Options, np.ndarray] | None
"""Type on the wire, settings, and the rotation of the sensor's axis against the element's."""


def _scanner(sensor: LinedElement, source: RobotSource) -> Found:
    ray = next((found for tag in ("ray", "lidar") if (found := sensor.first(tag)) is not None), None)
    if ray is None:
        return None
    beams, low, high = (
        ray.number(f"scan/horizontal/{key}", usual)
        for key, usual in (("samples", 640.0), ("min_angle", -math.pi / 2), ("max_angle", math.pi / 2))
    )
    rows = ray.number("scan/vertical/samples", 1.0)
    limits: Options = tuple(
        (key, ray.number(path, usual))
        for key, path, usual in (("MinRange", "range/min", 0.1), ("MaxRange", "range/max", 10.0))
    )
    limits += _noise(ray, sensor, source, float(limits[1][1]))  # type: ignore[arg-type]
    # Our scanners cover a full turn at most.
    field = min(max(high - low, 0.0), 2 * math.pi)
    middle, tilt = (low + high) / 2, 0.0
    if _is_ultrasound(sensor):
        return "Sonar", (*limits, ("BeamAngle", max(field, HALF_DEGREE))), _turn(middle, 0.0)
    if beams <= 1 or field < HALF_DEGREE:
        return "IR", limits, _turn(middle, 0.0)
    # Samples are at both ends of the field.
    step = field / max(beams - 1, 1)
    if rows <= 1:
        return "RangeScanner", (*limits, ("ScanFov", field), ("Resolution", step)), _turn(middle, tilt)
    bottom, top = (
        ray.number(f"scan/vertical/{key}", usual) for key, usual in (("min_angle", 0.0), ("max_angle", 0.0))
    )
    span = max(top - bottom, HALF_DEGREE)
    options = (
        *limits,
        ("HorizontalFOV", field),
        ("HorizontalResolution", step),
        ("VerticalFOV", span),
        ("VerticalResolution", span / max(rows - 1, 1)),
    )
    return "RangeScanner3D", options, _turn(middle, (top + bottom) / 2)


def _is_ultrasound(sensor: LinedElement) -> bool:
    words = " ".join(
        (plugin.word("radiation_type") + _called(plugin)).lower() for plugin in sensor.all("plugin")
    )
    return "ultrasound" in words or "sonar" in words


def _noise(ray: LinedElement, sensor: LinedElement, source: RobotSource, reach: float) -> Options:
    """Return a scanner's noise; the file's is a length, ours a share of the distance."""
    deviation = ray.number("noise/stddev", 0.0)
    if deviation <= 0:
        return (("Noise", 0.0),)
    # Small at short distances and large at long ones: no share fits a constant length everywhere.
    share = deviation / (reach / 2)
    source.notes.append(
        f"{sensor.place}: noise of {deviation:g} m at any distance becomes {share:.2g} of the distance: "
        "both are equal at half the range"
    )
    return (("Noise", 0.0), ("Sigma", share))


def _sonar(sensor: LinedElement, source: RobotSource) -> Found:
    del source
    sonar = sensor.first("sonar")
    if sonar is None:
        return None
    low, high, radius = (
        sonar.number(key, usual) for key, usual in (("min", 0.1), ("max", 5.0), ("radius", 0.5))
    )
    # SDF gives the cone by its radius at the largest distance; the beam's angle is the whole one.
    angle = min(2 * math.atan2(radius, max(high, 1e-3)), math.pi)
    # Its cone opens along z.
    turn = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    return "Sonar", (("MinRange", low), ("MaxRange", high), ("BeamAngle", angle)), turn


def _camera(sensor: LinedElement, source: RobotSource) -> Found:
    del source
    field = sensor.number("camera/horizontal_fov", 1.047)
    field = min(max(field, MIN_CAMERA_FOV), MAX_CAMERA_FOV)
    # Gazebo's cameras do not zoom: the lowest and the highest field are the same.
    options = (("CameraDefFov", field), ("CameraMinFov", field), ("CameraMaxFov", field))
    return "Camera", options, np.eye(3)


def _plain_sensor(kind: str) -> Callable[[LinedElement, RobotSource], Found]:
    def read(sensor: LinedElement, source: RobotSource) -> Found:
        noise = sensor.first(f"{sensor.get('type')}//noise")
        if noise is not None:
            source.notes.append(f"{noise.place}: noise of sensor {sensor.get('name')!r} is left out")
        return kind, (), np.eye(3)

    return read


SENSOR_READERS: dict[str, Callable[[LinedElement, RobotSource], Found]] = {
    **dict.fromkeys(("ray", "gpu_ray", "lidar", "gpu_lidar"), _scanner),
    **dict.fromkeys(("camera", "wideanglecamera", "depth", "depth_camera", "rgbd_camera", "rgbd"), _camera),
    "imu": _plain_sensor("IMU"),
    "gps": _plain_sensor("GPS"),
    "navsat": _plain_sensor("GPS"),
    "magnetometer": _plain_sensor("Magnetometer"),
    "contact": _plain_sensor("Touch"),
    "sonar": _sonar,
}
"""Readers of Gazebo's types of sensors."""


def _turn(yaw: float, up: float) -> np.ndarray:
    """Return a rotation to the left and then upwards (3, 3)."""
    # Pitch is positive downwards in SDF, as z points up and y to the left.
    return pose_of(np.array([0.0, 0.0, 0.0, 0.0, -up, yaw])).mat


def _called(plugin: LinedElement) -> str:
    name, file = plugin.get("name", ""), plugin.get("filename", "")
    return f"{name} ({file})" if file and file != name else name


def read_plugin(plugin: LinedElement, source: RobotSource) -> None:
    """Add the drive that a plugin states; any other plugin becomes a note."""
    # Gazebo's and ROS' spellings of a plugin differ in case, `_` and `-`.
    called = _called(plugin).lower().replace("_", "").replace("-", "")
    for word, reader in DRIVE_PLUGINS.items():
        if word in called:
            source.drives.append(reader(plugin, source))
            return
    source.notes.append(f"{plugin.place}: plugin {_called(plugin)} is left out")


def _words(plugin: LinedElement, *tags: str) -> tuple[str, ...]:
    """Return the joints that elements of any of the tags name, in the tags' and then the file's order."""
    found = [one for tag in tags for one in plugin.all(tag)]
    return tuple(word for one in found for word in (one.text or "").split())


def _number(plugin: LinedElement, *tags: str, default: float = 0.0) -> float:
    found = next((one for tag in tags for one in plugin.all(tag)), None)
    return default if found is None else float(numbers_of(found, found.text, 1)[0])


def _wheel_radius(plugin: LinedElement) -> float:
    # Classic plugins state a diameter, gz-sim's a radius.
    radius = _number(plugin, "wheel_radius", "wheelRadius")
    return radius or _number(plugin, "wheelDiameter", "wheel_diameter") / 2


def _skid_plugin(plugin: LinedElement, source: RobotSource) -> StatedDrive:
    if "mecanum" in _called(plugin).lower():
        source.notes.append(f"{plugin.place}: wheels of a mecanum drive roll here as plain ones: it skids")
    left = (
        "leftJoint",
        "left_joint",
        "leftFrontJoint",
        "leftRearJoint",
        "front_left_joint",
        "back_left_joint",
        "rear_left_joint",
    )
    # Plugins of ROS 1, Gazebo Classic and gz-sim each have names of their own for the same joints.
    right = tuple(name.replace("left", "right").replace("Left", "Right") for name in left)
    return StatedDrive(
        kind="skid",
        left=_words(plugin, *left),
        right=_words(plugin, *right),
        separation=_number(plugin, "wheel_separation", "wheelSeparation"),
        radius=_wheel_radius(plugin),
        max_speed=_number(plugin, "max_linear_velocity", default=math.inf),
        max_turn=_number(plugin, "max_angular_velocity", default=math.inf),
        place=plugin.place,
    )


def _car_plugin(plugin: LinedElement, source: RobotSource) -> StatedDrive:
    del source
    left = _words(plugin, "left_joint", "front_left_joint", "rear_left_joint")
    right = _words(plugin, "right_joint", "front_right_joint", "rear_right_joint")
    return StatedDrive(
        kind="ackermann",
        left=left,
        right=right,
        steering=_words(plugin, "left_steering_joint", "right_steering_joint"),
        radius=_wheel_radius(plugin),
        max_speed=_number(plugin, "max_velocity", "max_speed", default=math.inf),
        place=plugin.place,
    )


DRIVE_PLUGINS: dict[str, Callable[[LinedElement, RobotSource], StatedDrive]] = {
    **dict.fromkeys(("diffdrive", "skidsteer", "mecanum"), _skid_plugin),
    "ackermann": _car_plugin,
}
"""Readers of plugins that drive, by a word in their names."""
