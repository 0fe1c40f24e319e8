"""The robot classes that INIT can spawn."""

from usarmjx.models.robots.pioneer import P2AT, P2DX
from usarmjx.models.spec import RobotSpec
from usarmjx.registry import Registry

ROBOTS: Registry[RobotSpec] = Registry("robot")
for _spec in (P2AT, P2DX):
    ROBOTS.add(_spec.name, _spec)
