"""The robot classes that INIT can spawn, each a value; `ROBOTS` finds them by name.

Numbers are the manual's, a data sheet's or chosen, as `sources` states; derived ones are computed. Every
public `RobotSpec` of a module here is registered: a new robot is one file. `kit` has the
parts that many robots share. Begin with `pioneer`. Tests hold the numbers that GETGEO or GETCONF
report to the manual: change one only with a source.
"""

import sys

from usarmjx.base.registry import Registry, values_in
from usarmjx.models.robots.kit import (
    POSE_SENSORS,
    ball,
    block,
    camera,
    drum,
    hull,
    mirrored,
    pan_tilt,
    prism,
    rod,
    sick,
    sick_lms200,
    wheel,
)
from usarmjx.models.types.robot import RobotSpec

__all__ = [
    "POSE_SENSORS",
    "ROBOTS",
    "ball",
    "block",
    "camera",
    "drum",
    "hull",
    "mirrored",
    "pan_tilt",
    "prism",
    "rod",
    "sick",
    "sick_lms200",
    "wheel",
]

ROBOTS: Registry[RobotSpec] = Registry("robot")
"""Robot classes by the name that INIT gives them."""
for _spec in values_in(sys.modules[__name__], RobotSpec):
    ROBOTS.add(_spec.name, _spec)
