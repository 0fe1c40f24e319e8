"""What sensors look like that are not hidden (HiddenSensor=False, manual 10): small boxes on their mounts.

They show where a sensor sits and where it looks, which is what the manual recommends the option for. They are
seen, by pictures and by the rays of other robots, but weigh nothing and are never touched.
"""

from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.spec.robot import Mount, RobotSpec
from usarmjx.models.spec.settings import field_name
from usarmjx.models.spec.shapes import Shape

HOUSING_SIZE = (0.02, 0.012, 0.008)
"""Half lengths of a housing: longest along the axis that the sensor looks along [m] (chosen)."""
HOUSING_RGBA = (0.95, 0.75, 0.1, 1.0)


def is_shown(mount: Mount) -> bool:
    """Whether a mount's settings show it; by default sensors are hidden (manual 10)."""
    said = [value for key, value in mount.all_options if field_name(key) == "hidden_sensor"]
    return bool(said) and said[-1] is False


def housings(robot: RobotSpec, parent: str) -> tuple[Shape, ...]:
    """Return the housings of the sensors that are shown on a part; their front is at the mount."""
    shown = [mount for mount in robot.sensors if mount.parent == parent and is_shown(mount)]
    return tuple(_housing(mount) for mount in shown)


def _housing(mount: Mount) -> Shape:
    ahead = mat_from_angles(*mount.direction)[:, 0]
    x, y, z = (float(a - HOUSING_SIZE[0] * way) for a, way in zip(mount.at, ahead, strict=True))
    return Shape(
        kind="box",
        size=HOUSING_SIZE,
        at=(x, y, z),
        rotation=mount.direction,
        surface="fixture",
        rgba=HOUSING_RGBA,
    )
