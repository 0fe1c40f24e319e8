"""Object sensor of USARSim's later versions, after ObjectSensor.uc (`hrnr/robocup-usarsim`).

It is a range scanner whose message names the objects that its beams meet; a served world looks them up.
"""

from dataclasses import dataclass
from typing import Annotated

from usarmjx.base.settings import POSITIVE
from usarmjx.models.types.robot import ANGLE_STEP, TURN
from usarmjx.sensors.base import SENSORS
from usarmjx.sensors.ranging import RangeScanner, ScannerSettings


@dataclass(frozen=True)
class ObjectSensorSettings(ScannerSettings):
    """Keys of `[USARSensor.ObjectSensor]`, with the range scanner's values of the later DefaultUSAR.ini.

    Attributes:
        scan_interval: Time between scans [s]; 0 is manual mode: scan on the SCAN command only.
        max_range: Length of the beams [m].
        resolution: Angle between two beams [rad].
        scan_fov: Angle from the first beam to the last [rad].
    """

    scan_interval: float = 0.2
    max_range: Annotated[float, POSITIVE] = 4.0
    resolution: Annotated[float, ANGLE_STEP] = 0.157
    scan_fov: Annotated[float, TURN] = 3.14


@dataclass(frozen=True, eq=False)
class ObjectSensor(RangeScanner):
    """Scanner that names what its beams meet; value: ranges [m] (beams,).

    The message of a served world has the objects in place of the ranges.
    """

    kind = "ObjectSensor"
    names_objects = True
    settings_class = ObjectSensorSettings


SENSORS.add(ObjectSensor.kind, ObjectSensor)
