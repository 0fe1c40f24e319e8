"""Ray casters of cameras: an interface, and its implementation on JAX; that on C MuJoCo is in `engines.c`.

A caster answers three questions: the first hits of rays, which surfaces are in shadow, and the appearance of
geoms.
"""

from collections.abc import Collection
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.models.types.shapes import GLASS, MATERIALS, SKY
from usarmjx.sensors.cameras.lenses import TILE
from usarmjx.sensors.cameras.paint import PLANE, GeomAppearance
from usarmjx.sensors.rays.raycast import RayQuery, nearest_hits
from usarmjx.sensors.rays.targets import PADDING_DISTANCE, GeomHits, Geoms, concatenated, normals

TILE_BUNDLE_SIZE = TILE * TILE
"""Rays of a tile, which have similar directions."""
SOLID_QUERY = RayQuery(transparent=frozenset({SKY, GLASS}), bundle_size=TILE_BUNDLE_SIZE)
"""Query of the first solid: rays pass the sky and panes."""
PANE_QUERY = RayQuery(transparent=frozenset(MATERIALS) - {GLASS}, bundle_size=TILE_BUNDLE_SIZE)
"""Query of the first pane of glass: rays pass all else."""


class RayHits(NamedTuple):
    """First hits of rays.

    Attributes:
        distance: Distances, infinite without a hit [m] (rays,).
        geom_index: Index of the geom in the caster's appearance; -1 for none (rays,).
        normal: Surface normals, if already known (rays, 3).
    """

    distance: Array
    geom_index: Array
    normal: Array | None = None


class Beams(NamedTuple):
    """Shadow rays from surfaces to their dominant light; vectors have their components first.

    Attributes:
        wanted: Which surfaces get enough light to test (rays,).
        point: Surface points [m] (3, rays).
        toward: Unit vectors to the light (3, rays).
        away: Distance of the light, infinite for the sun [m] (rays,).
        source: Index of the light in `pos`; -1: the sun (rays,).
        pos: Positions of the lights [m] (n, 3).
        sun: Direction to the sun, a unit vector (3,).
        carrier: Labels of the robots that carry the lights and cast no shadow in them; None: none (n,).
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
    """Ray caster of one camera's pictures."""

    @property
    def appearance(self) -> GeomAppearance:
        """Appearance of the geoms."""
        ...

    @property
    def materials(self) -> Collection[str]:
        """Materials that occur."""
        ...

    @property
    def is_plane(self) -> np.ndarray:
        """Mask of planes (geoms,)."""
        ...

    def from_camera(self, origin: Array, direction: Array, query: RayQuery) -> RayHits:
        """Cast the camera's own rays, which pass the geoms that cover the lens.

        Args:
            origin: Origins [m] (rays, 3).
            direction: Unit vectors (rays, 3).
            query: Options.
        """
        ...

    def from_surfaces(self, origin: Array, direction: Array, wanted: Array) -> RayHits:
        """Cast mirror reflections (rays, 3) at solids; only the wanted ones (rays,)."""
        ...

    def is_dark(self, beams: Beams) -> Array:
        """Return which wanted shadow rays are blocked (rays,)."""
        ...

    def normals(self, hits: RayHits, origin: Array, direction: Array) -> Array:
        """Return the unit normals at the hits, towards the ray origins (rays, 3)."""
        ...

    def frames(self, which: Array) -> tuple[Array, Array, Array]:
        """Return positions [m] (rays, 3), orientations (rays, 3, 3) and sizes (rays, 3) of geoms.

        Only those of geoms with a sign on them need to be right.
        """
        ...


class GeomCaster:
    """Ray caster on JAX.

    Args:
        geoms: The geoms.
        appearance: Their appearance.
        exclude_owner: Owner whose geoms the camera's own rays pass ().
    """

    def __init__(self, geoms: Geoms, appearance: GeomAppearance, exclude_owner: Array) -> None:
        self._geoms, self._exclude_owner = geoms, exclude_owner
        self.appearance, self.materials = appearance, geoms.materials
        kinds = zip(geoms.kinds, geoms.blocks, strict=True)
        # On NumPy, as kinds of geoms are static: the floor's colours cost nothing where there is no plane.
        self.is_plane = np.concatenate([np.full(len(block.owner), kind == PLANE) for kind, block in kinds])

    def from_camera(self, origin: Array, direction: Array, query: RayQuery) -> RayHits:
        """See `Caster`."""
        query = query.replace(exclude_owner=self._exclude_owner)
        return RayHits(*nearest_hits(self._geoms, origin, direction, query))

    def from_surfaces(self, origin: Array, direction: Array, wanted: Array) -> RayHits:
        """See `Caster`."""
        # Unwanted rays keep their place: shapes are fixed in a traced program, so none can be left out.
        rays = _masked_rays(wanted, jnp.asarray(origin).T, jnp.asarray(direction).T)
        return RayHits(*nearest_hits(self._geoms, *rays, SOLID_QUERY))

    def is_dark(self, beams: Beams) -> Array:
        """See `Caster`; a light is blocked if the first hit is nearer than the light."""
        rays = _masked_rays(beams.wanted, beams.point, beams.toward)
        block = nearest_hits(self._geoms, *rays, SOLID_QUERY)
        dark = block.distance < beams.away
        if beams.carrier is None:
            return dark
        # -1, no hit, would read the last geom's label; the result of such rays is dropped below.
        label = jnp.asarray(self.appearance.label)[jnp.maximum(block.geom_index, 0)]
        # A lamp sits in or on its robot, which would keep all of its light.
        own = label == jnp.asarray(beams.carrier)[jnp.maximum(beams.source, 0)]
        return dark & ~(own & (block.geom_index >= 0))

    def normals(self, hits: RayHits, origin: Array, direction: Array) -> Array:
        """See `Caster`."""
        met_arrays = GeomHits(jnp.asarray(hits.distance), jnp.asarray(hits.geom_index))
        return normals(self._geoms, met_arrays, jnp.asarray(origin), jnp.asarray(direction))

    def frames(self, which: Array) -> tuple[Array, Array, Array]:
        """See `Caster`."""
        geom = jax.tree.map(lambda column: jnp.asarray(column)[which], concatenated(self._geoms))
        return geom.pos, geom.mat, geom.size


def _padded(values: jax.Array, missing: int) -> jax.Array:
    return jnp.pad(values, (0, missing))  # pyright: ignore[reportUnknownMemberType] - jnp.pad is half typed


def _masked_rays(wanted: Array, start: Array, along: Array) -> tuple[jax.Array, jax.Array]:
    """Return rays (rays, 3) in which unwanted ones duplicate a wanted one of their bundle.

    A bundle without wanted rays looks up from far above, where it hits nothing and costs little.
    """
    # Filled up to whole bundles; the fill is cut off at the end.
    missing = -len(wanted) % TILE_BUNDLE_SIZE
    asked = _padded(jnp.asarray(wanted), missing).reshape(-1, TILE_BUNDLE_SIZE)
    # The first wanted ray of the bundle: copies of it do not widen the bundle's cone.
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
