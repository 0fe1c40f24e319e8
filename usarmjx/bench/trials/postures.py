"""What the joints of robots with flippers do while they are driven over obstacles."""

from collections.abc import Callable

from usarmjx.models.spec.robot import RobotSpec

Posture = Callable[[float], dict[str, float]]
"""From the pitch [rad], nose up positive, to angles of joints [rad]."""
FRONT, REAR = ("FRFlipper", "FLFlipper"), ("RRFlipper", "RLFlipper")
RAISED = -0.6
"""Front flippers on level ground: tips up, to get onto what is ahead [rad]."""
STEEPEST = 0.6
"""Pitch from which on flippers do not move further [rad]."""


def crawl(pitch: float) -> dict[str, float]:
    """Return flippers that are up ahead on level ground, flat in front and pressed down behind in a climb."""
    climb = min(max(pitch, 0.0), STEEPEST)
    return dict.fromkeys(FRONT, RAISED + climb) | dict.fromkeys(REAR, -0.8 * climb)


def posture_of(robot: RobotSpec) -> Posture | None:
    """Return what a class does on the way; None: it has no flippers."""
    return crawl if {*FRONT, *REAR} <= {part.name for part in robot.parts} else None
