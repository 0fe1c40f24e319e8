"""Light at surfaces in pictures on Warp, with shadows, by the arithmetic of `shading`.

From a lamp, the points of a bundle that it lights lie in a narrow cone, those in the sun in a cylinder: only
geoms in it are tested, and only until the way of each lane is blocked.
"""

import numpy as np
import warp as wp

from usarmjx.sensors.cameras import shading
from usarmjx.sensors.cameras.surfaces_warp import WarpScene, xyz
from usarmjx.sensors.rays.raycast import EXCLUDE_NONE
from usarmjx.sensors.rays.raycast_warp import (
    CONE_MARGIN,
    LAST_KEY,
    MIN_COSINE,
    MIN_SLOPE,
    TINY,
    WarpBest,
    WarpCone,
    any_lane,
    first_lane,
    geom_row,
    lanes,
    lanes_in_which,
    least_key_of_lanes,
    least_of_lanes,
    load_vec4,
    local,
    sum_of_lanes,
)
from usarmjx.sensors.rays.warp_kinds import cone_box_distance, cone_sphere_distance, distance_of

wp.set_module_options({"enable_backward": False, "fast_math": True})

HEADER = wp.constant(3)
"""Four-vectors of a picture's light before those of its lamps, two each, and of its headlights, two each."""
NO_SOURCE = wp.constant(-2)
"""Source of the light of surfaces that get too little for a shadow; -1 is the sun."""
NO_OWNER = wp.constant(float(EXCLUDE_NONE))
AMBIENT = wp.constant(shading.AMBIENT)
INDOOR_AMBIENT = wp.constant(shading.INDOOR_AMBIENT)
DIFFUSE = wp.constant(shading.DIFFUSE)
GRADIENT = wp.constant(wp.vec3(*(float(x) for x in shading.AMBIENT_GRADIENT)))
MIN_LIGHT = wp.constant(shading.MIN_LIGHT)
MIN_LIGHT_DISTANCE = wp.constant(shading.MIN_LIGHT_DISTANCE)
HEADLIGHT_BRIGHTNESS = wp.constant(shading.HEADLIGHT_BRIGHTNESS)
SPOT_EDGE = wp.constant(float(np.cos(shading.SPOT_OUTER_ANGLE)))
SPOT_CORE = wp.constant(float(np.cos(shading.SPOT_INNER_ANGLE)))


@wp.struct
class WarpBeam:
    """Brightest light at a surface.

    Attributes:
        light: Its brightness there, unless it is blocked.
        rgb: Its colour.
        toward: Unit vector to it.
        away: Its distance, infinite for the sun [m].
        source: Its index; -1: the sun.
    """

    light: float
    rgb: wp.vec3
    toward: wp.vec3
    away: float
    source: int


@wp.func
def _spot_falloff(cosine: float) -> float:
    share = wp.clamp((cosine - SPOT_EDGE) / (SPOT_CORE - SPOT_EDGE), 0.0, 1.0)
    # A smooth step: no edge shows where the light begins to fall.
    return share * share * (3.0 - 2.0 * share)


@wp.func
def _brightest(
    scene: WarpScene,
    first: int,
    count: int,
    are_headlights: bool,
    point: wp.vec3,
    normal: wp.vec3,
) -> WarpBeam:
    """Return the sun or the brightest of the lamps, or the brightest of the headlights."""
    sun = xyz(load_vec4(scene.lights, scene.light))
    beam = WarpBeam()
    third = 1.0 / 3.0
    beam.rgb = wp.vec3(third, third, third)
    beam.toward = sun
    beam.away = wp.inf
    beam.source = -1
    # Times three: brightness counts all three colours together, and the sun's is a third in each.
    beam.light = (
        DIFFUSE * 3.0 * load_vec4(scene.lights, scene.light + 1)[1] * wp.max(wp.dot(normal, sun), 0.0)
    )
    if are_headlights:
        beam.light = 0.0
        beam.rgb = wp.vec3(1.0, 1.0, 1.0)
    # A conversion and not a literal: Warp refuses to change a constant inside of a loop.
    number = wp.int32(0)
    while number < count:
        at = load_vec4(scene.lights, first + 2 * number)
        look = load_vec4(scene.lights, first + 2 * number + 1)
        way = xyz(at) - point
        distance = wp.sqrt(wp.dot(way, way))
        # A lamp in the surface itself has no direction.
        way = way / wp.max(distance, 1.0e-9)
        # The inverse square has no bound; near a lamp it would make everything white.
        near = wp.max(distance, MIN_LIGHT_DISTANCE)
        own = at[3] * wp.max(wp.dot(normal, way), 0.0) / (near * near)
        if are_headlights:
            own = own * HEADLIGHT_BRIGHTNESS * _spot_falloff(-wp.dot(way, xyz(look)))
        if own > beam.light:
            beam.light = own
            beam.toward = way
            beam.away = distance
            beam.source = number
            if not are_headlights:
                beam.rgb = xyz(look)
        number += 1
    return beam


@wp.func
def _cone_from_lamp(mine: bool, lamp: wp.vec3, toward: wp.vec3) -> WarpCone:
    """Return the cone from a lamp about the points of some lanes."""
    # Lanes with other sources take part with zeros: sums over lanes need all of them.
    way = wp.where(mine, -toward, wp.vec3(0.0, 0.0, 0.0))
    axis = wp.vec3(sum_of_lanes(way[0]), sum_of_lanes(way[1]), sum_of_lanes(way[2]))
    cone = WarpCone()
    cone.axis = axis / wp.sqrt(wp.max(wp.dot(axis, axis), TINY))
    cosine = least_of_lanes(wp.where(mine, wp.dot(way, cone.axis), 1.0))
    slope = wp.sqrt(wp.max(1.0 - cosine * cosine, 0.0)) / wp.max(cosine, MIN_COSINE) + MIN_SLOPE
    # Rays too far apart make no cone: below 0 the test lets every geom pass.
    cone.slope = wp.where(cosine < MIN_COSINE, -1.0, slope)
    cone.tip = lamp
    cone.tip_radius = CONE_MARGIN
    return cone


@wp.func
def _cone_to_sun(mine: bool, start: wp.vec3, sun: wp.vec3) -> WarpCone:
    """Return the cylinder about the shadow rays of some lanes."""
    here = wp.where(mine, start, wp.vec3(0.0, 0.0, 0.0))
    number = sum_of_lanes(wp.where(mine, 1.0, 0.0))
    middle = wp.vec3(sum_of_lanes(here[0]), sum_of_lanes(here[1]), sum_of_lanes(here[2])) / number
    away = wp.where(mine, start - middle, wp.vec3(0.0, 0.0, 0.0))
    ahead = wp.dot(away, sun)
    aside = away - ahead * sun
    cone = WarpCone()
    cone.axis = sun
    cone.slope = MIN_SLOPE
    # From the hindmost of the points, so that the cylinder holds the starts of all rays.
    cone.tip = middle + least_of_lanes(ahead) * sun
    # The largest distance is the negative of the least of the negatives.
    cone.tip_radius = CONE_MARGIN + wp.sqrt(wp.max(-least_of_lanes(-wp.dot(aside, aside)), 0.0))
    return cone


@wp.func
def _cone_distance(geoms: wp.array[wp.vec4], at: int, cone: WarpCone, by_box: bool) -> float:
    """Return the distance at which a cone meets a geom's bounding box or sphere, infinite for a miss [m]."""
    near = wp.float32(0.0)
    # Rows of a geom are 32 apart; see `raycast_warp.pack`.
    pos = load_vec4(geoms, at)
    if by_box:
        r0 = load_vec4(geoms, at + 32)
        r1 = load_vec4(geoms, at + 64)
        r2 = load_vec4(geoms, at + 96)
        half = load_vec4(geoms, at + 160)
        tip = local(r0, r1, r2, cone.tip - xyz(pos))
        near = cone_box_distance(xyz(half), tip, local(r0, r1, r2, cone.axis), cone.tip_radius, cone.slope)
    else:
        near = cone_sphere_distance(xyz(pos) - cone.tip, cone.axis, pos[3], cone.tip_radius, cone.slope)
    # A cone that is too wide for the test has slope -1: any geom may be in it.
    return wp.where(cone.slope < 0.0, 0.0, near)


@wp.func
def first_in_cone(  # noqa: PLR0913 - a struct of them would do no more
    geoms: wp.array[wp.vec4],
    first: int,
    wide: int,
    count: int,
    lane: int,
    cone: WarpCone,
    mine: bool,
    start: wp.vec3,
    toward: wp.vec3,
    passed: float,
    reach: float,
    nearest: bool,
) -> WarpBest:
    """Return the nearest geom on the rays of some lanes, or any; its distance, or the reach, and place.

    Unlike `nearest_geom` it tests geoms in the order in which they are, all that the cone meets.
    """
    best = WarpBest()
    best.distance = reach
    best.geom = -1.0
    farthest = -least_of_lanes(-wp.where(mine, reach, 0.0))
    width = lanes()
    begin = wp.int32(0)
    while begin < count:
        slot = begin + lane
        near = wp.float32(wp.inf)
        if slot < count:
            # Boxes fit the large geoms, which come first; spheres are enough for the others.
            near = _cone_distance(geoms, first + geom_row(slot), cone, slot < wide)
        candidates = lanes_in_which(near < wp.inf and near <= farthest)
        while candidates != wp.uint32(0):
            found = begin + first_lane(candidates)
            # Clears the lowest bit that is set.
            candidates = candidates & (candidates - wp.uint32(1))
            if mine and (nearest or best.geom < 0.0):
                at = first + geom_row(found)
                pos = load_vec4(geoms, at)
                r0 = load_vec4(geoms, at + 32)
                r1 = load_vec4(geoms, at + 64)
                r2 = load_vec4(geoms, at + 96)
                s = load_vec4(geoms, at + 128)
                t = distance_of(
                    int(r1[3]),
                    local(r0, r1, r2, start - xyz(pos)),
                    local(r0, r1, r2, toward),
                    xyz(s),
                )
                if t < best.distance and r0[3] != passed:
                    best.distance = t
                    best.geom = float(found)
        begin += width
        # Any hit is a shadow: it ends once all lanes have one.
        if not nearest and not any_lane(mine and best.geom < 0.0):
            begin = count
    return best


@wp.func
def _is_dark(
    scene: WarpScene,
    lamps: int,
    are_headlights: bool,
    point: wp.vec3,
    toward: wp.vec3,
    away: float,
    wanted_source: int,
) -> bool:
    """Return whether the light of this lane's surface is blocked; source after source of all lanes.

    A headlight is not blocked if the first geom on the way is its own robot's.
    """
    dark = wp.bool(False)
    source = wanted_source
    while any_lane(source > NO_SOURCE):
        # Plus 1: the sun's -1 becomes 0, the least unsigned number.
        key = wp.where(source > NO_SOURCE, wp.uint32(source + 1), LAST_KEY)
        # The same in all lanes, so all of them take the same branch below, whose sums need every lane.
        now = least_key_of_lanes(key)
        mine = key == now
        cone = WarpCone()
        if now == wp.uint32(0):
            cone = _cone_to_sun(mine, point, toward)
        else:
            lamp = load_vec4(scene.lights, lamps + 2 * int(now) - 2)
            cone = _cone_from_lamp(mine, xyz(lamp), toward)
        best = first_in_cone(
            scene.geoms,
            scene.first,
            scene.wide,
            scene.solids,
            scene.lane,
            cone,
            mine,
            point,
            toward,
            NO_OWNER,
            away,
            are_headlights,
        )
        if mine:
            source = NO_SOURCE
            dark = best.geom >= 0.0
            if dark and are_headlights:
                carrier = load_vec4(scene.lights, lamps + 2 * int(now) - 1)[3]
                dark = load_vec4(scene.geoms, scene.paint + int(best.geom))[3] != carrier
    return dark


@wp.func
def lit_color(rgb: wp.vec3, light: wp.vec3, exposure: float, gain: float) -> wp.vec3:
    """Return the colour of a surface in some light, with the camera's gain on dark ones."""
    x = wp.clamp(rgb[0] * light[0] * exposure, 0.0, 1.0)
    y = wp.clamp(rgb[1] * light[1] * exposure, 0.0, 1.0)
    z = wp.clamp(rgb[2] * light[2] * exposure, 0.0, 1.0)
    more = gain - 1.0
    return wp.vec3(gain * x / (1.0 + more * x), gain * y / (1.0 + more * y), gain * z / (1.0 + more * z))


@wp.func
def light_at(
    scene: WarpScene,
    met: bool,
    shadows: bool,
    point: wp.vec3,
    normal: wp.vec3,
) -> wp.vec3:
    """Return the light at a surface, by colours."""
    mood = load_vec4(scene.lights, scene.light + 1)
    ambient = wp.where(mood[1] > 0.0, AMBIENT, INDOOR_AMBIENT) * (1.0 + wp.dot(normal, GRADIENT))
    bright = wp.vec3(ambient, ambient, ambient)
    first = scene.light + HEADER
    count = scene.lamps
    turn = wp.int32(0)
    while turn < 2:
        beam = _brightest(scene, first, count, turn == 1, point, normal)
        wanted = met and shadows and beam.light > MIN_LIGHT
        # As in `shading`: a headlight too weak for a shadow ray gives nothing, sun and lamps
        # give their little light.
        dark = shadows and turn == 1 and not wanted
        if shadows:
            source = wp.where(wanted, beam.source, NO_SOURCE)
            dark = _is_dark(scene, first, turn == 1, point, beam.toward, beam.away, source) or dark
        if not dark:
            bright = bright + beam.light * beam.rgb
        # After the lamps come the headlights, unless none of them is on.
        first += 2 * scene.lamps
        count = scene.headlights
        turn = wp.where(mood[3] > 0.0, turn + 1, 2)
    return bright
