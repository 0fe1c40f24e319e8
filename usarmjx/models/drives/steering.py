"""Manual driving: values of the keys of DRIVE for motion ahead, to the left, or up.

It needs only a robot's keys and their largest values, so clients can use it too.
"""

from collections.abc import Mapping

WHEEL_SPEED, WHEEL_STEER = "WheelSpeed", "WheelSteer"
"""Prefixes of OmniDrive's numbered keys."""
ANGLES = frozenset({"FrontSteer", "RearSteer", "Rudder", "SternPlane", "XZAngle"})
"""Keys that are angles, not speeds."""
TURN_SHARE = 0.5
"""Share of their speed with which tracked robots make a full turn."""


def can_climb(keys: Mapping[str, float]) -> bool:
    """Return whether a robot with these keys of DRIVE moves up and down."""
    return bool({"AltitudeVelocity", "XZAngle", "SternPlane"} & keys.keys())


def drive_values(
    keys: Mapping[str, float], ahead: float = 0.0, left: float = 0.0, up: float = 0.0, speed: float = 1.0
) -> dict[str, float]:
    """Return values of the keys of DRIVE for a direction.

    Args:
        keys: The keys that a robot has and the largest value of each, as `Drive.full_scale`.
        ahead: Speed ahead, as a share of `speed` [-1, 1].
        left: Turn to the left [-1, 1].
        up: Speed up, for robots that fly or dive [-1, 1].
        speed: Share of the largest speeds that is used [0, 1].
    """
    shares = {
        "Left": ahead - TURN_SHARE * left,
        "Right": ahead + TURN_SHARE * left,
        "Speed": ahead,
        "FrontSteer": left,
        "RearSteer": -left,
        "LinearVelocity": ahead,
        "RotationalVelocity": -left,
        "AltitudeVelocity": up,
        "Propeller": ahead,
        "Rudder": -left,
        "SternPlane": up,
        "ThrustPropeller": ahead if ahead or not up else abs(up),
        "TailPropeller": left,
        "XZAngle": (1.0 if ahead >= 0 else -1.0) * up * (0.5 if ahead else 1.0),
    }
    wheels = sorted(key for key in keys if key.startswith(WHEEL_STEER))
    values: dict[str, float] = {}
    for key, most in keys.items():
        share, is_angle = shares.get(key, 0.0), key in ANGLES or key in wheels
        if key.startswith(WHEEL_SPEED):
            share = ahead if ahead or not left else 0.5
        elif is_angle and key in wheels:  # the first one steers, the others the other way
            share = 0.25 * (left if key == wheels[0] else -left)
        values[key] = max(-1.0, min(1.0, share)) * most * (1.0 if is_angle else speed)
    return values
