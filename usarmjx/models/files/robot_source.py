"""A robot's file as MuJoCo's description, with the statements for which MuJoCo has no place."""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from usarmjx.models.files.mjcf_solids import Pose
from usarmjx.models.types.robot import Options

DriveKind = str
"""Kind of a drive: one of `DRIVE_KINDS`."""
DRIVE_KINDS = ("skid", "ackermann", "none")


@dataclass(frozen=True, kw_only=True)
class JointLimit:
    """Limits of a joint's motor.

    Attributes:
        effort: Largest torque or force [N m or N]; infinite: not stated.
        speed: Highest speed [rad/s or m/s]; infinite: not stated.
    """

    effort: float = np.inf
    speed: float = np.inf


@dataclass(frozen=True, kw_only=True)
class MimicJoint:
    """A joint that follows another one.

    Attributes:
        leader: The other joint.
        ratio: Its position over the leader's.
        offset: Its position where the leader's is 0.
    """

    leader: str
    ratio: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, kw_only=True)
class StatedDrive:
    """The drive that a plugin states.

    Attributes:
        kind: Kind of the drive.
        left: Wheel joints on the left.
        right: Wheel joints on the right.
        steering: Steering joints.
        separation: Distance of left and right wheels [m]; 0: not stated.
        radius: Radius of the wheels [m]; 0: not stated.
        max_speed: Highest speed of the robot [m/s]; infinite: not stated.
        max_turn: Highest turning rate [rad/s]; infinite: not stated.
        place: File and line of the plugin.
    """

    kind: DriveKind
    left: tuple[str, ...] = ()
    right: tuple[str, ...] = ()
    steering: tuple[str, ...] = ()
    separation: float = 0.0
    radius: float = 0.0
    max_speed: float = np.inf
    max_turn: float = np.inf
    place: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorOnLink:
    """A sensor or camera on a body of the file.

    Attributes:
        kind: Type as on the wire; `Camera` is a camera.
        name: Name of the item.
        body: Body that holds it.
        pose: Pose in the body.
        options: Settings, by the manual's ini keys.
    """

    kind: str
    name: str
    body: str
    pose: Pose
    options: Options = ()


@dataclass(kw_only=True, eq=False)
class RobotSource:
    """The content of a robot's file.

    Attributes:
        path: The file.
        name: Name that the file gives the robot.
        spec: Bodies, joints, solids, actuators.
        root: Name of the chassis' body.
        limits: Limits of joints' motors, by joint.
        motors: Joints that a controller or a transmission moves; None: the file names none.
        mimics: Joints that follow another one.
        drives: Drives that plugins state.
        sensors: Sensors and cameras.
        slippery: Bodies whose surface has no friction.
        notes: Content that is left out or mended, in words, with file and line.
    """

    path: Path
    name: str
    spec: mujoco.MjSpec
    root: str
    limits: dict[str, JointLimit] = field(default_factory=dict[str, JointLimit])
    motors: set[str] | None = None
    mimics: dict[str, MimicJoint] = field(default_factory=dict[str, MimicJoint])
    drives: list[StatedDrive] = field(default_factory=list[StatedDrive])
    sensors: list[SensorOnLink] = field(default_factory=list[SensorOnLink])
    slippery: set[str] = field(default_factory=set[str])
    notes: list[str] = field(default_factory=list[str])

    def free_name(self, name: str) -> str:
        """Return a name that the wire takes and no other sensor of the robot has."""
        return unused_name(plain_name(name) or "Sensor", {one.name for one in self.sensors}, "")


def plain_name(name: str) -> str:
    """Return a name with `_` in place of letters that the wire does not take in names."""
    # Blanks and braces separate words and segments of a message; other scripts are no ASCII.
    return "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name)


def unused_name(name: str, taken: Collection[str], between: str = "_") -> str:
    """Return a name, with `_2` or a higher number behind it if it is taken."""
    number, free = 2, name
    while free in taken:
        free, number = f"{name}{between}{number}", number + 1
    return free


def left_out(path: Path, kind: str, found: Sequence[Any]) -> str:
    """Return a note about elements of MuJoCo's description that are left out, with the line of the first."""
    names = listed([one.name or "without name" for one in found])
    return f"{place_of(path, found[0].info)}: {len(found)} {kind} are left out: {names}"


def place_of(path: Path, info: str) -> str:
    """Return the file of an element of MuJoCo's description, with its line where `info` has one."""
    # Elements of included files have line 0, keyframes none.
    line = re.fullmatch(r"line ([1-9]\d*)", info)
    return str(path) if line is None else f"{path}:{line[1]}"


def listed(names: Sequence[str], most: int = 5) -> str:
    """Return names as a text, at most some of them."""
    shown = ", ".join(map(str, names[:most]))
    return f"{shown}, ..." if len(names) > most else shown
