"""Warp versions of `kernels` and of the cone tests of `bundles`: one ray or cone and one geom per call."""

import mujoco
import warp as wp

from usarmjx.models.compile.ray_geoms import FENDER_KIND, TRIANGLE_KIND
from usarmjx.sensors.rays import kernels

wp.set_module_options({"enable_backward": False, "fast_math": True})

TINY = wp.constant(kernels.TINY)
EDGE_MARGIN = wp.constant(kernels.EDGE_MARGIN)
GRID_PITCH = wp.constant(kernels.GRID_PITCH)
HALF_BAR = wp.constant(kernels.BAR_WIDTH / 2)
PLANE = wp.constant(int(mujoco.mjtGeom.mjGEOM_PLANE))
BOX = wp.constant(int(mujoco.mjtGeom.mjGEOM_BOX))
SPHERE = wp.constant(int(mujoco.mjtGeom.mjGEOM_SPHERE))
CAPSULE = wp.constant(int(mujoco.mjtGeom.mjGEOM_CAPSULE))
CYLINDER = wp.constant(int(mujoco.mjtGeom.mjGEOM_CYLINDER))
ELLIPSOID = wp.constant(int(mujoco.mjtGeom.mjGEOM_ELLIPSOID))
TRIANGLE = wp.constant(TRIANGLE_KIND)
FENDER = wp.constant(FENDER_KIND)


@wp.func
def _not_zero(x: float) -> float:
    return wp.where(wp.abs(x) < TINY, TINY, x)


@wp.func
def _ahead(t: float) -> float:
    return wp.where(t >= 0.0, t, wp.inf)


@wp.func
def _ray_plane(o: wp.vec3, d: wp.vec3, s: wp.vec3) -> float:
    # Planes are met from above only, as in MuJoCo.
    front = d[2] < -TINY
    t = wp.where(front, -o[2] / wp.where(front, d[2], -1.0), -1.0)
    inside = t >= 0.0
    inside = inside and (s[0] <= 0.0 or wp.abs(o[0] + t * d[0]) <= s[0])
    inside = inside and (s[1] <= 0.0 or wp.abs(o[1] + t * d[1]) <= s[1])
    return wp.where(inside, t, wp.inf)


@wp.func
def _ray_box(o: wp.vec3, d: wp.vec3, s: wp.vec3) -> float:
    near = wp.float32(-wp.inf)
    far = wp.float32(wp.inf)
    for i in range(3):
        # Along a face the quotient is huge instead of infinite: 0 times infinity would be NaN.
        share = 1.0 / _not_zero(d[i])
        middle = o[i] * share
        half = s[i] * wp.abs(share)
        near = wp.max(near, -middle - half)
        far = wp.min(far, half - middle)
    return wp.where(near <= far, wp.min(_ahead(near), _ahead(far)), wp.inf)


@wp.func
def _ball(o: wp.vec3, d: wp.vec3, radius: float) -> wp.vec2:
    middle = -wp.dot(o, d)
    # From the point nearest to the centre: far away, differences of squares would lose all digits.
    foot = o + middle * d
    under = radius * radius - wp.dot(foot, foot)
    root = wp.sqrt(wp.max(under, 0.0))
    return wp.where(under >= 0.0, wp.vec2(middle - root, middle + root), wp.vec2(wp.inf, wp.inf))


@wp.func
def _ray_sphere(o: wp.vec3, d: wp.vec3, s: wp.vec3) -> float:
    t = _ball(o, d, s[0])
    return wp.min(_ahead(t[0]), _ahead(t[1]))


@wp.func
def _tube(o: wp.vec3, d: wp.vec3, radius: float) -> wp.vec2:
    flat = d[0] * d[0] + d[1] * d[1]
    safe = wp.max(flat, TINY)
    middle = -(o[0] * d[0] + o[1] * d[1]) / safe
    x = o[0] + middle * d[0]
    y = o[1] + middle * d[1]
    under = radius * radius - x * x - y * y
    half = wp.sqrt(wp.max(under, 0.0) / safe)
    # A ray along the axis meets no side; caps and balls take it.
    hit = under >= 0.0 and flat > TINY
    return wp.where(hit, wp.vec2(middle - half, middle + half), wp.vec2(wp.inf, wp.inf))


@wp.func
def _within(t: float, z: float, low: float, high: float) -> float:
    # A miss stays a miss: of an infinite t the height is infinite or NaN, and no such comparison shortens it.
    return wp.where(t >= 0.0 and z >= low and z <= high, t, wp.inf)


@wp.func
def _ray_cylinder(o: wp.vec3, d: wp.vec3, s: wp.vec3) -> float:
    t = _tube(o, d, s[0])
    best = wp.min(
        _within(t[0], o[2] + t[0] * d[2], -s[1], s[1]), _within(t[1], o[2] + t[1] * d[2], -s[1], s[1])
    )
    share = 1.0 / _not_zero(d[2])
    for i in range(2):
        cap = (wp.where(i == 0, -s[1], s[1]) - o[2]) * share
        x = o[0] + cap * d[0]
        y = o[1] + cap * d[1]
        best = wp.min(best, wp.where(x * x + y * y <= s[0] * s[0], _ahead(cap), wp.inf))
    return best


@wp.func
def _ray_capsule(o: wp.vec3, d: wp.vec3, s: wp.vec3) -> float:
    t = _tube(o, d, s[0])
    best = wp.min(
        _within(t[0], o[2] + t[0] * d[2], -s[1], s[1]), _within(t[1], o[2] + t[1] * d[2], -s[1], s[1])
    )
    top = _ball(wp.vec3(o[0], o[1], o[2] - s[1]), d, s[0])
    bottom = _ball(wp.vec3(o[0], o[1], o[2] + s[1]), d, s[0])
    for i in range(2):
        best = wp.min(best, _within(top[i], o[2] + top[i] * d[2], s[1], wp.inf))
        best = wp.min(best, _within(bottom[i], o[2] + bottom[i] * d[2], -wp.inf, -s[1]))
    return best


@wp.func
def _ray_ellipsoid(o: wp.vec3, d: wp.vec3, s: wp.vec3) -> float:
    start = wp.cw_div(o, s)
    along = wp.cw_div(d, s)
    stretch = wp.dot(along, along)
    middle = -wp.dot(start, along) / stretch
    foot = start + middle * along
    # Divided by the stretch, t is a distance along the given ray, as the scaled direction is no unit vector.
    under = 1.0 - wp.dot(foot, foot)
    half = wp.sqrt(wp.max(under, 0.0) / stretch)
    return wp.where(under >= 0.0, wp.min(_ahead(middle - half), _ahead(middle + half)), wp.inf)


@wp.func
def _ray_triangle(o: wp.vec3, d: wp.vec3, s: wp.vec3) -> float:
    t = -o[2] / _not_zero(d[2])
    x = o[0] + t * d[0]
    y = o[1] + t * d[1]
    second = x * s[2] - y * s[1]
    third = y * s[0]
    area = s[0] * s[2]
    # Neighbouring triangles overlap a little: rays along a common edge must not slip through.
    slack = EDGE_MARGIN * area
    inside = second >= -slack and third >= -slack and second + third <= area + slack and area > 0.0
    return wp.where(inside, _ahead(t), wp.inf)


@wp.func
def _between_bars(x: float, half: float) -> bool:
    return wp.abs(x - GRID_PITCH * wp.floor(x / GRID_PITCH + 0.5)) > HALF_BAR and half >= GRID_PITCH / 2.0


@wp.func
def _in_hole(p: wp.vec3, s: wp.vec3) -> bool:
    free_x = _between_bars(p[0], s[0])
    free_y = _between_bars(p[1], s[1])
    free_z = _between_bars(p[2], s[2])
    over_x = wp.abs(p[0]) - s[0]
    over_y = wp.abs(p[1]) - s[1]
    over_z = wp.abs(p[2]) - s[2]
    # The face is that whose plane is nearest: by rounding no point lies on a plane exactly.
    on_x = over_x >= over_y and over_x >= over_z
    on_y = not on_x and over_y >= over_z
    return wp.where(on_x, free_y and free_z, wp.where(on_y, free_x and free_z, free_x and free_y))


@wp.func
def _ray_fender(o: wp.vec3, d: wp.vec3, s: wp.vec3) -> float:
    t = _ray_box(o, d, s)
    # A miss keeps its finite start point: `where` drops the result, but NaN would spread.
    reach = wp.where(t < wp.inf, t, 0.0)
    return wp.where(_in_hole(o + reach * d, s), wp.inf, t)


@wp.func
def distance_of(kind: int, o: wp.vec3, d: wp.vec3, s: wp.vec3) -> float:
    """Return the distance to a geom's surface, infinite for a miss [m]."""
    t = wp.float32(wp.inf)
    if kind == BOX:
        t = _ray_box(o, d, s)
    elif kind == CYLINDER:
        t = _ray_cylinder(o, d, s)
    elif kind == TRIANGLE:
        t = _ray_triangle(o, d, s)
    elif kind == PLANE:
        t = _ray_plane(o, d, s)
    elif kind == SPHERE:
        t = _ray_sphere(o, d, s)
    elif kind == CAPSULE:
        t = _ray_capsule(o, d, s)
    elif kind == ELLIPSOID:
        t = _ray_ellipsoid(o, d, s)
    elif kind == FENDER:
        t = _ray_fender(o, d, s)
    return t


@wp.func
def _unit(v: wp.vec3) -> wp.vec3:
    return v / wp.max(wp.length(v), TINY)


@wp.func
def _box_normal(p: wp.vec3, s: wp.vec3) -> wp.vec3:
    x = wp.abs(p[0]) - s[0]
    y = wp.abs(p[1]) - s[1]
    z = wp.abs(p[2]) - s[2]
    on_y = y > x and y >= z
    on_z = z > x and z > y
    # Without its sign, which the caller chooses by the ray.
    side = wp.where(on_z, wp.vec3(0.0, 0.0, 1.0), wp.vec3(1.0, 0.0, 0.0))
    return wp.where(on_y, wp.vec3(0.0, 1.0, 0.0), side)


@wp.func
def _round_normal(kind: int, p: wp.vec3, s: wp.vec3) -> wp.vec3:
    # From the nearest point of the axis within the tube: along the tube it is radial, on a ball from its
    # middle.
    normal = _unit(wp.vec3(p[0], p[1], p[2] - wp.clamp(p[2], -s[1], s[1])))
    on_cap = s[1] - wp.abs(p[2]) < s[0] - wp.sqrt(p[0] * p[0] + p[1] * p[1])
    return wp.where(kind == CYLINDER and on_cap, wp.vec3(0.0, 0.0, 1.0), normal)


@wp.func
def normal_of(kind: int, p: wp.vec3, s: wp.vec3) -> wp.vec3:
    """Return the unit normal at a point on the surface, outward or inward; see `kernels.surface_normal`."""
    # Planes and triangles lie in z = 0 of their own frames.
    normal = wp.vec3(0.0, 0.0, 1.0)
    if kind == BOX or kind == FENDER:  # noqa: SIM109 - Warp knows no `in`
        normal = _box_normal(p, s)
    elif kind == SPHERE:
        normal = _unit(p)
    elif kind == ELLIPSOID:
        # The gradient of the ellipsoid's equation.
        normal = _unit(wp.cw_div(p, wp.cw_mul(s, s)))
    elif kind == CYLINDER or kind == CAPSULE:  # noqa: SIM109 - as above
        normal = _round_normal(kind, p, s)
    return normal


@wp.func
def cone_box_distance(half: wp.vec3, tip: wp.vec3, axis: wp.vec3, tip_radius: float, slope: float) -> float:
    """As `bundles.cone_box_distance`, of a box about its frame's origin."""
    near = wp.float32(0.0)
    far = wp.float32(wp.inf)
    for i in range(3):
        room = half[i] + tip_radius
        position = wp.where(axis[i] >= 0.0, tip[i], -tip[i])
        speed = wp.abs(axis[i])
        opening = speed + slope
        # A wall of the cone that is parallel to the slab meets it nowhere: huge instead
        # of infinite, as above.
        closing = _not_zero(speed - slope)
        share = 1.0 / (opening * closing)
        enter = (-position - room) * closing * share
        leave = (room - position) * opening * share
        near = wp.max(near, wp.where(closing < 0.0, wp.max(enter, leave), enter))
        far = wp.where(closing > 0.0, wp.min(far, leave), far)
    return wp.where(near <= far, near, wp.inf)


@wp.func
def cone_sphere_distance(
    offset: wp.vec3, axis: wp.vec3, radius: float, tip_radius: float, slope: float
) -> float:
    """As `bundles.cone_sphere_distance`."""
    far = wp.dot(offset, offset)
    along = wp.dot(offset, axis)
    reach = radius + tip_radius
    width = reach + slope * (along + radius)
    inside = far - along * along <= width * width and along > -reach
    return wp.where(inside, wp.max(wp.sqrt(far) - reach, 0.0), wp.inf)
