"""Robots for team tasks: with an INS and a small scanner, and only the sensors that a task reads."""

import math
from collections.abc import Sequence
from dataclasses import replace

from usarmjx.base.transforms import Vec3
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.drives import RotaryWing
from usarmjx.models.files.find_robot import find_robot
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import Mount, RobotSpec, options

INS = Mount(kind="INS", name="INS", options=options(Sigma=0.01))
"""A better unit than the default one, whose 10 % of noise turn a map by half a radian within some minutes."""
GROUND_TRUTH = Mount(kind="GroundTruth", name="GroundTruth")
"""Position sensor of robots that fly: the manual's INS only counts ways along the heading, and its GPS is
wrong by a metre."""
HOKUYO = options(
    MaxRange=4.0, MinRange=0.02, Resolution=3 * 0.0184087, ScanFov=4.189, ScanInterval=0.2, Noise=0.01
)
"""Every third beam of the Hokuyo URG-04LX of the UDK version's ini: 76 beams over 240 degrees, 4 m."""
VICTIM_FOV = 1.4
"""Horizontal angle of victim sensors [rad]."""
VICTIM_SENSOR = options(
    HorizontalFov=VICTIM_FOV, HorizontalStep=0.4667, VerticalFov=0.4667, VerticalStep=0.4667, ScanInterval=0.4
)
"""A victim sensor of 21 rays instead of 441, over 80 by 27 degrees."""
VICTIM_SENSOR_DOWN = options(
    HorizontalFov=VICTIM_FOV, HorizontalStep=0.4667, VerticalFov=1.4, VerticalStep=0.4667, ScanInterval=0.4
)
"""The same for robots that fly, which look down: 49 rays over 80 by 80 degrees."""
DOWN_SENSOR_POSITION: Vec3 = (0.0, 0.0, 0.06)
"""Position of the sensor with which flying robots look down: below the body [m]."""


def mapping_robot(robot: str | RobotSpec, extra: Sequence[Mount] = ()) -> RobotSpec:
    """Return a robot with an INS, the scanner and some other sensors; nothing else is computed.

    The scanner is where the robot has one, else a hand's breadth above its top.

    Raises:
        UnknownNameError: No such robot.
    """
    spec = find_robot(robot)
    own = next((mount.at for mount in spec.sensors if mount.kind == "RangeScanner"), None)
    # Descriptions have z down, so this is above the top.
    top = (0.0, 0.0, kinematic_tree_of(spec).clearance - spec.dimensions[2] - 0.1)
    scanner = Mount(kind="RangeScanner", name="Mapper", at=own or top, options=HOKUYO)
    return replace(spec, sensors=(INS, scanner, *extra))


def victim_search_robot(robot: str | RobotSpec) -> RobotSpec:
    """Return a robot as `mapping_robot` does with a victim sensor.

    One that flies looks down, has no scanner, and knows where it is.

    Raises:
        UnknownNameError: No such robot.
    """
    spec = find_robot(robot)
    if flies(spec):
        # With z down a positive pitch lifts the nose.
        down = (0.0, -math.pi / 2, 0.0)
        sensor = Mount(
            kind="VictSensor",
            name="Seeker",
            at=DOWN_SENSOR_POSITION,
            direction=down,
            options=VICTIM_SENSOR_DOWN,
        )
        return replace(spec, sensors=(GROUND_TRUTH, sensor))
    mapper = mapping_robot(spec)
    # The place of the scanner, which `mapping_robot` puts second.
    sensor = Mount(kind="VictSensor", name="Seeker", at=mapper.sensors[1].at, options=VICTIM_SENSOR)
    return replace(mapper, sensors=(*mapper.sensors, sensor))


def pose_sensor(robot: RobotSpec) -> str:
    """Return the type of the sensor by which such a robot knows where it is."""
    return GROUND_TRUTH.kind if flies(robot) else INS.kind


def flies(robot: RobotSpec) -> bool:
    """Return whether a robot flies on rotors."""
    return isinstance(robot.drive, RotaryWing)


def base_station() -> RobotSpec:
    """Return the base station, which knows where it stands."""
    return replace(ROBOTS.get("ComStation"), sensors=(INS,))
