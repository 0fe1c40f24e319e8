"""Reports without a request, and short answers: NFO, STA, MISSTA, SEN, RES (manual 9.3).

Inputs are plain numbers already in the wire's axes and units. If lines captured from UT2004 servers (in
the comments of MOAST's USARSim client) differ from the manual, the captures win:
`{View n}` in STA, the number of decimals. No locale is involved: numbers have a decimal point.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from usarmjx.base.errors import UsageError
from usarmjx.base.registry import is_name
from usarmjx.server.protocol.grammar import (
    Message,
    Segment,
    Vector,
    check_word,
    four_decimals,
    four_decimals_list,
    two_decimals,
    two_decimals_list,
)

VEHICLES: dict[str, tuple[tuple[str, str], ...]] = {
    "GroundVehicle": (("FrontSteer", "front_steer"), ("RearSteer", "rear_steer")),
    "LeggedRobot": (),
    "NauticVehicle": (("SternPlaneAngle", "stern_plane"), ("RudderAngle", "rudder")),
    "AerialVehicle": (),
}
"""Kinds of robot of manual 9.3 and the angles in the STA of each: wire key, `RobotStatus` field."""

STATUS_OK, STATUS_FAILED = "OK", "Failed"
"""Status in RES of a SET that was carried out, and of one that was not (manual 9.3)."""


def nfo_greeting(level: str, time_limit: int = 0) -> Message:
    """Return the first line of every connection.

    Args:
        level: The arena's name.
        time_limit: Minutes after which the world ends; 0: never.
    """
    limit = ("TimeLimit", str(time_limit))
    return Message("NFO", (("Gametype", "BotDeathMatch"), ("Level", level), limit))


def nfo_start_poses(poses: Sequence[tuple[str, Vector, Vector]]) -> Message:
    """Return the answer to GETSTARTPOSES (manual 5.3.3).

    Args:
        poses: Tag, location [m] and orientation [rad] of each; without any there is no second
            segment.

    Raises:
        UsageError: A tag is not one word.
    """
    count = ("StartPoses", str(len(poses)))
    words = [
        f"{check_word(tag)} {two_decimals_list(location)} {two_decimals_list(orientation)}"
        for tag, location, orientation in poses
    ]
    if not words:
        return Message("NFO", (count,))
    # All poses are one segment, with the first tag as its key: captured lines have them so.
    first, _, rest = " ".join(words).partition(" ")
    return Message("NFO", (count, (first, rest)))


def check_vehicle(kind: str) -> str:
    """Return `kind` if it is one of the four that STA, GEO and CONF know robots by.

    Raises:
        UsageError: It is not; the message lists the four.
    """
    if kind not in VEHICLES:
        raise UsageError(f"unknown kind of vehicle {kind!r}; known: {', '.join(VEHICLES)}")
    return kind


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """Numbers of a robot's STA.

    Attributes:
        time: Simulated time [s].
        light: Whether the headlight is on.
        intensity: Its intensity [percent].
        battery: Time left [s].
        view: Tile of this robot's camera in a shared picture, -1 without one.
        front_steer: Steering angle of the front wheels [rad], of ground vehicles only.
        rear_steer: Steering angle of the rear wheels [rad], of ground vehicles only.
        stern_plane: Angle of the stern planes [rad], of nautic vehicles only.
        rudder: Angle of the rudders [rad], of nautic vehicles only.
        joints: Name and angle [rad] of flippers, which some robots add.
    """

    time: float
    light: bool
    intensity: int
    battery: int
    view: int = -1
    front_steer: float = 0.0
    rear_steer: float = 0.0
    stern_plane: float = 0.0
    rudder: float = 0.0
    joints: tuple[tuple[str, float], ...] = ()


def sta(kind: str, status: RobotStatus) -> Message:
    """Return the status line of a robot.

    The manual omits View, but servers send it and SPQR's client drops a STA without it.

    Args:
        kind: One of `VEHICLES`, which decides the angles in the line.
        status: The numbers.

    Raises:
        UsageError: There is no such kind.
    """
    return Message(
        "STA",
        (
            ("Type", check_vehicle(kind)),
            ("Time", two_decimals(status.time)),
            *((key, four_decimals(getattr(status, field))) for key, field in VEHICLES[kind]),
            *((name, four_decimals(angle)) for name, angle in status.joints),
            ("LightToggle", str(status.light)),
            ("LightIntensity", str(status.intensity)),
            ("Battery", str(status.battery)),
            ("View", str(status.view)),
        ),
    )


def missta(time: float, package: str, links: Iterable[tuple[int, float, float]]) -> Message:
    """Return the state of one mission package.

    Args:
        time: Simulated time [s].
        package: Its name.
        links: Number, angle [rad] or distance [m], and the joint's torque or force [N m or N] of each, where
            the original had minus the configured maximum (KRobot.uc, timer). Numbers below 1 are not
            reported, as there.
    """
    segments: list[Segment] = [("Time", two_decimals(time)), ("Name", package)]
    for link, value, effort in links:
        if link > 0:
            segments += [
                ("Link", str(link)),
                ("Value", four_decimals(value)),
                ("Torque", two_decimals(effort)),
            ]
    return Message("MISSTA", tuple(segments))


def _sen(time: str | None, type_name: str, *segments: Segment) -> Message:
    # The sensor's bWithTimeStamp decides whether there is a Time (manual 9.3).
    head: tuple[Segment, ...] = (("Time", time),) if time is not None else ()
    return Message("SEN", (*head, ("Type", type_name), *segments))


def _precise(time: float | None) -> str | None:
    return None if time is None else four_decimals(time)


def sen_range(kind: str, time: float | None, readings: Iterable[tuple[str, float]]) -> Message:
    """Return all range sensors of one kind ("Sonar", "IR") in one line: (name, range [m])."""
    names, values = zip(*readings, strict=True)
    # One call for all ranges takes less time than one for each.
    texts = four_decimals_list(values).split(",")
    items = [("Name", f"{check_word(name)} Range {text}") for name, text in zip(names, texts, strict=True)]
    return _sen(_precise(time), kind, *items)


@dataclass(frozen=True, slots=True)
class RangeScan:
    """One sweep of a range scanner.

    Attributes:
        name: The sensor's name.
        resolution: Angle between beams [rad].
        fov: Angle between the first and the last beam [rad].
        ranges: Distances [m], the rightmost beam first, then counter-clockwise (beams,).
    """

    name: str
    resolution: float
    fov: float
    ranges: Sequence[float]


def sen_scanner(kind: str, time: float | None, scan: RangeScan) -> Message:
    """Return a sweep of a "RangeScanner" or "IRScanner"; its Time has 2 decimals, as captured."""
    return _sen(
        None if time is None else two_decimals(time),
        kind,
        ("Name", scan.name),
        ("Resolution", four_decimals(scan.resolution)),
        ("FOV", four_decimals(scan.fov)),
        ("Range", four_decimals_list(scan.ranges)),
    )


@dataclass(frozen=True, slots=True)
class RangeScan3D:
    """One sweep of a 3D range scanner.

    Attributes:
        name: The sensor's name.
        resolution: Vertical and horizontal angle between beams [rad].
        fov: Vertical and horizontal field of view [rad].
        ranges: Distances [m], the highest row first, each from right to left (rows * columns,).
    """

    name: str
    resolution: tuple[float, float]
    fov: tuple[float, float]
    ranges: Sequence[float]


def sen_scanner_3d(time: float | None, scan: RangeScan3D) -> Message:
    """Return a sweep of a "RangeScanner3D": a range scanner's line with pairs of angles.

    The manual has no such line; this one is what Player's driver for the sensor reads.
    """
    return _sen(
        None if time is None else two_decimals(time),
        "RangeScanner3D",
        ("Name", scan.name),
        ("Resolution", four_decimals_list(scan.resolution)),
        ("FOV", four_decimals_list(scan.fov)),
        ("Range", four_decimals_list(scan.ranges)),
    )


def sen_lidar(time: float | None, scan: RangeScan3D, intensities: Sequence[float]) -> Message:
    """Return a sweep of a "Lidar": a 3D range scanner's line with echo intensities; our own addition."""
    # The pair before the name is the type, which becomes Lidar; Time stands before it only if it is sent.
    (*head, (_, _), name, resolution, fov, ranges) = sen_scanner_3d(time, scan).segments
    echoes = ("Intensity", four_decimals_list(intensities))
    return Message("SEN", (*head, ("Type", "Lidar"), name, resolution, fov, ranges, echoes))


def sen_odometry(time: float | None, name: str, pose: Vector) -> Message:
    """Return the estimated pose relative to the start: x [m], y [m], theta [rad]."""
    return _sen(_precise(time), "Odometry", ("Name", name), ("Pose", four_decimals_list(pose)))


def sen_ins(time: float | None, name: str, location: Vector, orientation: Vector) -> Message:
    """Return the estimated location [m] and orientation [rad, 0 to 2 pi]."""
    return _sen(_precise(time), "INS", *_raw_pose(name, location, orientation))


def sen_ground_truth(time: float | None, name: str, location: Vector, orientation: Vector) -> Message:
    """Return the true location [m] and orientation [rad]."""
    return _sen(_precise(time), "GroundTruth", *_raw_pose(name, location, orientation))


def _raw_pose(name: str, location: Vector, orientation: Vector) -> tuple[Segment, ...]:
    return (
        ("Name", name),
        # Two decimals, as UnrealScript prints a float; most other readings have four.
        ("Location", two_decimals_list(location)),
        ("Orientation", two_decimals_list(orientation)),
    )


def sen_encoder(time: float | None, ticks: Iterable[tuple[str, int]]) -> Message:
    """Return all encoders in one line: (name, tick count)."""
    items = [("Name", f"{check_word(name)} Tick {tick}") for name, tick in ticks]
    return _sen(_precise(time), "Encoder", *items)


def sen_tachometer(time: float | None, name: str, spins: Sequence[float], angles: Sequence[float]) -> Message:
    """Return spins [rad/s] and angles [rad] of all driven wheels (Tachometer.uc)."""
    pairs = ("Name", name), ("Vel", four_decimals_list(spins)), ("Pos", four_decimals_list(angles))
    return _sen(_precise(time), "Tachometer", *pairs)


def sen_ahrs(
    time: float | None, name: str, acceleration: Vector, rates: Vector, changes: Vector, angles: Vector
) -> Message:
    """Return attitude and its changes (IMU.uc).

    Args:
        time: Simulated time [s].
        name: The sensor's name.
        acceleration: Ahead, to the right and upward [m/s2].
        rates: Of roll, pitch and yaw [rad/s].
        changes: Of these rates [rad/s2].
        angles: Roll, pitch and yaw [rad].
    """
    keys = ("XYZAcceleration", "AngularVel", "AngularAccel", "Rotation")
    vectors = zip(keys, (acceleration, rates, changes, angles), strict=True)
    pairs = [(key, four_decimals_list(vector)) for key, vector in vectors]
    return _sen(_precise(time), "AHRS", ("Name", name), *pairs)


def sen_line_laser(
    time: float | None, name: str, location: Vector, orientation: Vector, points: Iterable[Sequence[float]]
) -> Message:
    """Return the pose of a line laser and the points of its line (LineLaser.uc).

    Args:
        time: Simulated time [s].
        name: The sensor's name.
        location: Its position [m].
        orientation: Roll, pitch and yaw [rad].
        points: Points of the line [m], with 3 decimals.
    """
    texts = [f"[{','.join(f'{value:.3f}' for value in point)}]" for point in points]
    pose = ("Location", four_decimals_list(location)), ("Orientation", four_decimals_list(orientation))
    return _sen(_precise(time), "LineLaser", ("Name", name), *pose, ("Points", "".join(texts)))


def sen_kinect(time: float | None, name: str, frame: int, depths: Iterable[float]) -> Message:
    """Return a strip of a picture of depths [m], which are sent in centimetres, cut (KinectDepth.uc)."""
    texts = ",".join(str(int(depth * 100)) for depth in depths)
    return _sen(_precise(time), "Kinect", ("Name", name), ("Frame", str(frame)), ("Range", texts))


def sen_point_cloud(time: float | None, name: str, points: Iterable[Vector]) -> Message:
    """Return points that a scanner meets, in its own axes [m].

    RotatingPointCloudScanner.uc has them in braces without a key; here it is Points, as every value has one.
    """
    texts = ";".join(two_decimals_list(point) for point in points)
    return _sen(_precise(time), "PCL", ("Name", name), ("Points", texts))


def sen_objects(time: float | None, name: str, objects: Iterable[tuple[str, Vector, Vector]]) -> Message:
    """Return the objects that a scanner's beams meet.

    ObjectSensor.uc has `{Object} {NAME x,y,z r,p,y}`; here it is one pair, as no message has a key without a
    value.

    Args:
        time: Simulated time [s].
        name: The sensor's name.
        objects: Name, location [m], and roll, pitch and yaw [rad] of each.
    """
    segments: list[Segment] = [("Name", name)]
    for tag, location, rotation in objects:
        # A name of several words would shift the numbers behind it.
        word = "_".join(tag.split()) or "_"
        pose = f"{two_decimals_list(location)} {two_decimals_list(rotation)}"
        segments.append(("Object", f"{word} {pose}"))
    return _sen(_precise(time), "ObjectSensor", *segments)


def sen_gps(time: float | None, name: str, position: tuple[float, float] | None, satellites: int) -> Message:
    """Return a position; without one the line has neither latitude nor longitude (GPSSensor.uc).

    Args:
        time: Simulated time [s].
        name: The sensor's name.
        position: Latitude and longitude [degrees], north and east positive.
        satellites: Number of satellites in sight.
    """
    coordinates: tuple[Segment, ...] = ()
    if position is not None:
        latitude, longitude = position
        coordinates = (
            ("Latitude", f"{_degrees_and_minutes(latitude)},{'S' if latitude < 0 else 'N'}"),
            ("Longitude", f"{_degrees_and_minutes(longitude)},{'W' if longitude < 0 else 'E'}"),
        )
    fix = ("Fix", "0" if position is None else "1")
    return _sen(_precise(time), "GPS", ("Name", name), *coordinates, fix, ("Satellites", str(satellites)))


def _degrees_and_minutes(angle: float) -> str:
    """Return an angle [degrees] without its sign as degrees and minutes, cut and never 60 minutes."""
    # Cut before the division: 59.99996 minutes rounded afterwards would read 60.
    degrees, minutes = divmod(float(four_decimals(abs(angle) * 60)), 60)
    return f"{degrees:.0f},{minutes:.4f}"


def sen_touch(time: float | None, touched: Iterable[tuple[str, bool]]) -> Message:
    """Return all touch sensors in one line: (name, whether it is touched)."""
    items = [("Name", f"{check_word(name)} Touch {bool(touch)}") for name, touch in touched]
    return _sen(_precise(time), "Touch", *items)


def res(time: float, type_name: str, name: str, status: str) -> Message:
    """Return the answer to a SET; type and name echo the request, status is mostly `STATUS_OK`.

    A value that is absent or no single word is left out: it would shift the pairs behind it.
    """
    echo = tuple((key, word) for key, word in (("Type", type_name), ("Name", name)) if is_name(word))
    return Message("RES", (("Time", two_decimals(time)), *echo, ("Status", status)))


def res_camera(
    time: float, cameras: Iterable[tuple[str, float, str]], unknown: Iterable[str] = ()
) -> Message:
    """Return the answer to a SET of fields of view, which lists every camera (KRobot.uc).

    Args:
        time: Simulated time [s].
        cameras: Name, field of view [rad] and status of each.
        unknown: Names that were asked for and that no camera has; they follow as failed.
    """
    segments: list[Segment] = [("Time", two_decimals(time)), ("Type", "Camera")]
    for name, fov, status in cameras:
        segments += [("Name", name), ("FOV", four_decimals(fov)), ("Status", status)]
    for name in unknown:
        segments += [("Name", name), ("Status", STATUS_FAILED)]
    return Message("RES", tuple(segments))


def res_viewports(time: float, config: tuple[str, str], viewports: Iterable[tuple[str, str]]) -> Message:
    """Return the answer to a SET of viewports.

    Args:
        time: Simulated time [s].
        config: "SingleView" or "QuadView", and its status.
        viewports: Camera of each of the four, and its status.
    """
    segments: list[Segment] = [("Time", two_decimals(time)), ("Type", "Viewports")]
    segments += [("Config", config[0]), ("Status", config[1])]
    for number, (shown, status) in enumerate(viewports, 1):
        segments += [(f"Viewport{number}", shown), ("Status", status)]
    return Message("RES", tuple(segments))
