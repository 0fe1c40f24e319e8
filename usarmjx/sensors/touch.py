"""Touch sensor (manual 10.8)."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from usarmjx.base.backend import Array, xp
from usarmjx.base.rotations import matvec
from usarmjx.base.settings import POSITIVE
from usarmjx.base.transforms import flip_angles, flip_vector, mat_from_angles
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.compile.parts import chassis_shapes, parts_of
from usarmjx.models.compile.raster import half_lengths
from usarmjx.models.types.robot import CHASSIS
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.base import SENSORS, Sensor, SensorInput, SensorSettings
from usarmjx.sensors.ranging import BEAM_PATTERN

TOUCH_DISTANCE = 0.0047
"""Distance from the button within which a surface touches it [m] (manual 10.8.1)."""
ORIGIN_SETBACK = 0.01
"""Distance of the rays' origins behind the surface that carries the button, or behind the button [m].

Bodies in contact penetrate by a millimetre or so, and a ray that started inside a wall would only hit its far
side. A button that stands out is inside a wall when the hull is pushed against it, so its rays start in the
hull, which they pass as they do all parts of their own robot.
"""


@dataclass(frozen=True)
class TouchSettings(SensorSettings):
    """Manual 10.8.2.

    Attributes:
        diameter: Diameter of the button [m].
    """

    diameter: Annotated[float, POSITIVE] = 0.01


def button_ray_origins(diameter: float, setback: float = ORIGIN_SETBACK) -> np.ndarray:
    """Return the ray origins of a button, `setback` behind the y-z plane of its mount [m] (rays, 3).

    They are arranged like the rays of a sonar's cone: one in the centre, four at half the radius, four on the
    rim.
    """
    spots = [
        (-setback, share * math.cos(around) * diameter / 2, share * math.sin(around) * diameter / 2)
        for share, around in BEAM_PATTERN
    ]
    return np.array(spots, np.float32)


def _corners(shape: Shape) -> np.ndarray:
    """Return the lowest and the highest corner of the box around a solid (2, 3) [m]."""
    mat = mat_from_angles(*shape.rotation)
    if shape.mesh is not None:
        points = np.asarray(shape.mesh.vertices, float) @ mat.T + shape.at
        return np.stack([points.min(0), points.max(0)])
    # Half the size of a turned box along each axis.
    half = np.abs(mat) @ np.array(half_lengths(shape))
    return np.stack([np.array(shape.at) - half, np.array(shape.at) + half])


def origin_setback(at: np.ndarray, axis: np.ndarray, boxes: np.ndarray) -> float:
    """Return how far behind a button its rays start [m]: behind the hull that meets walls before it does.

    Args:
        at: The button, in the axes of the part that carries it [m] (3,).
        axis: Its direction (3,).
        boxes: Lowest and highest corners of the boxes around the part's solids [m] (boxes, 2, 3).
    """
    if not len(boxes):
        return ORIGIN_SETBACK
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (boxes - at) / axis  # inf where the line is parallel to a side, NaN where it lies in it
    # NaN, 0 / 0: the line lies in a side, so this pair of sides does not bound it.
    ends = np.where(np.isnan(ends), np.array([-np.inf, np.inf])[:, None], ends)
    enter, leave = ends.min(1).max(-1), ends.max(1).min(-1)
    met = enter <= leave
    if met.any():
        front = float(leave[met].max())
    else:  # beside or above all of them: a wall meets the foremost
        farthest = np.where(axis > 0, boxes[:, 1], boxes[:, 0])
        front = float(((farthest - at) @ axis).max())
    # Negative: the hull ends behind the button, which is inside a wall that the hull is pushed against.
    return ORIGIN_SETBACK + max(0.0, -front)


@dataclass(frozen=True, eq=False)
class Touch(Sensor):
    """Touch buttons that face along their x axis; value: 1 if touched, else 0 (mounts,)."""

    kind = "Touch"
    grouped = True
    settings_class = TouchSettings

    @cached_property
    def _spots(self) -> np.ndarray:
        """Ray origins of each button on its mount [m] (mounts, rays, 3)."""
        settings = zip(self.settings, self._setbacks.tolist(), strict=True)
        return np.stack([button_ray_origins(one.diameter, setback) for one, setback in settings])

    @cached_property
    def _setbacks(self) -> np.ndarray:
        """Distance of each button's ray origins behind it [m] (mounts,)."""
        robot = self.plan.robot
        shapes = {part.name: part.shapes for part in parts_of(robot)} | {CHASSIS: chassis_shapes(robot)}
        found: list[float] = []
        for mount in self.mounts:
            # In the wire's axes, as descriptions of robots are.
            boxes = np.array([_corners(shape) for shape in shapes.get(mount.parent, ())]).reshape(-1, 2, 3)
            ahead = mat_from_angles(*flip_angles(mount.direction))[:, 0].tolist()
            found.append(origin_setback(np.array(mount.at), np.array(flip_vector(ahead)), boxes))
        return np.array(found, np.float32)

    def rays(self, bodies: BodyPoses) -> tuple[Array, Array]:
        """Return all buttons' rays, button by button, parallel to its x axis."""
        pos, mat = self.mount_poses(bodies)
        origin = pos[:, None] + matvec(mat[:, None], self._spots)
        along = xp.broadcast_to(mat[:, None, :, 0], origin.shape)
        return origin.reshape(-1, 3), along.reshape(-1, 3)

    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once (manual 10.8.1); the robot's own parts do not count."""
        nearest = inputs.hits.distance.reshape(len(self.mounts), -1).min(-1)
        # Rays start behind the button, so their distance has the setback in it.
        return memory, (nearest < self._setbacks + TOUCH_DISTANCE).astype(xp.float32)


SENSORS.add(Touch.kind, Touch)
