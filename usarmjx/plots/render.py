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
from usarmjx.cameras.light import SUN, lamps_of, no_headlights
from usarmjx.cameras.paint import NOBODY, Paint
from usarmjx.cameras.shading import SKY_RGB, TILES, Stage, shade
from usarmjx.models.spec.robot import GLASS, MIRROR, OPAQUE
from usarmjx.plots.scenery import Solids
from usarmjx.plots.viewpoint import look
from usarmjx.sensors.rays.kernels import KERNELS
from usarmjx.sensors.rays.targets import gather, sort_places

__all__ = ["CHUNK", "SKY_RGB", "STUDIO", "TILES", "Setting", "draw"]

CHUNK = 65_536
"""Rays that are cast together."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What lights a picture, and the floor in it.

    Attributes:
        sun: Direction to the sun; need not be a unit vector.
        tile: Side of the floor's checkers [m].
        tiled: Where the floor has them, as `ArenaSpec.extent` [m].
    """

    sun: Vec3 = SUN
    tile: float = 0.5
    tiled: tuple[tuple[float, float], tuple[float, float]] = ((-math.inf, math.inf), (-math.inf, math.inf))


STUDIO = Setting()


def _stage(solids: Solids, setting: Setting) -> Stage:
    """Return what a picture shows.

    Raises:
        UnsupportedGeomError: A kind that no kernel can hit.
    """
    if unknown := sorted({int(kind) for kind in solids.kind} - set(KERNELS)):
        raise UnsupportedGeomError(f"no ray kernel for geoms of type {unknown}")
    material = np.where(solids.clear > 0, GLASS, np.where(solids.gloss > 0, MIRROR, OPAQUE)).tolist()
    order = np.concatenate([np.zeros(0, int), *sort_places(solids.kind, material).values()])
    owner = np.full(len(solids), -1)
    return Stage(
        geoms=gather(solids.kind, solids.pos, solids.mat, solids.size, owner, material),
        paint=Paint(
            rgb=solids.rgb[order],
            clear=solids.clear[order],
            gloss=solids.gloss[order],
            label=solids.label[order],
        ),
        sun=np.array(setting.sun, np.float32) / np.float32(np.linalg.norm(setting.sun)),
        lamps=lamps_of((), 0.0),
        headlights=no_headlights(),
        tile=np.float32(setting.tile),
        tiled=np.array(setting.tiled, np.float32),
    )


@jax.jit
def _shade(stage: Stage, start: jax.Array, along: jax.Array) -> jax.Array:
    return shade(stage, start, along, jnp.asarray(NOBODY)).rgb


def draw(
    solids: Solids,
    eye: np.ndarray,
    target: np.ndarray,
    width: int,
    height: int,
    setting: Setting = STUDIO,
) -> np.ndarray:
    """Return a picture (height, width, 3) with values in [0, 1].

    Args:
        solids: What is there.
        eye: Where it is seen from (3,) [m].
        target: What is in the middle of the picture (3,) [m].
        width: Pixels along a row.
        height: Rows.
        setting: Light and floor.

    Raises:
        UnsupportedGeomError: A geom type that rays cannot hit.
    """
    stage = _stage(solids, setting)
    rows = look(eye, target, width, height).reshape(height, width, 3)
    room = ((0, -height % TILE), (0, -width % TILE), (0, 0))
    rays = tiled(np.pad(rows, room, mode="edge"))
    chunk = min(CHUNK, len(rays))
    padded = np.concatenate([rays, np.repeat(rays[-1:], -len(rays) % chunk, 0)])
    start = np.broadcast_to(np.asarray(eye, np.float32), (chunk, 3))
    seen = [np.asarray(_shade(stage, start, part)) for part in padded.reshape(-1, chunk, 3)]
    return np.asarray(untiled(jnp.asarray(np.concatenate(seen)[: len(rays)]), width, height))
