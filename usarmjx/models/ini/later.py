"""Ini files of USARSim's later versions, on the Unreal Development Kit, in the terms of the manual's.

Their `DefaultUSAR.ini` has sensors in sections `[USARSensor.X]`, mounts all items by `AddParts`, and has
other classes of robots and sections of the game. Names with the same meaning are renamed; of the rest each
class is named once, with the reason.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import replace

from usarmjx.models.ini.items import LATER_ITEM_CLASSES, WarningLog, kind_of
from usarmjx.models.ini.parse import IniFile, IniValue, Line, Reference, Section, Struct

ITEM_PACKAGES = ("usarsensor.", "usaractuator.", "usareffector.", "usareffecter.", "usarcamera.")
"""Packages of items in the later versions."""
LATER_ROBOTS = {"p3at": "P2AT"}
"""Robots of the later versions with another name."""
LATER_ITEMS = {
    "odometry": "OdometrySensor",
    "encoder": "EncoderSensor",
    "gpssensor_fixed": "GPSSensor",
    "touch": "TouchSensor",
    "ir2sensor": "IRSensor",
    "imu": "AHRS",
    "battery": "Battery",
    "magneticcompass": "MagneticCompass",
    "kinectdepth": "Kinect",
    "rotatingpointcloudscanner": "PCL",
}
"""Classes of items of the later versions with another name."""
OWN_KINDS = (
    *("AHRS", "Battery", "MagneticCompass", "Tachometer", "AltitudeSensor", "MissionTime"),
    *("LineLaser", "Kinect", "ObjectSensor", "PCL"),
)
"""Types that the manual has no class of."""

WHEELS = {"P2AT": ("RightFWheel", "LeftFWheel", "RightRWheel", "LeftRWheel")}
"""Wheels of a class in the order of their numbers in the later versions (P3AT.uc)."""
ACROSS = Struct((("X", 0.0), ("Y", 0.0), ("Z", -math.pi / 2)))
"""Direction of an encoder that counts a wheel's way ahead: along its axle to the left."""
_WHEEL_NUMBER = re.compile(r"W(\d)")
SENT = "the dialect of the connection decides which keys a reading has"
LATER_IGNORED = {
    "bwithtimestamp": SENT,
    "busegroup": SENT,
    "bsendrange": SENT,
    "hiddensensor": "robots look as their solids do: there are no Unreal meshes to hide",
    "numberofcones": "a sonar's rays fill its cone",
    "tracespercone": "a sonar's rays fill its cone",
    "mass": "weights of items are for the payload only; Weight is the manual's key",
    "maxenergy": "STA counts seconds: BatteryLife of the robot's section",
    "currentenergy": "STA counts seconds: BatteryLife of the robot's section",
    "batterylife": "it is a key of the robot's section",
    "scanrate": "a point cloud scanner measures a row for each message: ScanInterval",
    "drifting": "INS drifts as Sigma and Mean say",
    "squaresize": "pictures show a laser's points as balls",
    "linespace": "pictures show a laser's points as balls",
    "ispointonlinevariance": "pictures show a laser's points as balls",
}
"""Keys of items of the later versions without effect, with the reason."""
LATER_KEYS = {("sonarsensor", "maxangleofincidence"): "MaxIncidence", ("linelaser", "resolution"): "Beams"}
"""Keys of items of the later versions with another name, by class and key in lower case."""
FOREIGN = {
    "usarbotapi.": "the server's settings are options of `usarmjx serve`",
    "botapi.": "the server's settings are options of `usarmjx serve`",
    "usarutility.": "units and axes of the wire are fixed: metres, radians, z down",
    "utgame.": "it is about the Unreal game",
    "engine.": "it is about the Unreal engine",
}
"""Reasons for sections that are not about robots, by their package."""


def reason_of_section(name: str) -> str:
    """Return the reason why a section is ignored; empty: it is not about robots."""
    return next((why for prefix, why in FOREIGN.items() if name.lower().startswith(prefix)), "")


def translated(files: Sequence[IniFile], robots: Sequence[str], notes: WarningLog) -> tuple[IniFile, ...]:
    """Return the files with the later versions' names in the manual's terms; others are unchanged.

    Args:
        files: The files.
        robots: Names of robot classes that exist.
        notes: Log of warnings.
    """
    return tuple(_Translation(file, robots, notes).file() for file in files)


class _Translation:
    """Translation of one file.

    Args:
        file: The file.
        robots: Names of robot classes that exist.
        notes: Log of warnings.
    """

    def __init__(self, file: IniFile, robots: Sequence[str], notes: WarningLog) -> None:
        self._file, self._notes = file, notes
        self._robots = {name.lower() for name in robots}
        self._left_out: dict[str, tuple[Line, int]] = {}
        self._derived: dict[str, Line] = {}

    def file(self) -> IniFile:
        """Return the file in the manual's terms."""
        sections = [part for section in self._file.sections if (part := self._section(section)) is not None]
        for name, line in self._derived.items():
            base = replace(line, key="BaseClass", value=name, adds=False, index=None)
            sections.append(Section(f"USARBot.{name}", (base,)))
        for name, (line, count) in self._left_out.items():
            times = f", {count} lines" if count > 1 else ""
            self._notes.add(line, f"{name} is left out{times}: usarmjx has no such class")
        return replace(self._file, sections=tuple(sections))

    def _section(self, section: Section) -> Section | None:
        """Return a section in the manual's terms; None: it is left out."""
        package, _, name = section.name.lower().partition(".")
        if f"{package}." in ITEM_PACKAGES:
            return self._item_section(section, name)
        if package != "usarbot":
            return section
        name = section.name.partition(".")[2]
        ours = LATER_ROBOTS.get(name.lower(), name)
        lines = tuple(self._part(line, ours) for line in section.lines)
        lines = tuple(line for line in lines if line is not None)
        if ours != name and name.lower() not in self._robots and lines:
            self._notes.add(lines[0], f"{name} is the later versions' name of {ours}")
            return replace(section, name=f"USARBot.{ours}", lines=lines)
        return replace(section, lines=lines)

    def _item_section(self, section: Section, name: str) -> Section | None:
        if not section.lines:
            return None
        if name == "sensor":
            self._notes.add(
                section.lines[0], f"[{section.name}] is left out: each class of sensors has its own defaults"
            )
            return None
        ours = self._class(section.name.partition(".")[2])
        if ours is None:
            self._note_left_out(section.name, section.lines[0])
            return None
        lines: list[Line] = []
        for line in section.lines:
            key = line.key.lower()
            if key in LATER_IGNORED:
                self._notes.add(line, f"{line.key} is ignored: {LATER_IGNORED[key]}")
            else:
                lines.append(replace(line, key=LATER_KEYS.get((name, key), line.key)))
        if name in LATER_ITEM_CLASSES:
            self._derived.setdefault(ours, section.lines[0])
        return replace(section, name=f"USARBot.{ours}", lines=tuple(lines))

    def _class(self, name: str) -> str | None:
        """Return our class of a later version's class of items; None: there is none."""
        lowered = name.lower()
        if lowered in LATER_ITEMS:
            return LATER_ITEMS[lowered]
        own = lowered in LATER_ITEM_CLASSES or lowered in map(str.lower, OWN_KINDS)
        return name if own or kind_of(name, None) is not None else None

    def _part(self, line: Line, robot: str) -> Line | None:
        """Return a line with a list of a robot's items in our terms; None: its class is left out."""
        if line.key.lower() != "addparts" or not isinstance(line.value, Struct):
            return line
        written = line.value.get("ItemClass")
        full = written.name if isinstance(written, Reference) else str(written)
        package, _, name = full.rpartition(".")
        ours = self._class(name) if f"{package.lower()}." in (*ITEM_PACKAGES, "usarbot.", ".") else None
        parent = line.value.get("Parent")
        if ours is None or (isinstance(parent, str) and parent.lower().startswith("usarmispkg.")):
            self._note_left_out(full if ours is None else f"{full} on {parent}", line)
            return None
        kept: list[tuple[str, IniValue]] = [("ItemClass", ours)]
        for key, value in line.value.fields:
            on_robot = key.lower() == "parent" and str(value).lower().startswith("usarbot.")
            if key.lower() != "itemclass" and not on_robot:
                kept.append((key, value))
        if line.value.get("ItemName") is None:
            kept.append(("ItemName", name))
        if ours == LATER_ITEMS["encoder"] and package.lower() == "usarsensor":
            wheel = _wheel_of(robot, str(line.value.get("ItemName", "")))
            if wheel is None:
                self._note_left_out(f"{full} of no known wheel", line)
                return None
            own = ("parent", "position", "direction")
            kept = [(key, value) for key, value in kept if key.lower() not in own]
            kept += [("Parent", wheel), ("Direction", ACROSS)]
        return replace(line, key=_list_of(ours), value=Struct(tuple(kept)), adds=False)

    def _note_left_out(self, name: str, line: Line) -> None:
        first, count = self._left_out.get(name, (line, 0))
        self._left_out[name] = first, count + 1


def _wheel_of(robot: str, name: str) -> str | None:
    """Return the wheel whose number is in an encoder's name, such as EncTestW1 (Encoder.uc); None: none."""
    found, wheels = _WHEEL_NUMBER.search(name), WHEELS.get(robot, ())
    number = int(found[1]) if found else len(wheels)
    return wheels[number] if number < len(wheels) else None


def _list_of(item: str) -> str:
    """Return the key that adds items of a class to a robot."""
    kind = kind_of(item, None)
    if kind == "Camera":
        return "AddCameras"
    return "AddEffecters" if kind in ("Gripper", "RFIDReleaser", "RollerTable") else "AddSensors"
