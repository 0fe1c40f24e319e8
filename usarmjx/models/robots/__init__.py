"""The robot classes that INIT can spawn, each a value; `ROBOTS` finds them by name.

Figures are the manual's, a data sheet's or chosen, and say so in `sources`; what follows from them is
computed. `kit`, `track_kit` and `car_kit` have what many robots share. Begin with `pioneer`. A figure that
GETGEO or GETCONF reports is held to the manual by tests: change it only with a source.
"""

from usarmjx.base.registry import Registry
from usarmjx.models.robots.airborne import AIRROBOT, PASSAROLA
from usarmjx.models.robots.cars import COOPER, HUMMER, SEDAN, SNOWSTORM
from usarmjx.models.robots.flippers import KENAF, TARANTULA
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
from usarmjx.models.robots.kurt import KURT2D, KURT3D
from usarmjx.models.robots.legged import ERS, QRIO
from usarmjx.models.robots.lisa import LISA
from usarmjx.models.robots.pioneer import OMNI_P2AT, OMNI_P2DX, P2AT, P2DX
from usarmjx.models.robots.small_wheeled import ATRVJR, STEREO_P2AT, ZERG
from usarmjx.models.robots.soryu import SORYU
from usarmjx.models.robots.station import COMSTATION
from usarmjx.models.robots.talon import RUGBOT, TALON
from usarmjx.models.robots.telemax import TELEMAX
from usarmjx.models.robots.underwater import SUBMARINE
from usarmjx.models.robots.unit_loader import UNIT_LOADER
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
for _spec in (
    P2AT,
    P2DX,
    STEREO_P2AT,
    ATRVJR,
    ZERG,
    HUMMER,
    SNOWSTORM,
    SEDAN,
    COOPER,
    KURT2D,
    KURT3D,
    LISA,
    OMNI_P2AT,
    OMNI_P2DX,
    ERS,
    QRIO,
    TARANTULA,
    TALON,
    SORYU,
    TELEMAX,
    RUGBOT,
    KENAF,
    AIRROBOT,
    PASSAROLA,
    SUBMARINE,
    COMSTATION,
    UNIT_LOADER,
):
    ROBOTS.add(_spec.name, _spec)
