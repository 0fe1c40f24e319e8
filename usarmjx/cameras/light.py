"""What lights a world: the sun or an arena's lamps, and the robots' headlights."""

import math
from collections.abc import Sequence

import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.transforms import Vec3
from usarmjx.models.spec.arena import Light

AMBIENT, DIFFUSE = 0.45, 0.6
"""Daylight from everywhere, and that of the sun on what faces it."""
INDOOR_AMBIENT = 0.3
"""Light from everywhere in an arena with lamps."""
INDOOR_GAIN = 2.5
"""By how much cameras brighten what is dark where there are lamps (chosen); see `developed`."""
SUN_DIRECTION: Vec3 = (0.45, 0.35, 0.82)
"""Direction to the sun; need not be a unit vector."""
AMBIENT_GRADIENT = np.array([0.12, -0.08, 0.2], np.float32) / AMBIENT
"""By which share light from everywhere changes with a surface's slope, so that sides in shadow differ."""
MIN_LIGHT_DISTANCE = 0.25
"""What is nearer to a light than this is lit as at this distance [m]."""
SPOT_OUTER_ANGLE, SPOT_INNER_ANGLE = math.radians(30.0), math.radians(20.0)
"""Half the opening of a headlight's cone, and within which it is at its brightest (chosen) [rad]."""
HEADLIGHT_BRIGHTNESS = 2.0
"""Brightness of a headlight at 1 m, as `Light.brightness` (chosen)."""


class PointLights(struct.PyTreeNode, kw_only=True):
    """An arena's lamps.

    Attributes:
        pos: Where they are, in the world [m] (n, 3).
        rgb: Colour times brightness at 1 m; zero for those that there are not (n, 3).
    """

    pos: Array
    rgb: Array


class Headlights(struct.PyTreeNode, kw_only=True):
    """The robots' headlights.

    Attributes:
        pos: Where they are [m] (n, 3).
        direction: Where they shine, unit vectors (n, 3).
        on: Which shine (n,).
        label: Label of the robot, which does not stand in the way of its own light (n,).
    """

    pos: Array
    direction: Array
    on: Array
    label: Array


def no_headlights() -> Headlights:
    """Return none."""
    none = np.zeros((0, 3), np.float32)
    return Headlights(pos=none, direction=none, on=np.zeros(0, bool), label=np.zeros(0, np.int32))


def point_lights(lights: Sequence[Light], floor: float) -> PointLights:
    """Return an arena's lamps; numpy arrays."""
    pos = [np.add(light.at, (0.0, 0.0, floor)) for light in lights]
    rgb = [np.multiply(light.rgb, light.brightness) for light in lights]
    return PointLights(
        pos=np.array(pos, np.float32).reshape(-1, 3), rgb=np.array(rgb, np.float32).reshape(-1, 3)
    )


def daylight(lamps: PointLights) -> Array:
    """Return 1 where the sun lights the arena, 0 where it has lamps ()."""
    return 1.0 - (xp.asarray(lamps.rgb) > 0).any().astype(xp.float32)


def shadow_gain(lamps: PointLights) -> Array:
    """Return by how much cameras brighten what is dark in the light of an arena ()."""
    return xp.where(daylight(lamps) > 0, 1.0, INDOOR_GAIN)


def developed(rgb: Array, gain: Array | float) -> Array:
    """Return colours that are `gain` times as bright near black and the same at white, in [0, 1] as they."""
    return gain * rgb / (1 + (gain - 1) * rgb)


def falloff(distance: Array) -> Array:
    """Return a light's brightness at a distance [m], that at 1 m being 1."""
    return 1.0 / xp.square(xp.maximum(distance, MIN_LIGHT_DISTANCE))


def spot_falloff(cosine: Array) -> Array:
    """Return a headlight's brightness off its axis, from 1 in its core to 0 at the edge of its cone."""
    edge, core = math.cos(SPOT_OUTER_ANGLE), math.cos(SPOT_INNER_ANGLE)
    share = xp.clip((cosine - edge) / (core - edge), 0.0, 1.0)
    return share * share * (3 - 2 * share)
