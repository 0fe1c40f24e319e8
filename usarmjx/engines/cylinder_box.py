"""Contacts between a cylinder and a box for MJX-JAX, which has no function for that pair.

The normal is the direction of least penetration, found by a separating-axis test. For two convex bodies that
direction is a normal of a smooth patch of their Minkowski difference, of which a cylinder and a box have five
kinds: box face, flat disc, side of the cylinder against a box corner (radial), side against a box edge (cross
product), rim against a box edge (one angle, searched). The contacts are found by clipping the two touching
features against each other.

All computations are in the frame of the box, as sums of products: a matrix product may run in TensorFloat-32
on recent GPUs, whose 10-bit fraction is worth a millimetre at room scale.
"""

from importlib import import_module, metadata
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp

from usarmjx.base.errors import EngineError

MJX_VERSION = "3.17.0"  # the private names that `register_collision` uses were checked in this one only
CONTACTS = 3  # a disc needs three to stand on a face, a rolling wheel uses two
INACTIVE = 1.0  # m, distance of an unused contact slot, as MJX's own functions have it
FACE_BIAS = 1e-3  # share of the depth by which another normal must beat a face to be chosen
FACE_BIAS_MIN = 2e-6  # m, float32 rounding at room scale
BOTH_ENDS = 0.9  # an edge touches along a line if both ends are this share as deep as the deepest
PARALLEL = 1e-3  # sine below which two directions count as parallel or perpendicular
FLAT = 1e-5  # sine of the tilt below which a disc has no deepest point, only rounding
NEARLY_FLAT = 0.05  # the same for a disc whose centre and deepest point both overhang the face
TRIM = 0.01  # share by which contacts are moved in from where an edge leaves the cylinder
NEAR_FACE = 0.2  # sine to a face's normal up to which a third contact inside that face helps
TINY = 1e-12  # guards squared lengths, so that no square root or division sees zero

Contacts = tuple[jax.Array, jax.Array, jax.Array]


class GeomInfo(Protocol):
    """Geom argument of an MJX collision function (MJX's own GeomInfo).

    Attributes:
        pos: Centre [m] (3,).
        mat: Rotation to the world (3, 3).
        size: Radius and half-length of a cylinder, or half-lengths of a box [m] (3,).
    """

    pos: jax.Array
    mat: jax.Array
    size: jax.Array


class _Pair(NamedTuple):
    """Cylinder in the frame of a box.

    Attributes:
        center: Its centre [m] (3,).
        axis: Its axis (3,).
        radius: Its radius [m] ().
        half: Half its length [m] ().
        box: Half lengths of the box [m] (3,).
    """

    center: jax.Array
    axis: jax.Array
    radius: jax.Array
    half: jax.Array
    box: jax.Array


def _dot(x: jax.Array, y: jax.Array) -> jax.Array:
    return jnp.sum(x * y, axis=-1)


def _unit(x: jax.Array) -> jax.Array:
    return x / jnp.sqrt(jnp.maximum(_dot(x, x), TINY))[..., None]


def _sign(x: jax.Array) -> jax.Array:
    return jnp.where(x < 0, -1.0, 1.0)


def _separation(pair: _Pair, n: jax.Array) -> jax.Array:
    """Gap between the pair along +-n [m] (...,) for unit n (..., 3); negative: overlap."""
    toward = n * _sign(_dot(n, pair.center))[..., None]
    # subtracted per axis: both terms grow with the box, their difference does not
    outside = jnp.sum(toward * pair.center - jnp.abs(n) * pair.box, axis=-1)
    sideways = jnp.cross(n, pair.axis)  # 1 - cos^2 instead would lose half the digits
    reach = pair.radius * jnp.sqrt(jnp.maximum(_dot(sideways, sideways), TINY))
    return outside - reach - pair.half * jnp.abs(_dot(n, pair.axis))


def _rim_normals(pair: _Pair) -> jax.Array:
    """Best direction perpendicular to each box axis (3, 3), by a search with shrinking intervals."""
    u = jnp.roll(jnp.eye(3), 1, axis=1)[:, None]
    v = jnp.roll(jnp.eye(3), 2, axis=1)[:, None]

    def normals(angle: jax.Array) -> jax.Array:
        return jnp.cos(angle)[..., None] * u + jnp.sin(angle)[..., None] * v

    spread = jnp.pi / 8  # 8 samples on a half circle; both bodies are point symmetric
    angles = jnp.broadcast_to((jnp.arange(8) + 0.5) * spread, (3, 8))
    best = angles[:, :1]
    for _ in range(7):  # ends at 2e-4 rad, worth 23 um of depth at a radius of 0.13 m
        pick = jnp.argmax(_separation(pair, normals(angles)), axis=1)
        best = jnp.take_along_axis(angles, pick[:, None], axis=1)
        angles = best + spread * jnp.linspace(-1.0, 1.0, 7)
        spread = spread / 3
    return normals(best)[:, 0]


def _least_penetration(pair: _Pair) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Normal from box to cylinder (3,), gap along it [m] (), whether it is a face's normal ()."""
    corners = jnp.stack(jnp.meshgrid(*[jnp.array([-1.0, 1.0])] * 3), axis=-1).reshape(8, 3)
    # Radial normals: from each corner of the box straight to the axis.
    spokes = pair.center - corners * pair.box
    spokes = spokes - _dot(spokes, pair.axis)[:, None] * pair.axis
    # Normals of the side where an edge of the box touches it.
    crosses = jnp.cross(pair.axis, jnp.eye(3))
    directions = jnp.concatenate([spokes, crosses, pair.axis[None], _rim_normals(pair)])
    # Cross products of nearly parallel axes are roundings: normalised, they would point anywhere.
    usable = _dot(directions, directions) > PARALLEL**2
    directions = _unit(directions)
    gaps = jnp.where(usable, _separation(pair, directions), -jnp.inf)
    # The least penetration is along the direction of the largest gap (separating axes).
    other = jnp.argmax(gaps)
    face_gaps = _separation(pair, jnp.eye(3))
    face = jnp.argmax(face_gaps)
    # Of nearly equal directions the face wins: else the normal would flip between steps of a resting wheel.
    bias = FACE_BIAS_MIN + FACE_BIAS * jnp.abs(gaps[other])
    on_face = face_gaps[face] >= gaps[other] - bias
    n = jnp.where(on_face, jnp.eye(3)[face], directions[other])
    gap = jnp.where(on_face, face_gaps[face], gaps[other])
    return n * _sign(_dot(n, pair.center)), gap, on_face


def _clip_slab(
    start: jax.Array, step: jax.Array, half: jax.Array, span: tuple[jax.Array, jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """Part of `span` on which |start + t step| <= half; empty if its first exceeds its second."""
    # A line parallel to the slab gets ends far outside instead of 0 / 0.
    step = _sign(step) * jnp.maximum(jnp.abs(step), 1e-9)
    one, two = (-half - start) / step, (half - start) / step
    return (
        jnp.maximum(span[0], jnp.minimum(one, two)),
        jnp.minimum(span[1], jnp.maximum(one, two)),
    )


def _clip_cylinder(
    pair: _Pair, point: jax.Array, along: jax.Array, span: tuple[jax.Array, jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """Part of `span` for which point + t along (unit) lies in the cylinder."""
    offset = point - pair.center
    z, dz = _dot(offset, pair.axis), _dot(along, pair.axis)
    rho, drho = offset - z * pair.axis, along - dz * pair.axis
    square = jnp.maximum(_dot(drho, drho), TINY)
    middle = -_dot(rho, drho) / square
    nearest = rho + middle * drho
    chord = jnp.sqrt(jnp.maximum(pair.radius**2 - _dot(nearest, nearest), TINY) / square)
    span = jnp.maximum(span[0], middle - chord), jnp.minimum(span[1], middle + chord)
    return _clip_slab(z, dz, pair.half, span)


def _bottom(pair: _Pair, n: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Cosine of n to the axis, centre of the lower disc, its steepest direction, sine of tilt."""
    slope = _dot(n, pair.axis)
    down = slope * pair.axis - n
    sine = jnp.sqrt(jnp.maximum(_dot(down, down), TINY))
    steepest = _unit(down)
    # at a small tilt `down` is a small difference: put the result back into the disc's plane
    steepest = _unit(steepest - _dot(steepest, pair.axis) * pair.axis)
    return slope, pair.center - _sign(slope) * pair.half * pair.axis, steepest, sine


def _on_face(pair: _Pair, n: jax.Array, gap: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Contacts on the face with normal n: gaps [m] (CONTACTS,), positions [m] (CONTACTS, 3)."""
    slope, disc, steepest, tilt = _bottom(pair, n)
    # n is an axis of the box, up to its sign: rolled, it gives the other two.
    u, v = jnp.roll(jnp.abs(n), 1), jnp.roll(jnp.abs(n), 2)

    def clip(
        point: jax.Array, along: jax.Array, span: tuple[jax.Array, jax.Array]
    ) -> tuple[jax.Array, jax.Array]:
        span = _clip_slab(_dot(u, point), _dot(u, along), _dot(u, pair.box), span)
        return _clip_slab(_dot(v, point), _dot(v, along), _dot(v, pair.box), span)

    def clamp(point: jax.Array) -> jax.Array:
        return jnp.where(jnp.abs(n) > 0.5, point, jnp.clip(point, -pair.box, pair.box))

    # a flat disc has no deepest point: start towards the face if it overhangs, else anywhere
    rim = disc + pair.radius * steepest
    overhang, inward = rim - clamp(rim), clamp(disc) - disc
    overhangs = (_dot(overhang, overhang) > TINY) & (_dot(inward, inward) > TINY)
    tangent = jnp.where(_dot(inward, inward) > TINY, inward, u)
    tangent = _unit(tangent - _dot(tangent, pair.axis) * pair.axis)
    flat = (tilt < FLAT) | (overhangs & (tilt < NEARLY_FLAT))
    steepest = jnp.where(flat, tangent, steepest)
    rim = disc + pair.radius * steepest

    # Lying on the face a cylinder touches it along a generator, standing with a disc.
    lying = jnp.abs(slope) < 0.5
    along = jnp.where(lying, _sign(slope) * pair.axis, -steepest)
    length = 2 * jnp.where(lying, pair.half, pair.radius)
    first, last = clip(rim, along, (jnp.zeros(()), length))
    hit = last > first
    across = jnp.cross(pair.axis, steepest)
    middle = rim + (first + 0.75 * (last - first)) * along  # 120 degrees apart on a whole disc
    arm = middle - disc
    chord = jnp.sqrt(jnp.maximum(pair.radius**2 - _dot(arm, arm), 0.0) + TINY)
    left, right = clip(middle, across, (-chord, chord))

    second = jnp.where(lying, rim + last * along, middle + right * across)
    plane = _dot(jnp.abs(n), pair.box)
    # with its deepest point a hair beyond the face a tilted cylinder is clipped far off
    clipped = rim + first * along
    sound = hit & (_dot(clipped, n) - plane - gap < 0.1 * jnp.abs(gap))
    points = jnp.stack([jnp.where(sound, clipped, clamp(rim)), second, middle + left * across])
    heights = _dot(points, n) - plane
    gaps = heights.at[0].set(gap)
    wide = hit & (right > left)
    found = jnp.stack([jnp.array(True), jnp.where(lying, hit, wide), ~lying & wide])
    gaps = jnp.where(found, gaps, INACTIVE)
    return gaps, points + (0.5 * gaps - heights)[:, None] * n


def _depth(pair: _Pair, points: jax.Array, n: jax.Array) -> jax.Array:
    """Distance of each point (..., 3) inside the cylinder to its surface along -n [m] (...,)."""
    offset = points - pair.center
    z, dz = _dot(offset, pair.axis), -_dot(n, pair.axis)
    rho, drho = offset - z[..., None] * pair.axis, -n - dz * pair.axis
    _, cap = _clip_slab(z, dz, pair.half, (jnp.array(-jnp.inf), jnp.array(jnp.inf)))
    square = jnp.maximum(_dot(drho, drho), TINY)
    middle = -_dot(rho, drho) / square
    nearest = rho + middle[..., None] * drho
    miss = pair.radius**2 - _dot(nearest, nearest)
    side = middle + jnp.sqrt(jnp.maximum(miss, TINY) / square)
    # A line that misses the cylinder has a negative depth, of which no contact is made.
    return jnp.where(miss > 0, jnp.minimum(cap, side), -INACTIVE)


def _on_edge(pair: _Pair, n: jax.Array, gap: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Contacts of the box edge or corner deepest along n: gaps (CONTACTS,), positions as above."""
    # The edge runs along the axis most perpendicular to n.
    order = jnp.argsort(jnp.abs(n))
    edge, inward = jnp.eye(3)[order[0]], jnp.eye(3)[order[1]]
    corner = _sign(n) * pair.box
    length = _dot(edge, pair.box)
    # measured from the point nearest to the cylinder: a long edge would cost digits
    shift = _dot(edge, pair.center)
    origin = corner * (1 - edge) + shift * edge
    low, high = _clip_cylinder(pair, origin, edge, (-length - shift, length - shift))
    crossed = high > low

    slope, disc, steepest, tilt = _bottom(pair, n)
    lowest = disc + jnp.where(tilt > PARALLEL, pair.radius, 0.0) * steepest
    # a generator that crosses the edge touches where they cross, not at its end
    cosine = _dot(pair.axis, edge)
    sine_square = jnp.maximum(1 - cosine**2, PARALLEL**2)
    offset = origin - pair.center - pair.radius * steepest
    at = (_dot(offset, pair.axis) - cosine * _dot(offset, edge)) / sine_square
    crossing = pair.center + pair.radius * steepest + jnp.clip(at, -pair.half, pair.half) * pair.axis
    is_crossing = (jnp.abs(slope) < PARALLEL) & (sine_square > 10 * PARALLEL**2)
    lowest = jnp.where(is_crossing, crossing, lowest)
    deepest = jnp.where(
        jnp.abs(_dot(edge, n)) > PARALLEL, _dot(edge, corner) - shift, _dot(edge, lowest) - shift
    )
    deepest = jnp.where(
        crossed, jnp.clip(deepest, low, high), jnp.clip(deepest, -length - shift, length - shift)
    )

    # at the very end a chord of a flat disc is on the rim, where any tilt makes the depth zero
    trim = TRIM * (high - low)
    ends = origin + jnp.stack([low + trim, high - trim])[:, None] * edge
    depths = _depth(pair, ends, n)
    line = crossed & (gap < 0) & (jnp.min(depths) >= -BOTH_ENDS * gap)
    far = jnp.where(high - deepest > deepest - low, 1, 0)
    first = jnp.where(line, ends[1 - far], origin + deepest * edge)
    first_gap = jnp.where(line, -depths[1 - far], gap)
    second = ends[far]

    base = 0.5 * (first + second)
    into = -_sign(_dot(n, inward)) * inward
    _, reach = _clip_cylinder(pair, base, into, (jnp.zeros(()), 2 * _dot(inward, pair.box)))
    third = base + (1 - TRIM) * reach * into
    third_depth = _depth(pair, third, n)
    near_face = jnp.abs(n[order[1]]) < NEAR_FACE
    gaps = jnp.stack(
        [
            first_gap,
            jnp.where(crossed & (gap < 0) & (depths[far] > 0), -depths[far], INACTIVE),
            jnp.where(
                crossed & (gap < 0) & near_face & (reach > 0) & (third_depth > 0),
                -third_depth,
                INACTIVE,
            ),
        ]
    )
    return gaps, jnp.stack([first, second, third]) + 0.5 * gaps[:, None] * n


def _frame(n: jax.Array) -> jax.Array:
    """Rows: n (3,) and two tangents, chosen as C MuJoCo's mju_makeFrame does (3, 3)."""
    upright = jnp.abs(n[1]) < 0.5
    y, z = jnp.array([0.0, 1.0, 0.0]), jnp.array([0.0, 0.0, 1.0])
    tangent = jnp.where(upright, y, z)
    tangent = _unit(tangent - _dot(tangent, n) * n)
    return jnp.stack([n, tangent, jnp.cross(n, tangent)])


def cylinder_box(cylinder: GeomInfo, box: GeomInfo) -> Contacts:
    """Contacts between one cylinder and one box; use `jax.vmap` for many pairs.

    The deepest contact's distance is minus the least penetration. If the two are apart, it is a
    lower bound of their distance: exact unless a corner is nearest to a rim.

    Args:
        cylinder: The cylinder; its axis is the third column of `mat`.
        box: The box.

    Returns:
        Distances [m] (CONTACTS,), negative for penetration and INACTIVE for unused slots;
        positions half-way between the surfaces [m] (CONTACTS, 3); frames (CONTACTS, 3, 3) whose
        first row is the normal from cylinder to box, the same for all contacts.
    """

    def to_box(x: jax.Array) -> jax.Array:
        return jnp.sum(box.mat * x[:, None], axis=0)

    pair = _Pair(
        to_box(cylinder.pos - box.pos),
        to_box(cylinder.mat[:, 2]),
        cylinder.size[0],
        cylinder.size[1],
        box.size,
    )
    n, gap, on_face = _least_penetration(pair)
    # Both branches are computed and one is kept: the normal of the unused one is replaced by a harmless one.
    face_gaps, face_pos = _on_face(pair, jnp.where(on_face, n, jnp.array([0.0, 0.0, 1.0])), gap)
    edge_gaps, edge_pos = _on_edge(pair, n, gap)
    dist = jnp.where(on_face, face_gaps, edge_gaps)
    pos = jnp.where(on_face, face_pos, edge_pos)
    pos = box.pos + jnp.sum(box.mat * pos[:, None], axis=-1)
    # Negated: MuJoCo's normals point from the first geom of a pair, the cylinder, to the second.
    frame = _frame(-jnp.sum(box.mat * n, axis=-1))
    return dist, pos, jnp.tile(frame, (CONTACTS, 1, 1))


def check_mjx_version() -> str:
    """Return the version of mujoco-mjx, whose private names are used here.

    Raises:
        EngineError: It is missing, or another one.
    """
    try:
        found = metadata.version("mujoco-mjx")
    except metadata.PackageNotFoundError:
        raise EngineError(f"mujoco-mjx is not installed; {MJX_VERSION} is needed") from None
    if found != MJX_VERSION:
        raise EngineError(f"found mujoco-mjx {found}; cylinder_box needs exactly {MJX_VERSION}")
    return found


def register_collision() -> None:
    """Register the pair cylinder-box in MJX-JAX; call it before `mjx.put_model`.

    MJX has no public way to add a collision function, so this writes into its private table, and only in the
    one version in which that was checked. Calling it again changes nothing.

    Raises:
        EngineError: mujoco-mjx is missing, of another version, or lacks the private names.
    """
    found = check_mjx_version()
    package = "mujoco.mjx._src"
    try:
        table = import_module(f"{package}.collision_driver")._COLLISION_FUNC
        collider = import_module(f"{package}.collision_primitive").collider
        types = import_module(f"{package}.types").GeomType
        key = types.CYLINDER, types.BOX
    except (ImportError, AttributeError) as missing:
        raise EngineError(f"mujoco-mjx {found} lacks a private name: {missing}") from missing
    # Wrapping it a second time would make other programs of the same model.
    if getattr(table.get(key), "implementation", None) is cylinder_box:
        return
    function = collider(ncon=CONTACTS)(cylinder_box)
    function.implementation = cylinder_box
    table[key] = function
