"""Still pictures of solids, shaded as what robots' cameras see: see `cameras.shading`.

Rays are cast in chunks, so that the memory that a picture takes does not grow with its size.
"""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.errors import UnsupportedGeomError
from usarmjx.base.transforms import Vec3
from usarmjx.cameras.lenses import TILE, tiled, untiled
from usarmjx.cameras.light import SUN_DIRECTION, no_headlights, point_lights
from usarmjx.cameras.paint import GeomAppearance
from usarmjx.cameras.shading import CHECKER_RGB, SKY_RGB, RenderScene, shade
from usarmjx.models.spec.shapes import GLASS, MIRROR, OPAQUE
from usarmjx.plots.scenery import RenderGeoms
from usarmjx.plots.viewpoint import camera_rays
from usarmjx.sensors.rays.kernels import RAY_KERNELS
from usarmjx.sensors.rays.raycast import EXCLUDE_NONE
from usarmjx.sensors.rays.targets import Geoms, indices_by_key, make_geoms

__all__ = ["CHECKER_RGB", "CHUNK", "DEFAULT_LIGHTING", "SKY_RGB", "Lighting", "render_picture"]

CHUNK = 65_536
"""Rays that are cast together."""


@dataclass(frozen=True, kw_only=True)
class Lighting:
    """What lights a picture, and the floor in it.

    Attributes:
        sun: Direction to the sun; need not be a unit vector.
        checker_size: Side of the floor's checkers [m].
        checker_extent: Where the floor has them, as `ArenaSpec.extent` [m].
    """

    sun: Vec3 = SUN_DIRECTION
    checker_size: float = 0.5
    checker_extent: tuple[tuple[float, float], tuple[float, float]] = (
        (-math.inf, math.inf),
        (-math.inf, math.inf),
    )


DEFAULT_LIGHTING = Lighting()


def _render_scene(solids: RenderGeoms, setting: Lighting) -> RenderScene:
    """Return what a picture shows.

    Raises:
        UnsupportedGeomError: A kind that no kernel can hit.
    """
    if unknown := sorted({int(kind) for kind in solids.kind} - set(RAY_KERNELS)):
        raise UnsupportedGeomError(f"no ray kernel for geoms of type {unknown}")
    material = np.where(
        solids.transparency > 0, GLASS, np.where(solids.reflectance > 0, MIRROR, OPAQUE)
    ).tolist()
    order = np.concatenate([np.zeros(0, int), *indices_by_key(solids.kind, material).values()])
    owner = np.full(len(solids), -1)
    geoms = make_geoms(solids.kind, solids.pos, solids.mat, solids.size, owner, material)
    appearance = GeomAppearance(
        rgb=solids.rgb[order],
        transparency=solids.transparency[order],
        reflectance=solids.reflectance[order],
        label=solids.label[order],
    )
    return lit_scene(geoms, appearance, setting)


def lit_scene(geoms: Geoms, appearance: GeomAppearance, setting: Lighting) -> RenderScene:
    """Return what there is to see in some light, without lamps."""
    return RenderScene(
        geoms=geoms,
        appearance=appearance,
        sun_direction=np.array(setting.sun, np.float32) / np.float32(np.linalg.norm(setting.sun)),
        lights=point_lights((), 0.0),
        headlights=no_headlights(),
        checker_size=np.array(setting.checker_size, np.float32),
        checker_bounds=np.array(setting.checker_extent, np.float32),
    )


@jax.jit
def _shade(render_scene: RenderScene, start: jax.Array, direction: jax.Array) -> jax.Array:
    return jnp.asarray(shade(render_scene, start, direction, jnp.asarray(EXCLUDE_NONE)).rgb)


def render_picture(
    solids: RenderGeoms,
    eye: np.ndarray,
    target: np.ndarray,
    width: int,
    height: int,
    lighting: Lighting = DEFAULT_LIGHTING,
) -> np.ndarray:
    """Return a picture (height, width, 3) with values in [0, 1].

    Args:
        solids: What is there.
        eye: Where it is seen from (3,) [m].
        target: What is in the middle of the picture (3,) [m].
        width: Pixels along a row.
        height: Rows.
        lighting: Light and floor.

    Raises:
        UnsupportedGeomError: A geom type that rays cannot hit.
    """
    render_scene = _render_scene(solids, lighting)
    rows = camera_rays(eye, target, width, height).reshape(height, width, 3)
    room = ((0, -height % TILE), (0, -width % TILE), (0, 0))
    rays = tiled(np.pad(rows, room, mode="edge"))
    chunk = min(CHUNK, len(rays))
    padded = np.concatenate([rays, np.repeat(rays[-1:], -len(rays) % chunk, 0)])
    start = jnp.asarray(np.broadcast_to(np.asarray(eye, np.float32), (chunk, 3)))
    parts = map(jnp.asarray, padded.reshape(-1, chunk, 3))
    seen = [np.asarray(_shade(render_scene, start, part)) for part in parts]
    return np.asarray(untiled(jnp.asarray(np.concatenate(seen)[: len(rays)]), width, height))
