"""Lanes of a route network as closed paths in the plane, for tasks of cars."""

from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.errors import SpecError
from usarmjx.models.roads.geodesy import LatLon
from usarmjx.models.roads.network import RouteNetwork
from usarmjx.models.roads.shapes import lane_path, lane_width


@dataclass(frozen=True, eq=False)
class LanePath:
    """A closed path of straight edges.

    Attributes:
        points: Its corners x, y [m] (points, 2); the last one leads to the first.
        width: Of the lane [m].
    """

    points: np.ndarray
    width: float

    @cached_property
    def edges(self) -> np.ndarray:
        """From each corner to the next [m] (points, 2)."""
        return (np.roll(self.points, -1, 0) - self.points).astype(np.float32)

    @cached_property
    def lengths(self) -> np.ndarray:
        """Of the edges [m] (points,)."""
        return np.linalg.norm(self.edges, axis=-1)

    @cached_property
    def edge_starts(self) -> np.ndarray:
        """How far along each corner is [m] (points,)."""
        return np.concatenate([[0.0], np.cumsum(self.lengths)[:-1]]).astype(np.float32)

    @property
    def length(self) -> float:
        """Once round [m]."""
        return float(self.lengths.sum())

    def position(self, along: jax.Array) -> jax.Array:
        """Return the positions so far along (...,) [m] (..., 2)."""
        along = jnp.mod(along, self.length)
        edge = self._edge(along)
        share = (along - jnp.asarray(self.edge_starts)[edge]) / jnp.asarray(self.lengths)[edge]
        return jnp.asarray(self.points, jnp.float32)[edge] + share[..., None] * jnp.asarray(self.edges)[edge]

    def heading(self, along: jax.Array) -> jax.Array:
        """Return the directions of the path so far along (...,) [rad] (...,)."""
        edge = jnp.asarray(self.edges)[self._edge(jnp.mod(along, self.length))]
        return jnp.arctan2(edge[..., 1], edge[..., 0])

    def _edge(self, along: jax.Array) -> jax.Array:
        return jnp.searchsorted(jnp.asarray(self.edge_starts), along, side="right") - 1

    def nearest(self, positions: Array) -> tuple[jax.Array, jax.Array]:
        """Return how far along the nearest points to positions (..., 2) are, and how far to their left these.

        Returns:
            Both in metres (...,); the second is negative to the right.
        """
        unit = self.edges / self.lengths[:, None]
        off = positions[..., None, :] - self.points.astype(np.float32)
        along = jnp.clip((off * unit).sum(-1), 0.0, self.lengths)
        gap = off - along[..., None] * unit
        far = jnp.linalg.norm(gap, axis=-1)
        best = jnp.argmin(far, -1)[..., None]
        left = jnp.sign(unit[:, 0] * gap[..., 1] - unit[:, 1] * gap[..., 0]) * far
        there = jnp.take_along_axis(jnp.asarray(self.edge_starts) + along, best, -1)
        return there[..., 0], jnp.take_along_axis(left, best, -1)[..., 0]


def closed_lane(network: RouteNetwork, owner: tuple[int, int], origin: LatLon | None) -> LanePath:
    """Return a lane that leads back to its beginning.

    Args:
        network: The route network.
        owner: Numbers of its segment and of the lane.
        origin: Latitude and longitude of the arena's origin [degrees].

    Raises:
        SpecError: No such lane, one that ends, or an arena of which nobody knows where it lies.
    """
    lane = network.lane(*owner)
    if origin is None:
        raise SpecError("this arena has no latitude and longitude: a route network cannot be laid out in it")
    if (len(lane.waypoints), (*owner, 1)) not in lane.exits:
        raise SpecError(
            f"lane {owner[0]}.{owner[1]} ends; expected one whose last waypoint leads to its first"
        )
    return LanePath(points=lane_path(lane, origin), width=lane_width(lane))
