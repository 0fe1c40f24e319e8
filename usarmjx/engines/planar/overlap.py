"""By how much rectangles and discs on a plan overlap, for each pair, and where, for one of them.

Coordinates are arrays of their own: rows of two leave a processor's vector units empty.
"""

from typing import NamedTuple

import jax.numpy as jnp

from usarmjx.base.arrays import Array

FLAT = 1e-3
"""A side whose corners are as near but for so much lies flat [m]."""
FAR = 1e6
"""Nothing is so far away [m]; an infinity has no slope."""
SIGNS = ((1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0))


class Outlines(NamedTuple):
    """Rectangles and discs on the plan, of shapes that can be broadcast.

    Attributes:
        x: Middles [m] (...,).
        y: Middles [m] (...,).
        cos: Of the way the first side points (...,).
        sin: Of it (...,).
        length: Half the first side [m]; 0 of a disc (...,).
        width: Half the other [m]; 0 of a disc (...,).
        radius: Of discs [m]; 0 of rectangles (...,).
    """

    x: Array
    y: Array
    cos: Array
    sin: Array
    length: Array
    width: Array
    radius: Array


def outlines(pos: Array, axis: Array, half: Array, radius: Array) -> Outlines:
    """Return outlines from middles, axes and half sides (..., 2), and radii (...,)."""
    x, y, cos, sin, length, width = (part[..., i] for part in (pos, axis, half) for i in range(2))
    return Outlines(x, y, cos, sin, length, width, radius)


def side_depth(one: Outlines, other: Outlines) -> tuple[Array, Array, Array]:
    """Return by how much rectangles overlap, and which way the one has to go (x and y).

    By the theorem of the separating axis: the way out is the shortest of those along the four sides' normals,
    to the side where the rectangle's middle is, so that nothing gets through a thin wall.
    """
    dx, dy = one.x - other.x, one.y - other.y
    c = jnp.abs(one.cos * other.cos + one.sin * other.sin)
    s = jnp.abs(one.cos * other.sin - one.sin * other.cos)
    ways: list[tuple[Array, Array, Array]] = []
    for mine, theirs in ((one, other), (other, one)):
        ahead, aside = dx * mine.cos + dy * mine.sin, dy * mine.cos - dx * mine.sin
        reach = mine.length + theirs.length * c + theirs.width * s
        ways.append(_way(reach, ahead, mine.cos, mine.sin))
        reach = mine.width + theirs.length * s + theirs.width * c
        ways.append(_way(reach, aside, -mine.sin, mine.cos))
    depth, out_x, out_y = ways[0]
    for reach, x, y in ways[1:]:
        nearer = reach < depth
        depth = jnp.where(nearer, reach, depth)
        out_x, out_y = jnp.where(nearer, x, out_x), jnp.where(nearer, y, out_y)
    return depth, out_x, out_y


def _way(reach: Array, apart: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return the depth along a normal, and that normal towards where the middle is."""
    sign = jnp.where(apart < 0, -1.0, 1.0)
    return reach - jnp.abs(apart), sign * x, sign * y


def disc_depth(one: Outlines, other: Outlines) -> tuple[Array, Array, Array]:
    """Return by how much rectangles and discs overlap, and which way the rectangle has to go (x and y)."""
    dx, dy = other.x - one.x, other.y - one.y
    ahead, left = dx * one.cos + dy * one.sin, dy * one.cos - dx * one.sin
    out_x = ahead - jnp.clip(ahead, -one.length, one.length)
    out_y = left - jnp.clip(left, -one.width, one.width)
    square = out_x * out_x + out_y * out_y
    is_in = square < 1e-18
    far = jnp.sqrt(jnp.where(is_in, 1.0, square))
    # A middle inside: by the nearest side.
    gap_x, gap_y = one.length - jnp.abs(ahead), one.width - jnp.abs(left)
    by_x = gap_x <= gap_y
    in_x = jnp.where(by_x, jnp.where(ahead < 0, -1.0, 1.0), 0.0)
    in_y = jnp.where(by_x, 0.0, jnp.where(left < 0, -1.0, 1.0))
    own_x, own_y = jnp.where(is_in, in_x, out_x / far), jnp.where(is_in, in_y, out_y / far)
    depth = jnp.where(is_in, other.radius + jnp.minimum(gap_x, gap_y), other.radius - far)
    return depth, -(own_x * one.cos - own_y * one.sin), -(own_x * one.sin + own_y * one.cos)


def meeting_place(one: Outlines, other: Outlines, way: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return where rectangles meet: in the middle of what their nearest corners have in common.

    Args:
        one: Rectangles that have to go along `way`.
        other: What they have to get out of; of a disc anything.
        way: Unit vectors, x and y.

    Returns:
        How far along the way that is, and how far to its left.
    """
    x, y = way
    mine, theirs = _corners(one), _corners(other)
    low, high = ([cx * x + cy * y for cx, cy in corners] for corners in (mine, theirs))
    bottom, top = _least(low), -_least([-value for value in high])
    first, last = _span(mine, way, [value < bottom + FLAT for value in low])
    start, end = _span(theirs, way, [value > top - FLAT for value in high])
    return (bottom + top) / 2, (jnp.maximum(first, start) + jnp.minimum(last, end)) / 2


def meeting_point(
    one: Outlines, other: Outlines, way: tuple[Array, Array], place: tuple[Array, Array], *, discs: bool
) -> tuple[Array, Array]:
    """Return where outlines meet, x and y: of a disc where the rectangle is nearest to it.

    Args:
        one: Rectangles that have to go along `way`.
        other: What they have to get out of.
        way: Unit vectors, x and y.
        place: Of rectangles, see `meeting_place`.
        discs: Whether any may be a disc.
    """
    (x, y), (along, middle) = way, place
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
        for i, j in SIGNS
    ]


def _least(values: list[Array]) -> Array:
    """Return the least of arrays: by comparing, whose slope is that of one of them whatever XLA rounds."""
    least = values[0]
    for value in values[1:]:
        least = jnp.where(value < least, value, least)
    return least


def _span(
    corners: list[tuple[Array, Array]], way: tuple[Array, Array], nearest: list[Array]
) -> tuple[Array, Array]:
    """Return from where to where corners that are nearest reach, across a way."""
    place = [cy * way[0] - cx * way[1] for cx, cy in corners]
    here = list(zip(nearest, place, strict=True))
    first = _least([jnp.where(near, value, FAR) for near, value in here])
    last = _least([jnp.where(near, -value, FAR) for near, value in here])
    return first, -last
