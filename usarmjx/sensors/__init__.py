"""Sensors: what each type measures on one robot, as pure functions that a batch maps over robots and worlds.

A type is a subclass of `Sensor` with a settings class, added to `SENSORS`; it reads with the arrays of `xp`,
NumPy in a served world and JAX in a batch. `suite_of` is all sensors of a robot class, each read when it is
due. `usarmjx.sensors.cameras` is a face of its own; `rays` is the private ray caster. A new type is one
module and needs nothing else (docs/own-sensor.md). Nothing here knows worlds, groups or the wire. Begin with
`base`, then `ranging`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.base.backend import fori_loop as fori_loop
    from usarmjx.base.backend import set_at as set_at
    from usarmjx.base.backend import vmap as vmap
    from usarmjx.base.backend import xp as xp
    from usarmjx.base.random import normal as normal
    from usarmjx.base.random import uniform as uniform
    from usarmjx.base.transforms import angles_from_mat as angles_from_mat
    from usarmjx.base.transforms import mat_from_angles as mat_from_angles
    from usarmjx.sensors.base import NoisySensorSettings as NoisySensorSettings
    from usarmjx.sensors.base import OutputCurve as OutputCurve
    from usarmjx.sensors.base import Quantity as Quantity
    from usarmjx.sensors.base import Reading as Reading
    from usarmjx.sensors.base import Sensor as Sensor
    from usarmjx.sensors.base import SensorInput as SensorInput
    from usarmjx.sensors.base import SensorSettings as SensorSettings
    from usarmjx.sensors.base import apply_output_curve as apply_output_curve
    from usarmjx.sensors.base import noisy as noisy
    from usarmjx.sensors.base import vectorized as vectorized
    from usarmjx.sensors.ranging import Ir as Ir
    from usarmjx.sensors.ranging import IrScanner as IrScanner
    from usarmjx.sensors.ranging import IrScannerSettings as IrScannerSettings
    from usarmjx.sensors.ranging import IrSettings as IrSettings
    from usarmjx.sensors.ranging import Lidar as Lidar
    from usarmjx.sensors.ranging import LidarSettings as LidarSettings
    from usarmjx.sensors.ranging import RangeScanner as RangeScanner
    from usarmjx.sensors.ranging import RangeScanner3D as RangeScanner3D
    from usarmjx.sensors.ranging import Scanner3DSettings as Scanner3DSettings
    from usarmjx.sensors.ranging import ScannerSettings as ScannerSettings
    from usarmjx.sensors.ranging import Sonar as Sonar
    from usarmjx.sensors.ranging import SonarSettings as SonarSettings
    from usarmjx.sensors.suite import SENSORS as SENSORS
    from usarmjx.sensors.suite import Suite as Suite
    from usarmjx.sensors.suite import suite_of as suite_of
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.base.backend": ("fori_loop", "set_at", "vmap", "xp"),
            "usarmjx.base.random": ("normal", "uniform"),
            "usarmjx.base.transforms": ("angles_from_mat", "mat_from_angles"),
            "usarmjx.sensors.base": (
                "NoisySensorSettings",
                "OutputCurve",
                "Quantity",
                "Reading",
                "Sensor",
                "SensorInput",
                "SensorSettings",
                "apply_output_curve",
                "vectorized",
                "noisy",
            ),
            "usarmjx.sensors.ranging": (
                "Ir",
                "IrScanner",
                "IrScannerSettings",
                "IrSettings",
                "Lidar",
                "LidarSettings",
                "RangeScanner",
                "RangeScanner3D",
                "Scanner3DSettings",
                "ScannerSettings",
                "Sonar",
                "SonarSettings",
            ),
            "usarmjx.sensors.suite": ("SENSORS", "Suite", "suite_of"),
        },
    )
