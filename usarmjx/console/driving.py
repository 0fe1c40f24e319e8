"""Driving by keys and sticks: what is pressed becomes commands, as the robot steers (manual 5.2.1, 5.2.5)."""

import math
from dataclasses import dataclass, field

from usarmjx.console.camera_aim import CameraAim
from usarmjx.console.knowledge import Knowledge

SLOWEST, FASTEST, SPEED_STEP = 10.0, 100.0, 10.0
"""Speeds, in percent of what the robot can [percent]."""
STEER_STEP = 20.0
"""By so much a key steers further [percent]."""
TRACE_INTERVAL, TRACE_COLOR = 0.5, "Green"
"""How often a trace has a point [s], and its colour: SimpleUI's (manual 5.2.5.1)."""
BLIMPS = ("Passarola",)
"""Classes that call themselves RotaryWing and have keys of their own (manual 12.21.3)."""
OMNI_WHEELS = (0, 1)
"""Numbers of the wheels, front and rear, of robots that are driven wheel by wheel (manual 12.11)."""
SPEEDS = ("faster", "slower")
NO_DRIVE = "there is no DRIVE for this robot: it is moved by its joints, as MULTIDRIVE does"
NO_ROBOT = "there is no robot yet: send INIT first"


@dataclass
class Pilot:
    """Turns what is pressed into lines to send.

    Attributes:
        knowledge: What is known of the robot.
        speed: How fast a key drives [percent].
        ahead: Where it drives: 1 ahead, -1 back, 0 not, or between with a stick.
        left: How it turns: 1 to the left, -1 to the right, 0 not, or between.
        up: How it climbs, likewise.
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
        """Drive as a stick says, each from -1 to 1 of the robot's best."""
        self.ahead, self.left, self.up = ahead, left, up
        return self._drive(FASTEST)

    def go(self, ahead: float, left: float) -> list[str]:
        """Drive as an arrow says; a robot that steers by its wheels goes on and steers further."""
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
        return self._drive(self.speed) if self.ahead or self.left or self.up else []

    def toggle_light(self) -> list[str]:
        """Switch the headlight."""
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
        text = " ".join(f"{{{key} {value + 0.0:g}}}" for key, value in keys)
        return [f"DRIVE {{Normalized True}} {text}"] if keys else []

    def _keys(self, speed: float = 0.0) -> list[tuple[str, float]]:
        """Return keys of DRIVE, in percent; the signs are the wire's own (manual 9.4, 12.21.3)."""
        known, ahead, turn = self.knowledge, self.ahead * speed, self.left * speed
        steer = 100 * self.left
        if known.steering == "SkidSteered":
            wide = max(1.0, (abs(ahead) + abs(turn)) / max(speed, 1e-9))
            return [("Left", round((ahead - turn) / wide, 1)), ("Right", round((ahead + turn) / wide, 1))]
        if known.steering == "AckermanSteered":
            rear = [("RearSteer", -steer)] if known.max_rear_steer else []
            return [("Speed", ahead), ("FrontSteer", steer), *rear]
        if known.steering == "OmniDrive":
            front, back = OMNI_WHEELS
            wheels = ((front, steer / 4), (back, -steer / 4))
            return [
                pair
                for n, a in wheels
                for pair in (("WheelNumber", n), ("WheelSpeed", ahead), ("WheelSteer", a))
            ]
        if known.steering == "RotaryWing" and known.class_name in BLIMPS:
            angle = math.degrees(math.atan2(self.up, self.ahead)) / 0.9 if self.up else 0.0
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


ACTIONS = {
    "forward": lambda pilot: pilot.go(1.0, 0.0),
    "backward": lambda pilot: pilot.go(-1.0, 0.0),
    "left": lambda pilot: pilot.go(0.0, 1.0),
    "right": lambda pilot: pilot.go(0.0, -1.0),
    "straight": Pilot.straight,
    "stop": Pilot.stop,
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
    "light": Pilot.toggle_light,
    "trace": Pilot.toggle_trace,
    "flip": Pilot.flip,
}
"""What keys and buttons do."""
