"""What rays see: the one place where geoms get their colours, for cameras and for still pictures.

A surface has light from everywhere, that of the sun or of the one lamp that gives it most, and that of the
headlight that gives it most, the latter two if nothing stands in between. Mirrors reflect once; glass and
water mix their own colour with what is behind them, and lights shine through them. Floors have checkers,
and the arena's solids a faint pattern of bricks, so that there is structure to see.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.transforms import Array
from usarmjx.cameras.lenses import TILE
from usarmjx.cameras.light import (
    AMBIENT,
    BEAM,
    DIFFUSE,
    INDOORS,
    ROUND,
    Headlights,
    Lamps,
    beam,
    daylight,
    falloff,
)
from usarmjx.cameras.paint import ARENA, NOBODY, PLANE, SKY_LABEL, Paint
from usarmjx.models.spec.robot import GLASS, MATERIALS, MIRROR, SKY
from usarmjx.sensors.rays.raycast import First, Gaze, nearest, normals
from usarmjx.sensors.rays.targets import FAR_AWAY, Geoms

SKY_RGB = np.array([0.93, 0.95, 0.97], np.float32)
NIGHT_RGB = np.array([0.1, 0.11, 0.14], np.float32)
"""The sky above arenas with lamps."""
TILES = np.array([[0.86, 0.86, 0.84], [0.78, 0.78, 0.76]], np.float32)
"""Colours of the floor's checkers."""
PLAIN = np.array([0.87, 0.88, 0.88], np.float32)
"""Colour of the floor beyond them."""
TINT = 0.03
"""By which share the bricks of the arena's solids are brighter or darker than their colour."""
LIFT, LIFT_FAR = 5e-4, 3e-5
"""Rays that leave a surface start this far off [m], and this far for every metre of the way there."""
BUNDLE = TILE * TILE
"""Rays that go about the same way."""
FAINT = 1e-3
"""Light that is not looked for."""
SOLID = Gaze(frozenset({SKY, GLASS}), BUNDLE)
PANES = Gaze(frozenset(MATERIALS) - {GLASS}, BUNDLE)
"""What rays pass that look for solids, and for panes."""


class Stage(struct.PyTreeNode, kw_only=True):
    """All that there is to see in one world.

    Attributes:
        geoms: What rays meet; of whole worlds with the owners of `paint.piece_of`.
        paint: What that looks like.
        sun: Direction to the sun, a unit vector (3,).
        lamps: The arena's lamps; with any, there is no sun.
        headlights: The robots' headlights.
        tile: Side of the floor's checkers [m] ().
        tiled: Where the floor has checkers: least and largest x and y [m] (2, 2).
    """

    geoms: Geoms
    paint: Paint
    sun: Array
    lamps: Lamps
    headlights: Headlights
    tile: Array
    tiled: Array


class Shaded(NamedTuple):
    """What rays see.

    Attributes:
        rgb: Colours in [0, 1] (rays, 3).
        distance: How far away it is, infinite where it is the sky; glass does not count [m] (rays,).
        label: What it is, see `paint` (rays,).
    """

    rgb: jax.Array
    distance: jax.Array
    label: jax.Array


class _Surface(NamedTuple):
    """Where rays end.

    Vectors have their components first, as processors like it: (3, rays).

    Attributes:
        met: Whether they end at all (rays,).
        which: On which geom (rays,).
        point: Just off its surface [m] (3, rays).
        normal: The surface's, towards the rays (3, rays).
        rgb: Its colour (3, rays).
    """

    met: jax.Array
    which: jax.Array
    point: jax.Array
    normal: jax.Array
    rgb: jax.Array


def shade(stage: Stage, start: jax.Array, along: jax.Array, viewer: jax.Array) -> Shaded:
    """Return what rays see.

    Args:
        stage: What there is.
        start: Where they start [m] (rays, 3).
        along: Unit vectors (rays, 3).
        viewer: Geoms of this owner are transparent to them; `NOBODY`: none ().
    """
    first = nearest(stage.geoms, start, along, viewer, SOLID)
    surface = _surface(stage, first, start, along)
    rgb = _lit(stage, surface)
    if MIRROR in stage.geoms.materials:
        gloss = jnp.where(surface.met, jnp.asarray(stage.paint.gloss)[surface.which], 0.0)
        rgb = _if((gloss > 0).any(), lambda rgb: _reflected(stage, surface, along, gloss, rgb), rgb)
    if GLASS in stage.geoms.materials:
        pane = nearest(stage.geoms, start, along, viewer, PANES)
        pane = First(pane.distance, jnp.where(pane.distance < first.distance, pane.which, -1))
        rgb = _if((pane.which >= 0).any(), lambda rgb: _behind_panes(stage, pane, start, along, rgb), rgb)
    label = jnp.where(surface.met, jnp.asarray(stage.paint.label)[surface.which], SKY_LABEL)
    return Shaded(rgb.T, first.distance, label)


def _if(needed: jax.Array, change: Callable[[jax.Array], jax.Array], value: jax.Array) -> jax.Array:
    return jax.lax.cond(needed, change, lambda value: value, value)


def _dot(a: jax.Array, b: jax.Array) -> jax.Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _reflected(
    stage: Stage, surface: _Surface, along: jax.Array, gloss: jax.Array, rgb: jax.Array
) -> jax.Array:
    """Return colours with what mirrors reflect, in which a camera sees all of its robot."""
    ahead = along.T
    back = ahead - 2 * _dot(ahead, surface.normal) * surface.normal
    start, back = _needed(gloss > 0, surface.point, back)
    first = nearest(stage.geoms, start, back, jnp.asarray(NOBODY), SOLID)
    mirrored = _lit(stage, _surface(stage, first, start, back))
    return jnp.where(gloss > 0, (1 - gloss) * rgb + gloss * mirrored, rgb)


def _behind_panes(stage: Stage, pane: First, start: jax.Array, along: jax.Array, rgb: jax.Array) -> jax.Array:
    """Return colours with the panes that are in front of them: lit, whatever is in between."""
    surface = _surface(stage, pane, start, along)
    clear = jnp.asarray(stage.paint.clear)[surface.which]
    seen = (1 - clear) * _lit(stage, surface, shadows=False) + clear * rgb
    return jnp.where(surface.met, seen, rgb)


def _surface(stage: Stage, first: First, start: jax.Array, along: jax.Array) -> _Surface:
    met, which = first.which >= 0, jnp.maximum(first.which, 0)
    reach = jnp.where(met, first.distance, 0.0)
    point, normal = start.T + reach * along.T, normals(stage.geoms, first, start, along).T
    kinds = zip(stage.geoms.types, stage.geoms.blocks, strict=True)
    floor = np.concatenate([np.full(len(block.owner), kind == PLANE) for kind, block in kinds])
    of_floor = jnp.asarray(floor)[which]
    rgb = jnp.asarray(stage.paint.rgb).T[:, which]
    bricks = (jnp.asarray(stage.paint.label)[which] == ARENA) & ~of_floor
    rgb *= jnp.where(bricks, 1 + TINT * _bricks(stage, point, normal), 1.0)
    rgb = jnp.where(of_floor, _checkers(stage, point), rgb)
    return _Surface(met, which, point + (LIFT + LIFT_FAR * reach) * normal, normal, rgb)


def _checkers(stage: Stage, point: jax.Array) -> jax.Array:
    """Return the floor's colour at points (3, rays)."""
    x, y = point[0], point[1]
    odd = (jnp.floor(x / stage.tile) + jnp.floor(y / stage.tile)).astype(int) % 2 == 1
    (x0, x1), (y0, y1) = stage.tiled
    within = (x > x0) & (x < x1) & (y > y0) & (y < y1)
    light, dark = TILES[:, :, None]
    return jnp.where(within, jnp.where(odd, dark, light), PLAIN[:, None])


def _bricks(stage: Stage, point: jax.Array, normal: jax.Array) -> jax.Array:
    """Return -1 or 1 by turns along a surface: on walls bricks half as high as long, on ground squares."""
    level = jnp.abs(normal[2]) > 0.7
    side = point[1] * normal[0] - point[0] * normal[1]  # along a wall
    across = jnp.where(level, point[0], side) / stage.tile
    up = jnp.where(level, point[1], 2 * point[2]) / stage.tile
    return 1.0 - 2.0 * ((jnp.floor(across) + jnp.floor(up)).astype(int) % 2)


def _lit(stage: Stage, surface: _Surface, *, shadows: bool = True) -> jax.Array:
    """Return the colours of surfaces in their light (3, rays), of the sky where rays met nothing."""
    day = daylight(stage.lamps)
    everywhere = jnp.where(day > 0, AMBIENT, INDOORS) * (1 + _dot(surface.normal, jnp.asarray(ROUND)))
    light = everywhere + _main_light(stage, surface, day, shadows=shadows)
    if len(stage.headlights.on):
        on = jnp.asarray(stage.headlights.on).any()
        light = _if(on, lambda light: light + _headlight(stage, surface, shadows=shadows), light)
    sky = jnp.where(day > 0, SKY_RGB, NIGHT_RGB)[:, None]
    return jnp.where(surface.met, jnp.clip(surface.rgb * light, 0, 1), sky)


def _main_light(stage: Stage, surface: _Surface, day: jax.Array, *, shadows: bool) -> jax.Array:
    """Return the light of the sun, or of the lamp that gives most (3, rays)."""
    facing = jnp.clip(_dot(surface.normal, stage.sun), 0.0)
    best = DIFFUSE * 3 * day * facing  # of all three colours together
    colour = jnp.broadcast_to(jnp.ones((3, 1)) / 3, surface.point.shape)
    toward = jnp.broadcast_to(stage.sun[:, None], surface.point.shape)
    away = jnp.full(len(best), jnp.inf)
    for pos, rgb in zip(stage.lamps.pos, stage.lamps.rgb, strict=True):
        way, distance = _way(surface.point, pos)
        total = rgb.sum()
        lamp = total * jnp.clip(_dot(surface.normal, way), 0.0) * falloff(distance)
        more = lamp > best
        best, toward = jnp.where(more, lamp, best), jnp.where(more, way, toward)
        away = jnp.where(more, distance, away)
        colour = jnp.where(more, rgb[:, None] / jnp.maximum(total, FAINT), colour)
    if shadows:
        block = _between(stage, surface.met & (best > FAINT), surface, toward)
        best *= block.distance >= away
    return best * colour


def _headlight(stage: Stage, surface: _Surface, *, shadows: bool) -> jax.Array:
    """Return the light of the headlight that gives most (rays,); its own robot does not stand in its way."""
    best, toward = jnp.zeros(len(surface.met)), jnp.zeros_like(surface.point)
    away, label = jnp.zeros(len(surface.met)), jnp.zeros(len(surface.met), int)
    lights = stage.headlights
    for pos, along, on, robot in zip(lights.pos, lights.along, lights.on, lights.label, strict=True):
        way, distance = _way(surface.point, pos)
        own = jnp.clip(_dot(surface.normal, way), 0.0) * beam(-_dot(way, along))
        own *= BEAM * falloff(distance) * on
        more = own > best
        best, away = jnp.where(more, own, best), jnp.where(more, distance, away)
        toward, label = jnp.where(more, way, toward), jnp.where(more, robot, label)
    if shadows:
        wanted = surface.met & (best > FAINT)
        block = _between(stage, wanted, surface, toward)
        own = jnp.asarray(stage.paint.label)[jnp.maximum(block.which, 0)] == label
        best *= wanted & ((block.distance >= away) | (own & (block.which >= 0)))
    return best


def _way(point: jax.Array, to: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return unit vectors from points (3, rays) to a place (3,), and how far it is [m] (rays,)."""
    way = jnp.asarray(to)[:, None] - point
    distance = jnp.sqrt(_dot(way, way))
    return way / jnp.maximum(distance, 1e-9), distance


def _between(stage: Stage, wanted: jax.Array, surface: _Surface, toward: jax.Array) -> First:
    """Return what is met first on the way from surfaces to a light."""
    start, along = _needed(wanted, surface.point, toward)
    return nearest(stage.geoms, start, along, jnp.asarray(NOBODY), SOLID)


def _needed(wanted: jax.Array, start: jax.Array, along: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return rays (rays, 3) of which those that are not wanted do as another one of their bundle.

    A bundle of which none is wanted looks up from far above, where it meets nothing and costs little.
    """
    missing = -len(wanted) % BUNDLE
    asked = jnp.pad(wanted, (0, missing)).reshape(-1, BUNDLE)
    other = jnp.argmax(asked, 1)[:, None]
    some, up = asked.any(1)[:, None], jnp.array([0.0, 0.0, 1.0])

    def chosen(rows: jax.Array, otherwise: jax.Array) -> jax.Array:
        columns = []
        for row, fill in zip(rows, otherwise, strict=True):
            row = jnp.pad(row, (0, missing)).reshape(asked.shape)
            row = jnp.where(asked, row, jnp.take_along_axis(row, other, 1))
            columns.append(jnp.where(some, row, fill).reshape(-1)[: len(wanted)])
        return jnp.stack(columns, -1)

    return chosen(start, FAR_AWAY * up), chosen(along, up)
