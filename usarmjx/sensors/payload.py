"""What a robot carries, against what it can (manual 10, footnote 3)."""

from usarmjx.models.effecters import effecters_of
from usarmjx.models.spec.robot import Mount, RobotSpec
from usarmjx.models.spec.settings import resolve_settings
from usarmjx.sensors.base import SENSORS, SensorSettings
from usarmjx.sensors.settings import CameraSettings


def carried_weight(robot: RobotSpec) -> float:
    """Return the weight of all sensors, cameras and effecters of a robot class [kg].

    It adds to no body: what an item really weighs is in the solids of its part (manual 10, footnote 3).

    Raises:
        UnknownNameError: An item of an unknown type or with an unknown setting.
    """
    weights = [_weight(mount, SENSORS.get(mount.kind).settings_class) for mount in robot.sensors]
    weights += [_weight(mount, CameraSettings) for mount in robot.cameras]
    weights += [effecter.settings.weight for effecter in effecters_of(robot)]
    return float(sum(weights))


def _weight(mount: Mount, kind: type[object]) -> float:
    settings = resolve_settings(kind, mount.all_options, f"{mount.kind} {mount.name}")
    return getattr(settings, "weight", SensorSettings.weight)


def overload(robot: RobotSpec) -> str:
    """Return what is wrong if a robot carries more than its payload, else "".

    A payload of 0 is one that nobody knows.
    """
    load = carried_weight(robot)
    if not robot.payload or load <= robot.payload + 1e-9:
        return ""
    items = len(robot.sensors) + len(robot.cameras) + len(robot.effecters)
    return f"{robot.name} carries {load:.2f} kg of {items} items, its payload is {robot.payload:.2f} kg"
