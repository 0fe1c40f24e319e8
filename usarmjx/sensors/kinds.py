"""The modules that fill `base.SENSORS`: whoever imports this one has all types of sensors."""

from usarmjx.sensors import (
    co2,
    gps,
    human_motion,
    inertial,
    lidar,
    motion,
    power,
    ranging,
    rfid,
    scanners,
    sound,
    touch,
    victim,
)
from usarmjx.sensors.base import SENSORS

__all__ = ["SENSORS", "SENSOR_MODULES"]

SENSOR_MODULES = (
    *(co2, gps, human_motion, inertial, lidar, motion, power),
    *(ranging, rfid, scanners, sound, touch, victim),
)
"""One for each family of sensors."""
