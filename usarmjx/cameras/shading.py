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

from usarmjx.base.arrays import Array
from usarmjx.cameras.lenses import TILE
from usarmjx.cameras.light import (
    AMBIENT,
    AMBIENT_GRADIENT,
    DIFFUSE,
    HEADLIGHT_BRIGHTNESS,
    INDOOR_AMBIENT,
    Headlights,
    PointLights,
    daylight,
    falloff,
    spot_falloff,
)
from usarmjx.cameras.paint import ARENA_LABEL, PLANE, SKY_LABEL, GeomAppearance
from usarmjx.models.spec.shapes import GLASS, MATERIALS, MIRROR, SKY
from usarmjx.sensors.rays.raycast import GeomHits, RayQuery, nearest_hits, normals
from usarmjx.sensors.rays.targets import PADDING_DISTANCE, Geoms

SKY_RGB = np.array([0.93, 0.95, 0.97], np.float32)
NIGHT_RGB = np.array([0.1, 0.11, 0.14], np.float32)
"""The sky above arenas with lamps."""
CHECKER_RGB = np.array([[0.86, 0.86, 0.84], [0.78, 0.78, 0.76]], np.float32)
"""Colours of the floor's checkers."""
FLOOR_RGB = np.array([0.87, 0.88, 0.88], np.float32)
"""Colour of the floor beyond them."""
BRICK_CONTRAST = 0.03
"""By which share the bricks of the arena's solids are brighter or darker than their colour."""
RAY_BIAS, RAY_BIAS_PER_METRE = 5e-4, 3e-5
"""Rays that leave a surface start this far off [m], and this far for every metre of the way there."""
TILE_BUNDLE_SIZE = TILE * TILE
"""Rays that go about the same way."""
MIN_LIGHT = 1e-3
"""Light that is not looked for."""
SOLID_QUERY = RayQuery(transparent=frozenset({SKY, GLASS}), bundle_size=TILE_BUNDLE_SIZE)
PANE_QUERY = RayQuery(transparent=frozenset(MATERIALS) - {GLASS}, bundle_size=TILE_BUNDLE_SIZE)
"""What rays pass that look for solids, and for panes."""


class RenderScene(struct.PyTreeNode, kw_only=True):
    """All that there is to see in one world.

    Attributes:
        geoms: What rays meet; of whole worlds with the owners of `paint.robot_geom_owner`.
        appearance: What that looks like.
        sun_direction: Direction to the sun, a unit vector (3,).
        lights: The arena's lamps; with any, there is no sun.
        headlights: The robots' headlights.
        checker_size: Side of the floor's checkers [m] ().
        checker_bounds: Where the floor has checkers: least and largest x and y [m] (2, 2).
    """

    geoms: Geoms
    appearance: GeomAppearance
    sun_direction: Array
    lights: PointLights
    headlights: Headlights
    checker_size: Array
    checker_bounds: Array


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
        geom_index: On which geom (rays,).
        point: Just off its surface [m] (3, rays).
        normal: The surface's, towards the rays (3, rays).
        rgb: Its colour (3, rays).
    """

    met: jax.Array
    geom_index: jax.Array
    point: jax.Array
    normal: jax.Array
    rgb: jax.Array


def shade(
    render_scene: RenderScene, origin: jax.Array, direction: jax.Array, exclude_owner: jax.Array
) -> Shaded:
    """Return what rays see.

    Args:
        render_scene: What there is.
        origin: Where they start [m] (rays, 3).
        direction: Unit vectors (rays, 3).
        exclude_owner: Geoms of this owner are transparent to them; `EXCLUDE_NONE`: none ().
    """
    first = nearest_hits(
        render_scene.geoms, origin, direction, SOLID_QUERY.replace(exclude_owner=exclude_owner)
    )
    surface = _surface(render_scene, first, origin, direction)
    rgb = _lit(render_scene, surface)
    if MIRROR in render_scene.geoms.materials:
        gloss = jnp.where(
            surface.met, jnp.asarray(render_scene.appearance.reflectance)[surface.geom_index], 0.0
        )
        rgb = _if(
            (gloss > 0).any(), lambda rgb: _reflected(render_scene, surface, direction, gloss, rgb), rgb
        )
    if GLASS in render_scene.geoms.materials:
        query = PANE_QUERY.replace(exclude_owner=exclude_owner)
        pane = nearest_hits(render_scene.geoms, origin, direction, query)
        pane = GeomHits(pane.distance, jnp.where(pane.distance < first.distance, pane.geom_index, -1))
        rgb = _if(
            (pane.geom_index >= 0).any(),
            lambda rgb: _behind_panes(render_scene, pane, origin, direction, rgb),
            rgb,
        )
    label = jnp.where(surface.met, jnp.asarray(render_scene.appearance.label)[surface.geom_index], SKY_LABEL)
    return Shaded(rgb.T, first.distance, label)


def _if(needed: jax.Array, change: Callable[[jax.Array], jax.Array], value: jax.Array) -> jax.Array:
    return jax.lax.cond(needed, change, lambda value: value, value)


def _dot(a: jax.Array, b: jax.Array) -> jax.Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _reflected(
    render_scene: RenderScene, surface: _Surface, along: jax.Array, gloss: jax.Array, rgb: jax.Array
) -> jax.Array:
    """Return colours with what mirrors reflect, in which a camera sees all of its robot."""
    ahead = along.T
    back = ahead - 2 * _dot(ahead, surface.normal) * surface.normal
    start, back = _needed(gloss > 0, surface.point, back)
    first = nearest_hits(render_scene.geoms, start, back, SOLID_QUERY)
    mirrored = _lit(render_scene, _surface(render_scene, first, start, back))
    return jnp.where(gloss > 0, (1 - gloss) * rgb + gloss * mirrored, rgb)


def _behind_panes(
    render_scene: RenderScene, pane: GeomHits, start: jax.Array, along: jax.Array, rgb: jax.Array
) -> jax.Array:
    """Return colours with the panes that are in front of them: lit, whatever is in between."""
    surface = _surface(render_scene, pane, start, along)
    clear = jnp.asarray(render_scene.appearance.transparency)[surface.geom_index]
    seen = (1 - clear) * _lit(render_scene, surface, shadows=False) + clear * rgb
    return jnp.where(surface.met, seen, rgb)


def _surface(render_scene: RenderScene, first: GeomHits, start: jax.Array, along: jax.Array) -> _Surface:
    met, which = first.geom_index >= 0, jnp.maximum(first.geom_index, 0)
    reach = jnp.where(met, first.distance, 0.0)
    point, normal = start.T + reach * along.T, normals(render_scene.geoms, first, start, along).T
    kinds = zip(render_scene.geoms.kinds, render_scene.geoms.blocks, strict=True)
    floor = np.concatenate([np.full(len(block.owner), kind == PLANE) for kind, block in kinds])
    of_floor = jnp.asarray(floor)[which]
    rgb = jnp.asarray(render_scene.appearance.rgb).T[:, which]
    bricks = (jnp.asarray(render_scene.appearance.label)[which] == ARENA_LABEL) & ~of_floor
    rgb *= jnp.where(bricks, 1 + BRICK_CONTRAST * _bricks(render_scene, point, normal), 1.0)
    rgb = jnp.where(of_floor, _checkers(render_scene, point), rgb)
    return _Surface(met, which, point + (RAY_BIAS + RAY_BIAS_PER_METRE * reach) * normal, normal, rgb)


def _checkers(render_scene: RenderScene, point: jax.Array) -> jax.Array:
    """Return the floor's colour at points (3, rays)."""
    x, y = point[0], point[1]
    odd = (jnp.floor(x / render_scene.checker_size) + jnp.floor(y / render_scene.checker_size)).astype(
        int
    ) % 2 == 1
    (x0, x1), (y0, y1) = render_scene.checker_bounds
    within = (x > x0) & (x < x1) & (y > y0) & (y < y1)
    light, dark = CHECKER_RGB[:, :, None]
    return jnp.where(within, jnp.where(odd, dark, light), FLOOR_RGB[:, None])


def _bricks(render_scene: RenderScene, point: jax.Array, normal: jax.Array) -> jax.Array:
    """Return -1 or 1 by turns along a surface: on walls bricks half as high as long, on ground squares."""
    level = jnp.abs(normal[2]) > 0.7
    side = point[1] * normal[0] - point[0] * normal[1]  # along a wall
    across = jnp.where(level, point[0], side) / render_scene.checker_size
    up = jnp.where(level, point[1], 2 * point[2]) / render_scene.checker_size
    return 1.0 - 2.0 * ((jnp.floor(across) + jnp.floor(up)).astype(int) % 2)


def _lit(render_scene: RenderScene, surface: _Surface, *, shadows: bool = True) -> jax.Array:
    """Return the colours of surfaces in their light (3, rays), of the sky where rays met nothing."""
    day = daylight(render_scene.lights)
    everywhere = jnp.where(day > 0, AMBIENT, INDOOR_AMBIENT) * (
        1 + _dot(surface.normal, jnp.asarray(AMBIENT_GRADIENT))
    )
    light = everywhere + _main_light(render_scene, surface, day, shadows=shadows)
    if len(render_scene.headlights.on):
        on = jnp.asarray(render_scene.headlights.on).any()
        light = _if(on, lambda light: light + _headlight(render_scene, surface, shadows=shadows), light)
    sky = jnp.where(day > 0, SKY_RGB, NIGHT_RGB)[:, None]
    return jnp.where(surface.met, jnp.clip(surface.rgb * light, 0, 1), sky)


def _main_light(render_scene: RenderScene, surface: _Surface, day: jax.Array, *, shadows: bool) -> jax.Array:
    """Return the light of the sun, or of the lamp that gives most (3, rays)."""
    facing = jnp.clip(_dot(surface.normal, jnp.asarray(render_scene.sun_direction)), 0.0)
    best = DIFFUSE * 3 * day * facing  # of all three colours together
    colour = jnp.broadcast_to(jnp.ones((3, 1)) / 3, surface.point.shape)
    toward = jnp.broadcast_to(render_scene.sun_direction[:, None], surface.point.shape)
    away = jnp.full(len(best), jnp.inf)
    for pos, rgb in zip(render_scene.lights.pos, render_scene.lights.rgb, strict=True):
        way, distance = _way(surface.point, pos)
        total = rgb.sum()
        lamp = total * jnp.clip(_dot(surface.normal, way), 0.0) * falloff(distance)
        more = lamp > best
        best, toward = jnp.where(more, lamp, best), jnp.where(more, way, toward)
        away = jnp.where(more, distance, away)
        colour = jnp.where(more, rgb[:, None] / jnp.maximum(total, MIN_LIGHT), colour)
    if shadows:
        block = _between(render_scene, surface.met & (best > MIN_LIGHT), surface, toward)
        best *= block.distance >= away
    return best * colour


def _headlight(render_scene: RenderScene, surface: _Surface, *, shadows: bool) -> jax.Array:
    """Return the light of the headlight that gives most (rays,); its own robot does not stand in its way."""
    best, toward = jnp.zeros(len(surface.met)), jnp.zeros_like(surface.point)
    away, label = jnp.zeros(len(surface.met)), jnp.zeros(len(surface.met), int)
    lights = render_scene.headlights
    for pos, along, on, robot in zip(lights.pos, lights.direction, lights.on, lights.label, strict=True):
        way, distance = _way(surface.point, pos)
        own = jnp.clip(_dot(surface.normal, way), 0.0) * spot_falloff(-_dot(way, along))
        own *= HEADLIGHT_BRIGHTNESS * falloff(distance) * on
        more = own > best
        best, away = jnp.where(more, own, best), jnp.where(more, distance, away)
        toward, label = jnp.where(more, way, toward), jnp.where(more, robot, label)
    if shadows:
        wanted = surface.met & (best > MIN_LIGHT)
        block = _between(render_scene, wanted, surface, toward)
        own = jnp.asarray(render_scene.appearance.label)[jnp.maximum(block.geom_index, 0)] == label
        best *= wanted & ((block.distance >= away) | (own & (block.geom_index >= 0)))
    return best


def _way(point: jax.Array, to: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return unit vectors from points (3, rays) to a place (3,), and how far it is [m] (rays,)."""
    way = jnp.asarray(to)[:, None] - point
    distance = jnp.sqrt(_dot(way, way))
    return way / jnp.maximum(distance, 1e-9), distance


def _between(render_scene: RenderScene, wanted: jax.Array, surface: _Surface, toward: jax.Array) -> GeomHits:
    """Return what is met first on the way from surfaces to a light."""
    start, along = _needed(wanted, surface.point, toward)
    return nearest_hits(render_scene.geoms, start, along, SOLID_QUERY)


def _padded(values: jax.Array, missing: int) -> jax.Array:
    return jnp.pad(values, (0, missing))  # pyright: ignore[reportUnknownMemberType] - jnp.pad is half typed


def _needed(wanted: jax.Array, start: jax.Array, along: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return rays (rays, 3) of which those that are not wanted do as another one of their bundle.

    A bundle of which none is wanted looks up from far above, where it meets nothing and costs little.
    """
    missing = -len(wanted) % TILE_BUNDLE_SIZE
    asked = _padded(wanted, missing).reshape(-1, TILE_BUNDLE_SIZE)
    other = jnp.argmax(asked, 1)[:, None]
    some, up = asked.any(1)[:, None], jnp.array([0.0, 0.0, 1.0])

    def chosen(rows: jax.Array, otherwise: jax.Array) -> jax.Array:
        columns: list[jax.Array] = []
        for row, fill in zip(rows, otherwise, strict=True):
            row = _padded(row, missing).reshape(asked.shape)
            row = jnp.where(asked, row, jnp.take_along_axis(row, other, 1))
            columns.append(jnp.where(some, row, fill).reshape(-1)[: len(wanted)])
        return jnp.stack(columns, -1)

    return chosen(start, PADDING_DISTANCE * up), chosen(along, up)
