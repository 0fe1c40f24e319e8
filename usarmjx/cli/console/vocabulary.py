"""The words of the protocol that are known before any robot is: heads, keys, values (manual 9.4, 10, 11)."""

from usarmjx.server.network.access import AUTH
from usarmjx.server.protocol.command_parsers import COMMANDS
from usarmjx.server.protocol.commands import DRIVE_KEYS, TRACE_COLORS

CLASS_PREFIX = "USARBot."
FLAGS = ("True", "False")
VIEWPORTS = tuple(f"Viewport{number}" for number in range(1, 5))

KEYS: dict[str, tuple[str, ...]] = {
    AUTH: ("Token",),
    "INIT": ("ClassName", "Name", "Location", "Rotation", "Start"),
    "GETSTARTPOSES": (),
    "DRIVE": (
        *(*DRIVE_KEYS, "Normalized", "Light", "Flip"),
        *("Name", "Order", "Value", "Steer"),
        *("WheelNumber", "WheelSpeed", "WheelSteer"),
    ),
    "MULTIDRIVE": (),
    "MISPKG": ("Name", "Link", "Value", "Order", "Rotation", "Gripper"),
    "SET": ("Type", "Name", "Opcode", "Params", "FOV", "Robot", "Client", "Config", *VIEWPORTS),
    "TRACE": ("On", "Interval", "Color"),
    "CAMERA": ("Rotation", "Order", "Zoom"),
    "GETGEO": ("Type", "Name"),
    "GETCONF": ("Type", "Name"),
    "CONTROL": (
        *("Type", "Name", "ClassName", "Location", "Rotation", "Start"),
        *("Scale", "Physics", "Permanent", "MinPos", "MaxPos"),
        *("WP", "Speed", "Time", "Move", "Loop", "Autoalign", "Show", "ResetOnClear"),
    ),
}
"""The keys of each command; those of MULTIDRIVE are a robot's joints."""
REPEATED_KEYS = {
    "DRIVE": frozenset({"wheelnumber", "wheelspeed", "wheelsteer"}),
    "MISPKG": frozenset({"link", "value", "order"}),
    "SET": frozenset({"name", "fov"}),
}
"""Keys that a line may have several times."""
SENSOR_TYPES = (
    *("Sonar", "IR", "RangeScanner", "IRScanner", "RangeScanner3D"),
    *("Odometry", "INS", "INU", "Encoder", "GroundTruth", "GPS"),
    *("Touch", "CO2Sensor", "HumanMotion", "Sound", "RFID", "VictSensor"),
    *("IMU", "Magnetometer", "Battery", "Lidar"),
    *("Tachometer", "AltitudeSensor", "MissionTime", "AHRS", "MagneticCompass", "LineLaser", "Kinect"),
    *("ObjectSensor", "PCL"),
)
"""Types of sensors; some of them report only on events."""
JOINT_OPCODES = ("Angle", "Velocity", "Torque", "RelAngle", "RelVelocity", "RelTorque")
SENSOR_OPCODES: dict[str, tuple[str, ...]] = {
    "odometry": ("RESET",),
    "encoder": ("RESET",),
    "tachometer": ("RESET",),
    "ins": ("POSE",),
    "rangescanner": ("SCAN",),
    "irscanner": ("SCAN",),
    "rangescanner3d": ("SCAN",),
    "kinect": ("SCAN",),
    "objectsensor": ("SCAN",),
    "rfid": ("Read", "Write"),
    "camera": ("Zoom",),
    "joint": JOINT_OPCODES,
}
"""Opcodes of SET for sensors and cameras, by type in lower case; CONF has those of effecters."""
ASKED_TYPES = ("Robot", "Camera", "MisPkg", "Effecter")
"""Types of GETGEO and GETCONF that are no sensors'."""
VALUES: dict[str, tuple[str, ...]] = {
    "normalized": FLAGS,
    "light": FLAGS,
    "flip": FLAGS,
    "on": FLAGS,
    "color": TRACE_COLORS,
    "config": ("SingleView", "QuadView"),
    "order": ("0", "1", "2"),
}
"""Values that a key takes, in any command."""


def heads() -> list[str]:
    """Return the heads of all commands."""
    return sorted({AUTH, *COMMANDS.names()})
