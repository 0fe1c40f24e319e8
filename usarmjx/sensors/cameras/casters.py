"""What casts the rays of pictures: at a scene's geoms with JAX here, elsewhere with C MuJoCo.

A camera needs three things of one: what its rays meet first, where lights are hidden, and how geoms look.
"""

from collections.abc import Collection
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.models.types.shapes import GLASS, MATERIALS, SKY
from usarmjx.sensors.cameras.lenses import TILE
from usarmjx.sensors.cameras.paint import PLANE, GeomAppearance
from usarmjx.sensors.rays.raycast import RayQuery, nearest_hits
from usarmjx.sensors.rays.targets import PADDING_DISTANCE, GeomHits, Geoms, concatenated, normals

TILE_BUNDLE_SIZE = TILE * TILE
"""Rays that go about the same way."""
SOLID_QUERY = RayQuery(transparent=frozenset({SKY, GLASS}), bundle_size=TILE_BUNDLE_SIZE)
PANE_QUERY = RayQuery(transparent=frozenset(MATERIALS) - {GLASS}, bundle_size=TILE_BUNDLE_SIZE)
"""What rays pass that look for solids, and for panes."""


class RayHits(NamedTuple):
    """What rays meet first.

    Attributes:
        distance: How far away, infinite where there is nothing [m] (rays,).
        geom_index: Which geom, as its place in the caster's appearance; -1 for none (rays,).
        normal: The surface's, if that is known already (rays, 3).
    """

    distance: Array
    geom_index: Array
    normal: Array | None = None


class Beams(NamedTuple):
    """The light that surfaces get most of; vectors have their components first.

    Attributes:
        wanted: Which surfaces get any that is worth looking for (rays,).
        point: Where they are [m] (3, rays).
        toward: Unit vectors to their light (3, rays).
        away: How far away that is, infinite for the sun [m] (rays,).
        source: Which it is, as a place in `pos`; -1: the sun (rays,).
        pos: Where lights are [m] (n, 3).
        sun: Direction to the sun, a unit vector (3,).
        carrier: Labels of the robots that carry them, which do not stand in their way; None: nobody (n,).
    """

    wanted: Array
    point: Array
    toward: Array
    away: Array
    source: Array
    pos: Array
    sun: Array
    carrier: Array | None = None


class Caster(Protocol):
    """Casts the rays of one camera's pictures."""

    @property
    def appearance(self) -> GeomAppearance:
        """How geoms look."""
        ...

    @property
    def materials(self) -> Collection[str]:
        """What they are made of, altogether."""
        ...

    @property
    def is_plane(self) -> np.ndarray:
        """Which of them are planes (geoms,)."""
        ...

    def from_camera(self, origin: Array, direction: Array, query: RayQuery) -> RayHits:
        """Return what the camera's own rays meet; what covers its lens is left out.

        Args:
            origin: Where they start [m] (rays, 3).
            direction: Unit vectors (rays, 3).
            query: What they pass.
        """
        ...

    def from_surfaces(self, origin: Array, direction: Array, wanted: Array) -> RayHits:
        """Return what solids rays meet (rays, 3) that a mirror throws back; those that are wanted (rays,)."""
        ...

    def is_dark(self, beams: Beams) -> Array:
        """Return where something stands in the way of the light, of what is wanted (rays,)."""
        ...

    def normals(self, hits: RayHits, origin: Array, direction: Array) -> Array:
        """Return the unit normals of the surfaces that rays meet, towards the rays (rays, 3)."""
        ...

    def frames(self, which: Array) -> tuple[Array, Array, Array]:
        """Return where geoms are [m] (rays, 3), how they are turned (rays, 3, 3), and their sizes (rays, 3).

        Only those with a sign on them need be known.
        """
        ...


class GeomCaster:
    """Casts rays with JAX.

    Args:
        geoms: What there is.
        appearance: How it looks.
        exclude_owner: Geoms of this owner are transparent to the camera's own rays ().
    """

    def __init__(self, geoms: Geoms, appearance: GeomAppearance, exclude_owner: Array) -> None:
        self._geoms, self._exclude_owner = geoms, exclude_owner
        self.appearance, self.materials = appearance, geoms.materials
        kinds = zip(geoms.kinds, geoms.blocks, strict=True)
        self.is_plane = np.concatenate([np.full(len(block.owner), kind == PLANE) for kind, block in kinds])

    def from_camera(self, origin: Array, direction: Array, query: RayQuery) -> RayHits:
        """As `Caster` says."""
        query = query.replace(exclude_owner=self._exclude_owner)
        return RayHits(*nearest_hits(self._geoms, origin, direction, query))

    def from_surfaces(self, origin: Array, direction: Array, wanted: Array) -> RayHits:
        """As `Caster` says."""
        rays = _needed(wanted, jnp.asarray(origin).T, jnp.asarray(direction).T)
        return RayHits(*nearest_hits(self._geoms, *rays, SOLID_QUERY))

    def is_dark(self, beams: Beams) -> Array:
        """As `Caster` says; what is met first on the way to a light is in its way."""
        rays = _needed(beams.wanted, beams.point, beams.toward)
        block = nearest_hits(self._geoms, *rays, SOLID_QUERY)
        dark = block.distance < beams.away
        if beams.carrier is None:
            return dark
        label = jnp.asarray(self.appearance.label)[jnp.maximum(block.geom_index, 0)]
        own = label == jnp.asarray(beams.carrier)[jnp.maximum(beams.source, 0)]
        return dark & ~(own & (block.geom_index >= 0))

    def normals(self, hits: RayHits, origin: Array, direction: Array) -> Array:
        """As `Caster` says."""
        met_arrays = GeomHits(jnp.asarray(hits.distance), jnp.asarray(hits.geom_index))
        return normals(self._geoms, met_arrays, jnp.asarray(origin), jnp.asarray(direction))

    def frames(self, which: Array) -> tuple[Array, Array, Array]:
        """As `Caster` says."""
        geom = jax.tree.map(lambda column: jnp.asarray(column)[which], concatenated(self._geoms))
        return geom.pos, geom.mat, geom.size


def _padded(values: jax.Array, missing: int) -> jax.Array:
    return jnp.pad(values, (0, missing))  # pyright: ignore[reportUnknownMemberType] - jnp.pad is half typed


def _needed(wanted: Array, start: Array, along: Array) -> tuple[jax.Array, jax.Array]:
    """Return rays (rays, 3) of which those that are not wanted do as another one of their bundle.

    A bundle of which none is wanted looks up from far above, where it meets nothing and costs little.
    """
    missing = -len(wanted) % TILE_BUNDLE_SIZE
    asked = _padded(jnp.asarray(wanted), missing).reshape(-1, TILE_BUNDLE_SIZE)
    other = jnp.argmax(asked, 1)[:, None]
    some, up = asked.any(1)[:, None], jnp.array([0.0, 0.0, 1.0])

    def chosen(rows: Array, otherwise: jax.Array) -> jax.Array:
        columns: list[jax.Array] = []
        for row, fill in zip(jnp.asarray(rows), otherwise, strict=True):
            row = _padded(row, missing).reshape(asked.shape)
            row = jnp.where(asked, row, jnp.take_along_axis(row, other, 1))
            columns.append(jnp.where(some, row, fill).reshape(-1)[: len(wanted)])
        return jnp.stack(columns, -1)

    return chosen(start, PADDING_DISTANCE * up), chosen(along, up)
