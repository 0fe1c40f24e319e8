"""Overlaps of rectangles and discs on a plan: depth, direction and contact point of pairs.

Coordinates are separate arrays: rows of two would leave the CPU's vector units empty.
"""

from typing import NamedTuple

import jax.numpy as jnp

from usarmjx.base.backend import Array

FLAT_TOLERANCE = 1e-3
"""Distance within which two corners count as equally near: their side lies flat [m]."""
LARGE_DISTANCE = 1e6
"""Distance beyond all distances [m]; an infinity has no gradient."""
CORNER_SIGNS = ((1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0))
"""Signs of a rectangle's corners, along the first and the second side."""


class Outlines(NamedTuple):
    """Rectangles and discs on the plan, of shapes that broadcast.

    Attributes:
        x: Centres [m] (...,).
        y: Centres [m] (...,).
        cos: Cosine of the first side's direction (...,).
        sin: Sine of the first side's direction (...,).
        length: Half the first side [m]; 0 for a disc (...,).
        width: Half the second side [m]; 0 for a disc (...,).
        radius: Radius of discs [m]; 0 for rectangles (...,).
    """

    x: Array
    y: Array
    cos: Array
    sin: Array
    length: Array
    width: Array
    radius: Array


def outlines(pos: Array, axis: Array, half: Array, radius: Array) -> Outlines:
    """Return outlines from centres, axes and half sides (..., 2), and radii (...,)."""
    x, y, cos, sin, length, width = (part[..., i] for part in (pos, axis, half) for i in range(2))
    return Outlines(x, y, cos, sin, length, width, radius)


def rectangle_overlap(one: Outlines, other: Outlines) -> tuple[Array, Array, Array]:
    """Return the overlap depths of rectangles, and the directions out of it for the first (x and y).

    Separating-axis test: the way out is the shortest along the four sides' normals, towards the side of the
    rectangle's centre, so that nothing passes through a thin wall.
    """
    dx, dy = one.x - other.x, one.y - other.y
    # Rectangles are symmetric: of the angle between them the signs do not matter.
    c = jnp.abs(one.cos * other.cos + one.sin * other.sin)
    s = jnp.abs(one.cos * other.sin - one.sin * other.cos)
    ways: list[tuple[Array, Array, Array]] = []
    for mine, theirs in ((one, other), (other, one)):
        ahead, aside = dx * mine.cos + dy * mine.sin, dy * mine.cos - dx * mine.sin
        reach = mine.length + theirs.length * c + theirs.width * s
        ways.append(_axis_overlap(reach, ahead, mine.cos, mine.sin))
        reach = mine.width + theirs.length * s + theirs.width * c
        ways.append(_axis_overlap(reach, aside, -mine.sin, mine.cos))
    depth, out_x, out_y = ways[0]
    # The first of equal ways wins, as in Warp's version.
    for reach, x, y in ways[1:]:
        nearer = reach < depth
        depth = jnp.where(nearer, reach, depth)
        out_x, out_y = jnp.where(nearer, x, out_x), jnp.where(nearer, y, out_y)
    return depth, out_x, out_y


def _axis_overlap(reach: Array, apart: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return the depth along a normal, and the normal pointing to the centre's side."""
    # Not `sign`, which is 0 for centres above each other: then there would be no way out.
    sign = jnp.where(apart < 0, -1.0, 1.0)
    return reach - jnp.abs(apart), sign * x, sign * y


def disc_overlap(one: Outlines, other: Outlines) -> tuple[Array, Array, Array]:
    """Return the overlap depths of rectangles and discs, and the rectangles' directions out (x and y)."""
    dx, dy = other.x - one.x, other.y - one.y
    ahead, left = dx * one.cos + dy * one.sin, dy * one.cos - dx * one.sin
    out_x = ahead - jnp.clip(ahead, -one.length, one.length)
    out_y = left - jnp.clip(left, -one.width, one.width)
    square = out_x * out_x + out_y * out_y
    # Far below any length: here direction and derivative of the root are undefined.
    is_in = square < 1e-18
    # A root of 0 has an infinite derivative, which `where` alone would not keep out of the gradient.
    far = jnp.sqrt(jnp.where(is_in, 1.0, square))
    # Centre inside the rectangle: leave by the nearest side.
    gap_x, gap_y = one.length - jnp.abs(ahead), one.width - jnp.abs(left)
    by_x = gap_x <= gap_y
    in_x = jnp.where(by_x, jnp.where(ahead < 0, -1.0, 1.0), 0.0)
    in_y = jnp.where(by_x, 0.0, jnp.where(left < 0, -1.0, 1.0))
    own_x, own_y = jnp.where(is_in, in_x, out_x / far), jnp.where(is_in, in_y, out_y / far)
    depth = jnp.where(is_in, other.radius + jnp.minimum(gap_x, gap_y), other.radius - far)
    return depth, -(own_x * one.cos - own_y * one.sin), -(own_x * one.sin + own_y * one.cos)


def contact_coordinates(
    one: Outlines, other: Outlines, direction: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Return the contact of rectangles: the midpoint of the common span of their nearest corners.

    Args:
        one: Rectangles that move along `direction`.
        other: Rectangles that they leave; arbitrary for discs.
        direction: Unit vectors, x and y.

    Returns:
        Coordinates along the direction, and to its left.
    """
    x, y = direction
    mine, theirs = _corners(one), _corners(other)
    # All corners within the tolerance count: a flat side touches along its whole length, not at a corner.
    low, high = ([cx * x + cy * y for cx, cy in corners] for corners in (mine, theirs))
    bottom, top = _minimum(low), -_minimum([-value for value in high])
    first, last = _corner_span(mine, direction, [value < bottom + FLAT_TOLERANCE for value in low])
    start, end = _corner_span(theirs, direction, [value > top - FLAT_TOLERANCE for value in high])
    return (bottom + top) / 2, (jnp.maximum(first, start) + jnp.minimum(last, end)) / 2


def contact_point(
    one: Outlines, other: Outlines, direction: tuple[Array, Array], place: tuple[Array, Array], *, discs: bool
) -> tuple[Array, Array]:
    """Return the contact points, x and y; for a disc the rectangle's nearest point.

    Args:
        one: Rectangles that move along `direction`.
        other: Outlines that they leave.
        direction: Unit vectors, x and y.
        place: Contacts of rectangles, see `contact_coordinates`.
        discs: Whether any may be a disc.
    """
    (x, y), (along, middle) = direction, place
    # Back from the direction's axes to those of the plan.
    at = along * x - middle * y, along * y + middle * x
    if not discs:
        return at
    dx, dy = other.x - one.x, other.y - one.y
    ahead = jnp.clip(dx * one.cos + dy * one.sin, -one.length, one.length)
    left = jnp.clip(dy * one.cos - dx * one.sin, -one.width, one.width)
    disc = other.radius > 0
    return (
        jnp.where(disc, one.x + ahead * one.cos - left * one.sin, at[0]),
        jnp.where(disc, one.y + ahead * one.sin + left * one.cos, at[1]),
    )


def _corners(one: Outlines) -> list[tuple[Array, Array]]:
    return [
        (
            one.x + i * one.length * one.cos - j * one.width * one.sin,
            one.y + i * one.length * one.sin + j * one.width * one.cos,
        )
        for i, j in CORNER_SIGNS
    ]


def _minimum(values: list[Array]) -> Array:
    """Return the minimum of arrays by comparisons, whose gradient selects one of them whatever XLA rounds."""
    least = values[0]
    for value in values[1:]:
        least = jnp.where(value < least, value, least)
    return least


def _corner_span(
    corners: list[tuple[Array, Array]], direction: tuple[Array, Array], nearest: list[Array]
) -> tuple[Array, Array]:
    """Return the interval of the nearest corners across a direction."""
    place = [cy * direction[0] - cx * direction[1] for cx, cy in corners]
    here = list(zip(nearest, place, strict=True))
    first = _minimum([jnp.where(near, value, LARGE_DISTANCE) for near, value in here])
    last = _minimum([jnp.where(near, -value, LARGE_DISTANCE) for near, value in here])
    return first, -last
