"""Surfaces at the hits of camera rays on Warp: point, normal, colour; with the arithmetic of `shading`."""

import warp as wp

from usarmjx.sensors.cameras import shading
from usarmjx.sensors.cameras.paint import ARENA_LABEL
from usarmjx.sensors.cameras.textures_warp import sign_position, textured
from usarmjx.sensors.rays.raycast_warp import load_vec4, local
from usarmjx.sensors.rays.warp_kinds import PLANE, normal_of

wp.set_module_options({"enable_backward": False, "fast_math": True})

ARENA = wp.constant(float(ARENA_LABEL))
CHECKER_LIGHT = wp.constant(wp.vec3(*(float(x) for x in shading.CHECKER_RGB[0])))
CHECKER_DARK = wp.constant(wp.vec3(*(float(x) for x in shading.CHECKER_RGB[1])))
FLOOR_RGB = wp.constant(wp.vec3(*(float(x) for x in shading.FLOOR_RGB)))
BRICK_CONTRAST = wp.constant(shading.BRICK_CONTRAST)
RAY_BIAS = wp.constant(shading.RAY_BIAS)
RAY_BIAS_PER_METRE = wp.constant(shading.RAY_BIAS_PER_METRE)


@wp.func
def xyz(row: wp.vec4) -> wp.vec3:
    """Return the first three numbers of a row."""
    return wp.vec3(row[0], row[1], row[2])


@wp.struct
class WarpScene:
    """Geoms and lights of a picture, as `shading_warp.packed_scene` and `packed_lights` lay them out.

    Attributes:
        geoms: Geoms and colours of all worlds.
        lights: Light of all pictures.
        signs: Cells and colours of signs, see `sign_bits`.
        first: First row of the world's solids in `geoms`.
        paint: First row of their colours there.
        wide: Number of solids that are culled by their boxes, which come first.
        solids: Number of solids.
        light: First row of the picture in `lights`.
        lamps: Number of lamps.
        headlights: Number of headlights.
        lane: Lane of the thread.
    """

    geoms: wp.array[wp.vec4]
    lights: wp.array[wp.vec4]
    signs: wp.array[float]
    first: int
    paint: int
    wide: int
    solids: int
    light: int
    lamps: int
    headlights: int
    lane: int


@wp.struct
class WarpSurface:
    """Surface at a ray's hit.

    Attributes:
        point: Point just off it [m].
        normal: Unit normal towards the ray.
        rgb: Colour.
        share: Share of the reflection, or of the background behind a pane.
        label: Label.
    """

    point: wp.vec3
    normal: wp.vec3
    rgb: wp.vec3
    share: float
    label: float


@wp.func
def _checkers(point: wp.vec3, scene: WarpScene) -> wp.vec3:
    """Return the colour of the floor."""
    size = load_vec4(scene.lights, scene.light + 1)[2]
    bounds = load_vec4(scene.lights, scene.light + 2)
    odd = int(wp.floor(point[0] / size) + wp.floor(point[1] / size)) & 1
    within = point[0] > bounds[0] and point[0] < bounds[1] and point[1] > bounds[2] and point[1] < bounds[3]
    return wp.where(within, wp.where(odd == 1, CHECKER_DARK, CHECKER_LIGHT), FLOOR_RGB)


@wp.func
def _bricks(point: wp.vec3, normal: wp.vec3, size: float) -> float:
    """Return the brightness of the pattern on the arena's solids."""
    level = wp.abs(normal[2]) > 0.7
    across = wp.where(level, point[0], point[1] * normal[0] - point[0] * normal[1]) / size
    up = wp.where(level, point[1], 2.0 * point[2]) / size
    odd = int(wp.floor(across) + wp.floor(up)) & 1
    return 1.0 + BRICK_CONTRAST * (1.0 - 2.0 * wp.float32(odd))


@wp.func
def surface_at(
    scene: WarpScene,
    at: int,
    paint: int,
    start: wp.vec3,
    along: wp.vec3,
    reach: float,
) -> WarpSurface:
    """Return the surface of a geom, with its first row and that of its colour, at a distance on a ray."""
    # Rows of a geom are 32 apart, since groups of 32 geoms lie row by row; see `raycast_warp.pack`.
    pos = load_vec4(scene.geoms, at)
    r0 = load_vec4(scene.geoms, at + 32)
    r1 = load_vec4(scene.geoms, at + 64)
    r2 = load_vec4(scene.geoms, at + 96)
    s = load_vec4(scene.geoms, at + 128)
    look = load_vec4(scene.geoms, paint)
    size = xyz(s)
    kind = int(r1[3])
    point = start + reach * along
    inside = local(r0, r1, r2, point - xyz(pos))
    facing = normal_of(kind, inside, size)
    # Back to the world's axes: the rows of the orientation, where `local` takes its columns.
    normal = wp.vec3(wp.dot(xyz(r0), facing), wp.dot(xyz(r1), facing), wp.dot(xyz(r2), facing))
    # As `targets.normals`: surfaces seen from inside face the other way.
    if wp.dot(normal, along) > 0.0:
        facing = -facing
        normal = -normal
    rgb = xyz(look)
    code = int(s[3])
    if code > 0:
        level = wp.abs(normal[2]) > 0.7
        across = wp.where(level, point[0], point[1] * normal[0] - point[0] * normal[1])
        up = wp.where(level, point[1], point[2])
        sign = sign_position(inside, facing, size)
        rgb = textured(code, rgb, across, up, sign[0], sign[1], scene.signs)
    elif kind == PLANE:
        rgb = _checkers(point, scene)
    elif look[3] == ARENA:
        rgb = rgb * _bricks(point, normal, load_vec4(scene.lights, scene.light + 1)[2])
    out = WarpSurface()
    # Off the surface, or its own rounding errors would shade it.
    out.point = point + (RAY_BIAS + RAY_BIAS_PER_METRE * reach) * normal
    out.normal = normal
    out.rgb = rgb
    out.share = load_vec4(scene.geoms, at + 160)[3]
    out.label = look[3]
    return out
