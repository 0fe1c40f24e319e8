"""Driving by keys and sticks: what is pressed becomes commands, as the robot steers (manual 5.2.1, 5.2.5)."""

import asyncio
import math
import os
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from usarmjx.base.errors import UsageError
from usarmjx.cli.console.knowledge import Knowledge, PackageLink

ANGLE_STEP_DEGREES = 10.0
"""So far a key turns the camera (manual 5.2.5.1) [degrees]."""
ZOOM_FACTOR = 0.8
"""Factor on the field of view of one step of zooming in."""
STEEP = 0.7
"""An axis counts as upright, or as lying across, if so much of it is."""

LinkAxis = tuple[float, float, float]


@dataclass
class CameraAim:
    """Aims the first camera of a robot, or its first package that can be aimed.

    Attributes:
        knowledge: Knowledge of the robot.
        targets: Last commanded angles [rad], by package and number.
    """

    knowledge: Knowledge

    def __post_init__(self) -> None:
        """Nothing has been sent anywhere yet."""
        self.targets: dict[tuple[str, int], float] = {}

    def pan(self, left: float) -> list[str]:
        """Turn the camera to the left by a number of steps."""
        # About an axis that points down (z of the wire) a positive angle turns to the right.
        return self._turn(axis=2, steps=-left)

    def tilt(self, up: float) -> list[str]:
        """Turn it up by a number of steps."""
        # About the wire's y, to the right, a positive angle lifts.
        return self._turn(axis=1, steps=up)

    def zoom(self, steps: int) -> list[str]:
        """Zoom in, or out."""
        known = self.knowledge
        name = next(iter(known.fovs), "")
        if not name:
            return []
        low, high = known.fov_limits.get(name, (0.0, math.pi))
        # By a factor, not by a difference: each step then looks alike at any zoom.
        fov = min(max(known.fovs[name] * ZOOM_FACTOR**steps, low), high)
        # Taken as done: the next key may come before the answer.
        known.fovs[name] = fov
        return [f"SET {{Type Camera}} {{Name {name}}} {{FOV {fov:.4f}}}"]

    def _turn(self, axis: int, steps: float) -> list[str]:
        package = self._package()
        for number, link in self.knowledge.packages.get(package, {}).items():
            along = link_axis(self.knowledge.packages[package], number)[axis]
            if abs(along) < STEEP:
                continue
            # A link whose axis points the other way turns the other way.
            step = math.copysign(math.radians(ANGLE_STEP_DEGREES), along) * steps
            low, high = link.limits or (-math.inf, math.inf)
            # From the last order, not from the reported angle, which lags while the camera turns.
            target = min(max(self.targets.get((package, number), link.value) + step, low), high)
            self.targets[package, number] = target
            return [f"MISPKG {{Name {package}}} {{Link {number}}} {{Value {target:.4f}}} {{Order 0}}"]
        return []

    def _package(self) -> str:
        """Return the package that carries the first camera; else one that is called after it."""
        known = self.knowledge
        for name in known.names("Camera"):
            package, link, _ = known.mounts.get(("camera", name.lower()), "").rpartition("_Link")
            if link and package in known.packages:
                return package
        return next((name for name in known.packages if "pantilt" in name.lower()), "")


def link_axis(links: dict[int, PackageLink], number: int) -> LinkAxis:
    """Return the axis of a link in the robot's frame on the wire, its package at rest."""
    # A link turns about the z axis of its own frame.
    axis: LinkAxis = (0.0, 0.0, 1.0)
    seen: set[int] = set()
    # Links come from the server: a circle of parents must not hang the console.
    while number in links and number not in seen:
        seen.add(number)
        axis = _rotate(links[number].orientation, axis)
        number = links[number].parent
    return axis


def _rotate(angles: tuple[float, ...], vector: LinkAxis) -> LinkAxis:
    """Return a vector turned by roll, pitch and yaw [rad], in this order about the fixed axes."""
    # A server may report fewer than three angles.
    roll, pitch, yaw = (*angles, 0.0, 0.0, 0.0)[:3]
    x, y, z = vector
    y, z = y * math.cos(roll) - z * math.sin(roll), y * math.sin(roll) + z * math.cos(roll)
    x, z = x * math.cos(pitch) + z * math.sin(pitch), -x * math.sin(pitch) + z * math.cos(pitch)
    x, y = x * math.cos(yaw) - y * math.sin(yaw), x * math.sin(yaw) + y * math.cos(yaw)
    return x, y, z


SLOWEST, FASTEST, SPEED_STEP = 10.0, 100.0, 10.0
"""Speeds, in percent of what the robot can [percent]."""
STEER_STEP = 20.0
"""By so much a key steers further [percent]."""
TRACE_INTERVAL, TRACE_COLOR = 0.5, "Green"
"""Interval of a trace's points [s], and its colour: SimpleUI's (manual 5.2.5.1)."""
BLIMPS = ("Passarola",)
"""Classes that call themselves RotaryWing and have keys of their own (manual 12.21.3)."""
OMNI_WHEELS = (0, 1)
"""Numbers of the wheels, front and rear, of robots that are driven wheel by wheel (manual 12.11)."""
SPEEDS = ("faster", "slower")
NO_DRIVE = "there is no DRIVE for this robot: it is moved by its joints, as MULTIDRIVE does"
NO_ROBOT = "there is no robot yet: send INIT first"


@dataclass
class KeyDriver:
    """Turns what is pressed into lines to send.

    Attributes:
        knowledge: Knowledge of the robot.
        speed: Speed of a key [percent].
        ahead: Direction: 1 ahead, -1 back, 0 not, or between with a stick.
        left: Turn: 1 to the left, -1 to the right, 0 not, or between.
        up: Climb, likewise.
        camera: Aims its camera.
    """

    knowledge: Knowledge
    speed: float = 40.0
    ahead: float = 0.0
    left: float = 0.0
    up: float = 0.0
    is_traced: bool = False
    camera: CameraAim = field(init=False)

    def __post_init__(self) -> None:
        """Take the camera's keys."""
        self.camera = CameraAim(self.knowledge)

    def press(self, name: str) -> list[str]:
        """Return the lines of one of `ACTIONS`; without a robot nothing but the speed can be set."""
        return ACTIONS[name](self) if self.knowledge.has_robot or name in SPEEDS else []

    def problem(self) -> str:
        """Return why nothing can be driven now; "" if it can."""
        if not self.knowledge.has_robot:
            return NO_ROBOT
        return "" if self._keys() else NO_DRIVE

    def steer(self, ahead: float, left: float, up: float = 0.0) -> list[str]:
        """Drive by the deflections of a stick, each from -1 to 1 of the robot's best."""
        self.ahead, self.left, self.up = ahead, left, up
        # A stick's deflection is itself the share of the full speed: the keys' speed does not count.
        return self._drive(FASTEST)

    def go(self, ahead: float, left: float) -> list[str]:
        """Drive by an arrow key; a robot that steers by its wheels goes on and steers further."""
        if self._steers():
            self.ahead = ahead or self.ahead
            self.left = max(-1.0, min(1.0, self.left + left * STEER_STEP / 100)) if left else self.left
        else:
            self.ahead, self.left = ahead, left
        return self._drive(self.speed)

    def climb(self, up: float) -> list[str]:
        """Go up or down, of those that fly or dive."""
        self.up = up
        return self._drive(self.speed)

    def straight(self) -> list[str]:
        """Steer no more."""
        self.left = 0.0
        return self._drive(self.speed)

    def stop(self) -> list[str]:
        """Stand still."""
        self.ahead = self.left = self.up = 0.0
        return self._drive(self.speed)

    def change_speed(self, step: float) -> list[str]:
        """Drive faster or slower from now on."""
        self.speed = max(SLOWEST, min(FASTEST, self.speed + step))
        # A robot that stands needs no order: the speed counts from the next key on.
        return self._drive(self.speed) if self.ahead or self.left or self.up else []

    def toggle_light(self) -> list[str]:
        """Switch the headlight."""
        # The wire has True and False as Python writes them.
        return [f"DRIVE {{Light {not self.knowledge.light}}}"]

    def toggle_trace(self) -> list[str]:
        """Begin or end a trace."""
        self.is_traced = not self.is_traced
        rest = f" {{Interval {TRACE_INTERVAL:g}}} {{Color {TRACE_COLOR}}}" if self.is_traced else ""
        return [f"TRACE {{On {self.is_traced}}}{rest}"]

    def flip(self) -> list[str]:
        """Turn the robot back on its wheels."""
        return ["DRIVE {Flip True}"]

    def _steers(self) -> bool:
        return self.knowledge.steering in ("AckermanSteered", "OmniDrive", "VariableDepth")

    def _drive(self, speed: float) -> list[str]:
        keys = self._keys(speed)
        # Plus 0.0, which turns -0.0 into 0.0: it would be printed as -0.
        text = " ".join(f"{{{key} {value + 0.0:g}}}" for key, value in keys)
        return [f"DRIVE {{Normalized True}} {text}"] if keys else []

    def _keys(self, speed: float = 0.0) -> list[tuple[str, float]]:
        """Return keys of DRIVE, in percent; the signs are the wire's own (manual 9.4, 12.21.3)."""
        known, ahead, turn = self.knowledge, self.ahead * speed, self.left * speed
        steer = 100 * self.left
        if known.steering == "SkidSteered":
            # Both wheels by one factor: the curve stays the same where one would exceed the speed.
            # The speed is 0 where only the names of the keys matter, as in `problem`.
            wide = max(1.0, (abs(ahead) + abs(turn)) / max(speed, 1e-9))
            return [("Left", round((ahead - turn) / wide, 1)), ("Right", round((ahead + turn) / wide, 1))]
        if known.steering == "AckermanSteered":
            # Rear wheels turn against the front ones, so that both bend the path the same way.
            rear = [("RearSteer", -steer)] if known.max_rear_steer else []
            return [("Speed", ahead), ("FrontSteer", steer), *rear]
        if known.steering == "OmniDrive":
            front, back = OMNI_WHEELS
            # A quarter of the lock: wheels that turn against each other double the curve.
            wheels = ((front, steer / 4), (back, -steer / 4))
            return [
                pair
                for n, a in wheels
                for pair in (("WheelNumber", n), ("WheelSpeed", ahead), ("WheelSteer", a))
            ]
        if known.steering == "RotaryWing" and known.class_name in BLIMPS:
            # In percent of 90 degrees.
            angle = math.degrees(math.atan2(self.up, self.ahead)) / 0.9 if self.up else 0.0
            # A climb needs thrust even where no key drives ahead.
            thrust = speed if self.up else ahead
            return [("XZAngle", round(angle, 1)), ("ThrustPropeller", thrust), ("TailPropeller", turn)]
        if known.steering == "RotaryWing":
            return [
                ("LinearVelocity", ahead),
                ("RotationalVelocity", -turn),
                ("AltitudeVelocity", self.up * speed),
                ("LateralVelocity", 0.0),
            ]
        if known.steering == "VariableDepth":
            return [("Propeller", ahead), ("Rudder", -steer), ("SternPlane", 100 * self.up)]
        return []


ACTIONS: dict[str, Callable[[KeyDriver], list[str]]] = {
    "forward": lambda pilot: pilot.go(1.0, 0.0),
    "backward": lambda pilot: pilot.go(-1.0, 0.0),
    "left": lambda pilot: pilot.go(0.0, 1.0),
    "right": lambda pilot: pilot.go(0.0, -1.0),
    "straight": KeyDriver.straight,
    "stop": KeyDriver.stop,
    "faster": lambda pilot: pilot.change_speed(SPEED_STEP),
    "slower": lambda pilot: pilot.change_speed(-SPEED_STEP),
    "up": lambda pilot: pilot.climb(1.0),
    "down": lambda pilot: pilot.climb(-1.0),
    "level": lambda pilot: pilot.climb(0.0),
    "tilt_up": lambda pilot: pilot.camera.tilt(1),
    "tilt_down": lambda pilot: pilot.camera.tilt(-1),
    "pan_left": lambda pilot: pilot.camera.pan(1),
    "pan_right": lambda pilot: pilot.camera.pan(-1),
    "zoom_in": lambda pilot: pilot.camera.zoom(1),
    "zoom_out": lambda pilot: pilot.camera.zoom(-1),
    "light": KeyDriver.toggle_light,
    "trace": KeyDriver.toggle_trace,
    "flip": KeyDriver.flip,
}
"""Actions of keys and buttons."""


FOLDER = Path("/dev/input")
# The machine's byte order without padding, as the kernel packs the structure.
EVENT = struct.Struct("=IhBB")
"""An event of the system: time [ms], value, kind, number (joystick-api.txt of the Linux kernel)."""
BUTTON, AXIS, AT_FIRST = 0x01, 0x02, 0x80
"""Kinds of events; `AT_FIRST` is added where it tells how things are when the file is opened."""
FULL = 32767
"""Value of an axis all the way."""
DEAD_ZONE = 0.15
"""A stick that is out of its middle by less rests there."""
ROUNDED = 20
"""Steps to which deflections are rounded, so that a trembling stick sends nothing."""
TURN_AXIS, DRIVE_AXIS, CLIMB_AXIS, PAN_AXIS, TILT_AXIS = 0, 1, 3, 6, 7
"""Numbers of the axes: the stick, the second one up and down, and the POV button."""
BUTTONS = {0: "stop", 1: "light", 2: "zoom_in", 3: "zoom_out"}
"""Actions of a joystick's buttons."""


def find_joystick(folder: Path = FOLDER) -> Path | None:
    """Return the first joystick that can be read; None: there is none."""
    # Device files belong to a group: the search must not end at one that this user may not read.
    return next((path for path in sorted(folder.glob("js[0-9]*")) if os.access(path, os.R_OK)), None)


@dataclass
class JoystickDriver:
    """Turns a joystick's events into lines to send.

    Attributes:
        pilot: Drives.
        axes: Deflections of axes, by number.
    """

    pilot: KeyDriver
    axes: dict[int, float] = field(default_factory=dict[int, float])
    _rest: bytes = b""

    def feed(self, data: bytes) -> list[str]:
        """Take bytes of the device; return what to send."""
        data = self._rest + data
        # A read may end within an event.
        whole = len(data) - len(data) % EVENT.size
        self._rest = data[whole:]
        before, lines = self._deflection(), list[str]()
        for _, value, kind, number in EVENT.iter_unpack(data[:whole]):
            lines += self._take(value, kind, number)
        # Once for the whole read: a stick that moves sends many events.
        after = self._deflection()
        return (self.pilot.steer(*after) if after != before else []) + lines

    def _take(self, value: int, kind: int, number: int) -> list[str]:
        if kind & ~AT_FIRST == AXIS:
            self.axes[number] = value / FULL
            # Opening the file tells all positions, which nobody has pressed just now.
            if not kind & AT_FIRST and abs(value) > FULL / 2:
                if number == PAN_AXIS:
                    return self.pilot.press("pan_right" if value > 0 else "pan_left")
                if number == TILT_AXIS:
                    return self.pilot.press("tilt_down" if value > 0 else "tilt_up")
        elif kind == BUTTON and value and number in BUTTONS:
            return self.pilot.press(BUTTONS[number])
        return []

    def _deflection(self) -> tuple[float, float, float]:
        """Return the deflections ahead, to the left and up, -1 to 1; axes are positive right and back."""
        ahead, left, up = (self._axis(number) for number in (DRIVE_AXIS, TURN_AXIS, CLIMB_AXIS))
        return -ahead, -left, -up

    def _axis(self, number: int) -> float:
        value = self.axes.get(number, 0.0)
        return 0.0 if abs(value) < DEAD_ZONE else round(value * ROUNDED) / ROUNDED


class JoystickDevice:
    """A joystick's device file, read by the event loop.

    Args:
        path: The file.
        take: Takes its bytes; none when it has gone.

    Raises:
        UsageError: It cannot be read.
    """

    def __init__(self, path: Path, take: Callable[[bytes], None]) -> None:
        try:
            # A read in the event loop must never wait.
            self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise UsageError(f"--joystick: cannot read {path}: {error.strerror}") from error
        self._take, self._loop = take, asyncio.get_running_loop()
        self._loop.add_reader(self._file, self._read)
        self._is_open = True

    def _read(self) -> None:
        try:
            data = os.read(self._file, EVENT.size * 64)
        except BlockingIOError:
            # The loop may be woken for nothing.
            return
        except OSError:
            data = b""
        # An end stays readable: the loop would call this again at once, for ever.
        if not data:
            self.close()
        self._take(data)

    def close(self) -> None:
        """Close the file."""
        if self._is_open:
            self._is_open = False
            # Out of the loop first: the system gives the number of a closed file to the next one.
            self._loop.remove_reader(self._file)
            os.close(self._file)


def joystick_path(option: str, found: Callable[[], Path | None] = find_joystick) -> Path | None:
    """Return the joystick that an option asks for: `auto`, `off`, or a file; None: none.

    Raises:
        UsageError: There is no such file.
    """
    if option == "off":
        return None
    if option == "auto":
        return found()
    if not Path(option).exists():
        raise UsageError(f"--joystick: no {option!r}; expected auto, off or a device as /dev/input/js0")
    return Path(option)
