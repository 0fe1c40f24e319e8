"""Facts about the arena and the client's robot, from the messages of a server; the words of the protocol.

Both complete a command that is being typed: heads, keys, values.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from usarmjx.base.errors import PeerError
from usarmjx.server.network.access import AUTH
from usarmjx.server.protocol.command_parsers import COMMANDS
from usarmjx.server.protocol.commands import DRIVE_KEYS, TRACE_COLORS
from usarmjx.server.protocol.grammar import Message, Segment, to_float, to_vector

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
REPORTED_SEGMENTS = frozenset(
    {"type", "time", "frontsteer", "rearsteer", "sternplaneangle", "rudderangle"}
    | {"lighttoggle", "lightintensity", "battery", "view"}
)
"""Keys of STA that are no joints'."""
TYPES_OF_ROBOTS = ("GroundVehicle", "LeggedRobot", "NauticVehicle", "AerialVehicle")


def heads() -> list[str]:
    """Return the heads of all commands."""
    # AUTH is no command of the protocol: the connection takes it before any of them.
    return sorted({AUTH, *COMMANDS.names()})


@dataclass
class PackageLink:
    """One link of a mission package.

    Attributes:
        parent: Number of the link that it hangs on; -1: the chassis.
        orientation: Roll, pitch, yaw on its parent [rad].
        limits: Lowest and highest position; None: unknown, or there are none.
        value: Position [rad or m].
    """

    parent: int = -1
    orientation: tuple[float, ...] = (0.0, 0.0, 0.0)
    limits: tuple[float, float] | None = None
    value: float = 0.0


@dataclass
class Knowledge:
    """Facts that the server has reported.

    Attributes:
        level: The arena.
        starts: Start poses: location and rotation as texts, by tag.
        class_name: The robot's class.
        robot: The robot's name in INIT.
        steering: Type of its steering from CONF.
        max_rear_steer: Steering angle of its rear wheels [rad].
        has_robot: Whether it has reported.
        light: Whether its headlight is on.
        battery: For how long its battery lasts yet [s].
        time: Simulated time [s].
        items: Names of its items by type, as the server spells them.
        mounts: Parts that its items are on, by type and name in lower case.
        fovs: Fields of view of its cameras [rad], by name.
        fov_limits: Smallest and largest one.
        packages: Links of its mission packages by number, by name.
        opcodes: Operations of its effecters, by name in lower case.
        joints: Names of joints that it reports.
    """

    level: str = ""
    starts: dict[str, tuple[str, str]] = field(default_factory=dict[str, tuple[str, str]])
    class_name: str = ""
    robot: str = ""
    steering: str = ""
    max_rear_steer: float = 0.0
    has_robot: bool = False
    light: bool = False
    battery: str = ""
    time: float = 0.0
    items: dict[str, list[str]] = field(default_factory=dict[str, list[str]])
    mounts: dict[tuple[str, str], str] = field(default_factory=dict[tuple[str, str], str])
    fovs: dict[str, float] = field(default_factory=dict[str, float])
    fov_limits: dict[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])
    packages: dict[str, dict[int, PackageLink]] = field(default_factory=dict[str, dict[int, PackageLink]])
    opcodes: dict[str, list[str]] = field(default_factory=dict[str, list[str]])
    joints: list[str] = field(default_factory=list[str])
    _asked: set[str] = field(default_factory=set[str])

    def hear(self, message: Message) -> None:
        """Take a message of the server; what it says wrongly is not learned."""
        learn = {"NFO": self._nfo, "STA": self._sta, "MISSTA": self._missta, "SEN": self._sen}
        learn |= {"GEO": self._geo, "CONF": self._conf, "RES": self._res}
        try:
            if message.kind in learn:
                learn[message.kind](message)
        except (PeerError, LookupError, ValueError):
            return

    def said(self, message: Message) -> None:
        """Take a message of the client."""
        if message.kind == "INIT":
            self.robot = message.get("Name") or self.robot

    def questions(self) -> list[str]:
        """Return the queries that would tell more now; each only once."""
        wanted = ["GETSTARTPOSES"] if self.level else []
        if self.has_robot:
            # Types that were heard of, too: robots of users have sensors of their own.
            wanted += [f"GETGEO {{Type {kind}}}" for kind in (*ASKED_TYPES, *SENSOR_TYPES, *self.items)]
            wanted += [f"GETCONF {{Type {kind}}}" for kind in (*ASKED_TYPES, *self.items)]
        new = [line for line in dict.fromkeys(wanted) if line not in self._asked]
        # Also of a question without an answer: to ask again with each message would flood the server.
        self._asked.update(new)
        return new

    def names(self, kind: str) -> list[str]:
        """Return the names of the items of a type, case ignored; of a package's links too for Joint."""
        if kind.lower() == "mispkg":
            return list(self.packages)
        if kind.lower() == "joint":
            links = [f"{name}_Link{number}" for name, links in self.packages.items() for number in links]
            return [*links, *self.joints]
        for known, names in self.items.items():
            if known.lower() == kind.lower():
                return list(names)
        return []

    def _add(self, kind: str, name: str) -> None:
        # Types count alike in any case: the spelling that came first stays.
        known = next((one for one in self.items if one.lower() == kind.lower()), kind)
        if name not in self.items.setdefault(known, []):
            self.items[known].append(name)

    def _nfo(self, message: Message) -> None:
        self.level = message.get("Level") or self.level
        if message.get("StartPoses") and len(message.segments) > 1:
            # The first tag is the segment's key.
            words = " ".join(" ".join(pair) for pair in message.segments[1:]).split()
            # Tag, location and rotation in turns; a pose that is not whole is dropped.
            self.starts = {
                tag: (at, turn) for tag, at, turn in zip(*(words[i::3] for i in range(3)), strict=False)
            }

    def _sta(self, message: Message) -> None:
        self.has_robot = True
        self.time = to_float(message.get("Time"))
        self.light, self.battery = message.get("LightToggle").lower() == "true", message.get("Battery")
        # STA has the joints by name beside its own keys.
        self.joints = [key for key, _ in message.segments if key.lower() not in REPORTED_SEGMENTS]

    def _missta(self, message: Message) -> None:
        links = self.packages.setdefault(message.get("Name"), {})
        for number, fields in _by_link(message.segments):
            links.setdefault(number, PackageLink()).value = to_float(fields.get("value", "0"))

    def _sen(self, message: Message) -> None:
        for name in message.all("Name"):
            self._add(message.get("Type"), name.split()[0])

    def _geo(self, message: Message) -> None:
        kind = message.get("Type")
        if kind in TYPES_OF_ROBOTS:
            self.class_name = message.get("Name")
        elif kind.lower() == "mispkg":
            for name, segments in _by_name(message.segments):
                links = self.packages.setdefault(name, {})
                for number, fields in _by_link(segments):
                    link = links.setdefault(number, PackageLink())
                    # By way of a float, as numbers of links may come with decimals.
                    link.parent = int(to_float(fields.get("parentlink", "-1")))
                    link.orientation = to_vector(fields.get("orientation", "0,0,0"))
        else:
            for words in (value.split() for value in message.all("Name")):
                if len(words) > 1 and kind.lower() != "effecter":  # else it is an echo: there is none
                    self._add(kind, words[0])
                    self.mounts[kind.lower(), words[0].lower()] = words[-1]

    def _conf(self, message: Message) -> None:
        kind = message.get("Type")
        if kind in TYPES_OF_ROBOTS:
            self.steering = message.get("SteeringType")
            self.max_rear_steer = to_float(message.get("MaxRearSteer"))
        if kind.lower() == "camera":
            self._cameras(message)
        for name, segments in _by_name(message.segments):
            fields = {key.lower(): value for key, value in segments}
            if kind.lower() == "effecter" and "opcode" in fields:
                self.opcodes[name.lower()] = [value for key, value in segments if key.lower() == "opcode"]
                self._add("Effecter", name)
            elif kind.lower() == "mispkg":
                links = self.packages.setdefault(name, {})
                for number, told in _by_link(segments):
                    low, high = (to_float(told.get(key, "0")) for key in ("minrange", "maxrange"))
                    # A lowest position above the highest means no limits, as in `min_range` of a link.
                    links.setdefault(number, PackageLink()).limits = (low, high) if low <= high else None

    def _cameras(self, message: Message) -> None:
        """Learn the fields of view: the message names no camera, it has them in the order of GEO."""
        told = ([to_float(text) for text in message.all(f"Camera{key}Fov")] for key in ("", "Min", "Max"))
        for name, fov, low, high in zip(self.names("Camera"), *told, strict=False):
            self.fovs[name], self.fov_limits[name] = fov, (low, high)

    def _res(self, message: Message) -> None:
        for name, segments in _by_name(message.segments):
            fields = {key.lower(): value for key, value in segments}
            if "fov" in fields:
                self.fovs[name] = to_float(fields["fov"])


def _by_name(segments: tuple[Segment, ...]) -> Iterator[tuple[str, tuple[Segment, ...]]]:
    """Yield the segments that follow each `{Name ...}`, with the name."""
    at = [index for index, (key, _) in enumerate(segments) if key.lower() == "name"]
    for first, last in zip(at, (*at, len(segments))[1:], strict=True):
        if segments[first][1]:
            yield segments[first][1].split()[0], segments[first + 1 : last]


def _by_link(segments: tuple[Segment, ...]) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the fields that follow each `{Link n}`, by their keys in lower case, with the number."""
    number, fields = 0, dict[str, str]()
    # A link that does not count ends the last one.
    for key, value in (*segments, ("Link", "0")):
        if key.lower() == "link":
            if number:
                # Links count from 1: 0 stands for the segments before the first link.
                yield number, fields
            number, fields = int(to_float(value)), {}
        else:
            fields[key.lower()] = value


BARE_HEADS = ("GETSTARTPOSES",)
"""Commands without keys."""
_SEGMENT = re.compile(r"\{\s*([^\s{}]+)\s*([^{}]*)\}")


@dataclass
class Completer:
    """Completes lines.

    Attributes:
        knowledge: Knowledge of the robot.
        classes: Robot classes, once they are known.
        client: Address of the picture client as an image server names it, for `{Client ...}`.
    """

    knowledge: Knowledge
    classes: Sequence[str] = ()
    client: str = ""
    _heads: list[str] = field(default_factory=heads)

    def complete(self, text: str) -> list[str]:
        """Return the lines that a line may become by its next word, the likeliest first."""
        head, space, rest = text.partition(" ")
        if not space:
            # A head without keys is a whole line, so no blank waits for one.
            return [found if found in BARE_HEADS else f"{found} " for found in _fitting(self._heads, head)]
        head = head.upper()
        _, brace, inside = rest.rpartition("{")
        if not brace or "}" in inside:
            return [f"{text.rstrip()} {{{key} " for key in self._keys(head, text)]
        start = text[: len(text) - len(inside)]
        key, gap, value = inside.partition(" ")
        if not gap:
            return [f"{start}{found} " for found in _fitting(self._keys(head, text[: len(start) - 1]), key)]
        values = self._values(head, key, text[: len(start) - 1])
        return [f"{start}{key} {found}}}" for found in _fitting(values, value.strip())]

    def _keys(self, head: str, before: str) -> list[str]:
        """Return the keys that may come next, without those that the line has."""
        known = list(self.knowledge.names("Joint")) if head == "MULTIDRIVE" else list(KEYS.get(head, ()))
        had = {key.lower() for key, _ in _SEGMENT.findall(before)} - REPEATED_KEYS.get(head, frozenset())
        if head == "SET":
            known = self._set_keys(before)
        return [key for key in known if key.lower() not in had]

    def _set_keys(self, before: str) -> list[str]:
        kind = _told(before, "Type").lower()
        if kind == "camera":
            return ["Name", "FOV", "Opcode", "Params", "Robot", "Client"]
        if kind == "viewports":
            return ["Config", *VIEWPORTS]
        return ["Name", "Opcode", "Params"] if kind else list(KEYS["SET"])

    def _values(self, head: str, key: str, before: str) -> list[str]:
        known, name = self.knowledge, key.lower()
        if name in VALUES:
            return list(VALUES[name])
        if name in (port.lower() for port in VIEWPORTS):
            return [*known.names("Camera"), "Disable"]
        found: dict[str, Iterable[str]] = {
            "classname": [CLASS_PREFIX + one for one in self.classes],
            "start": known.starts,
            "location": [at for at, _ in known.starts.values()],
            "rotation": [turn for _, turn in known.starts.values()],
            "robot": [known.robot] if known.robot else [],
            "client": [self.client] if self.client else [],
            "type": self._types(head),
            "name": self._names(head, before),
            "opcode": self._opcodes(before),
            "link": [str(number) for number in known.packages.get(_told(before, "Name"), {})],
        }
        return list(found.get(name, ()))

    def _types(self, head: str) -> list[str]:
        learned = [kind for kind in self.knowledge.items if kind not in ASKED_TYPES]
        if head == "SET":
            return [*learned, "Camera", "Effecter", "Joint", "Viewports"]
        return [*ASKED_TYPES, *learned]

    def _names(self, head: str, before: str) -> list[str]:
        if head == "INIT":
            return []
        types = {"DRIVE": "Joint", "MISPKG": "MisPkg"}
        return self.knowledge.names(types.get(head) or _told(before, "Type"))

    def _opcodes(self, before: str) -> list[str]:
        kind, name = _told(before, "Type").lower(), _told(before, "Name").lower()
        if name in self.knowledge.opcodes:
            return self.knowledge.opcodes[name]
        return list(SENSOR_OPCODES.get(kind, ()))


def common_beginning(lines: Sequence[str]) -> str:
    """Return the common beginning of all lines, case ignored and as in the first."""
    count = 0
    for letters in zip(*(line.lower() for line in lines), strict=False):
        if len(set(letters)) > 1:
            break
        count += 1
    return lines[0][:count] if lines else ""


def _fitting(words: Iterable[str], begun: str) -> list[str]:
    """Return the words that begin so, case ignored; a class may be begun without its prefix."""
    begun = begun.lower()
    found = [word for word in words if word.lower().startswith(begun)]
    return found or [
        word for word in words if word.lower().removeprefix(CLASS_PREFIX.lower()).startswith(begun)
    ]


def _told(before: str, key: str) -> str:
    """Return the last value of a key in a line so far."""
    values = [value.strip() for name, value in _SEGMENT.findall(before) if name.lower() == key.lower()]
    return values[-1] if values else ""
