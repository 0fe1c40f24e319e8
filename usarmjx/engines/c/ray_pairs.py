"""Rays of several robots in one world of C MuJoCo, each against the few geoms that it may meet.

MuJoCo looks at every body of the world for every ray. Here bounding spheres pick pairs of a ray and a geom,
for all robots in a few array operations.
"""

from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np

from usarmjx.engines.c.ray_solids import MARGIN, SOLIDS, LocalRays, cone_meets_box
from usarmjx.models.types.shapes import FENDER, MATERIALS

MIN_COSINE = 0.1
"""Lowest cosine to the first ray of an origin for which a bounding cone is valid."""


class Bundles(NamedTuple):
    """Rays of several robots, each of which has the same number of rays from the same number of origins.

    Attributes:
        point: Origins [m] (robots, origins, 3).
        along: Unit vectors (robots, origins, rays, 3).
        cosine: Lowest cosine of the rays of an origin to the first one (robots, origins).
    """

    point: np.ndarray
    along: np.ndarray
    cosine: np.ndarray

    @classmethod
    def of(cls, start: np.ndarray, along: np.ndarray) -> "Bundles | None":
        """Return rays (robots, rays, 3) by origin; None: other numbers of rays, or too wide for a cone."""
        turns = np.flatnonzero((start[:, 1:] != start[:, :-1]).any((0, 2))) + 1
        origins = len(turns) + 1
        count = start.shape[1] // origins
        if start.shape[1] % origins or (turns != np.arange(1, origins) * count).any():
            return None
        fans = along.reshape(len(along), origins, count, 3)
        cosine = (fans @ fans[:, :, 0, :, None])[..., 0].min(-1)
        return cls(start[:, ::count], fans, cosine) if cosine.min() > MIN_COSINE else None


class Pairs(NamedTuple):
    """Pairs of a bundle and a geom.

    Attributes:
        bundle: Bundles, among those of all robots (pairs,).
        geom: Geoms (pairs,).
    """

    bundle: np.ndarray
    geom: np.ndarray


class RayPairs:
    """Distances to geoms of a world with current kinematics.

    Args:
        model: The model; geom groups are materials.
        data: Its state.
        robots: Geoms of each robot, by slot.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robots: Mapping[int, np.ndarray]) -> None:
        self._model, self._data = model, data
        self._kind, self._material = model.geom_type.copy(), model.geom_group.copy()
        self._is_known = np.isin(self._kind, list(SOLIDS)) & (self._material != MATERIALS.index(FENDER))
        own, shared = model.geom_rgba[:, 3], np.append(model.mat_rgba[:, 3], 1.0)[model.geom_matid]
        self._is_drawn = np.where(model.geom_matid < 0, own, shared) != 0.0  # MuJoCo's rays pass all others
        self._owner = np.full(model.ngeom, -1)
        for slot, geoms in robots.items():
            self._owner[geoms] = slot

    def nearest(
        self, start: np.ndarray, along: np.ndarray, slots: np.ndarray, solid: np.ndarray, reach: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return distances of rays [m], infinite without a hit, and cosines of incidence (robots, rays).

        Args:
            start: Ray origins [m] (robots, rays, 3).
            along: Unit vectors (robots, rays, 3).
            slots: The robots, whose own geoms their rays pass (robots,).
            solid: Whether each geom group stops rays (groups,).
            reach: Range [m]; hits beyond it may be missed.

        Returns:
            Both, and the robots for which they are right: not those near geoms of other kinds, and none if
            the rays are not bundled alike (robots,).
        """
        is_right, bundles = np.ones(len(start), bool), Bundles.of(start, along)
        if bundles is None:
            return np.full(start.shape[:2], np.inf), np.zeros(start.shape[:2]), ~is_right
        stops = (solid[self._material] != 0) & self._is_drawn & (self._owner != slots[:, None])
        pairs = self._pairs(bundles, stops, reach)
        unknown = ~self._is_known[pairs.geom]
        if unknown.any():
            is_right[pairs.bundle[unknown] // bundles.point.shape[1]] = False
        with np.errstate(all="ignore"):
            distance, cosine = self._cast(bundles, pairs)
        return distance.T.reshape(start.shape[:2]), cosine.T.reshape(start.shape[:2]), is_right

    def _pairs(self, bundles: Bundles, stops: np.ndarray, reach: float) -> Pairs:
        """Return the pairs whose rays may meet their geom, by bounding spheres and cones about the rays.

        Args:
            bundles: The rays.
            stops: Whether each geom stops rays of each robot (robots, geoms).
            reach: Range [m].
        """
        centre, bound = self._data.geom_xpos, self._model.geom_rbound
        first, axis = bundles.point[:, 0], bundles.along[:, :, 0]
        away = bundles.point - first[:, None]
        far, origins = _dots(away, away), axis.shape[1]
        most = reach + MARGIN + np.sqrt(far.max(1))[:, None] + bound
        apart = _dots(centre, centre) + _dots(first, first)[:, None] - 2.0 * (first @ centre.T)
        robot, geom = np.nonzero(stops & ((apart <= most * most) | (bound == 0.0)))  # planes have no bound
        offset, both = centre[geom] - first[robot], np.concatenate([axis, away], 1)
        ends = np.searchsorted(robot, np.arange(len(first) + 1))
        products = np.empty((len(geom), 2 * origins))
        for i in range(len(first)):
            np.matmul(offset[ends[i] : ends[i + 1]], both[i].T, out=products[ends[i] : ends[i + 1]])
        ahead = products[:, :origins] - _dots(axis, away)[robot]
        square = _dots(offset, offset)[:, None] + far[robot] - 2.0 * products[:, origins:]
        aside = np.sqrt(np.maximum(square - ahead * ahead, 0.0))
        cosine, radius = bundles.cosine, (bound[geom] + MARGIN)[:, None]
        sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
        # Distance of the centre from the side of the cone.
        missed = (square > (reach + radius) ** 2) | (aside * cosine[robot] - ahead * sine[robot] > radius)
        pair, origin = np.nonzero(~missed | (radius == MARGIN))
        return Pairs(robot[pair] * origins + origin, geom[pair])

    def _cast(self, bundles: Bundles, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances to the nearest geoms of known kinds, and cosines, both (rays, bundles)."""
        along = bundles.along.reshape(-1, *bundles.along.shape[2:]).transpose(2, 1, 0).copy()
        nearest, cosine = np.full(along.shape[1:], np.inf), np.zeros(along.shape[1:])
        pairs, rays = self._near_pairs(bundles, pairs, along)
        if not len(pairs.geom):
            return nearest, cosine
        kinds = self._kind[pairs.geom]
        ends = np.searchsorted(kinds, [*SOLIDS, max(SOLIDS) + 1])
        met = np.full(rays.along.shape[1:], np.inf)
        for first, end, solid in zip(ends, ends[1:], SOLIDS.values(), strict=False):
            if first < end:
                met[:, first:end] = solid.distance(rays.part(np.s_[..., first:end]))
        order = np.argsort(pairs.bundle, kind="stable")
        bundle, met = pairs.bundle[order], met.take(order, 1)
        firsts = np.flatnonzero(np.append(True, bundle[1:] != bundle[:-1]))
        least = np.minimum.reduceat(met, firsts, axis=1)
        nearest[:, bundle[firsts]] = least
        least[np.isinf(least)] = -1.0  # no distance is negative
        ray, pair = np.nonzero(met == np.repeat(least, np.diff(firsts, append=len(bundle)), axis=1))
        distance, bundle, pair = met[ray, pair], bundle[pair], order[pair]
        hits = LocalRays(rays.point[:, 0, pair], rays.along[:, ray, pair], rays.size[:, 0, pair])
        for kind in np.unique(kinds[pair]).tolist():
            here = np.flatnonzero(kinds[pair] == kind)
            cosine[ray[here], bundle[here]] = SOLIDS[kind].cosine(hits.part(np.s_[:, here]), distance[here])
        return nearest, cosine

    def _near_pairs(self, bundles: Bundles, pairs: Pairs, along: np.ndarray) -> tuple[Pairs, LocalRays]:
        """Return the pairs whose rays may meet the geom's bounding box, sorted by kind, and their rays.

        Args:
            bundles: The rays.
            pairs: Pairs to choose from.
            along: Directions of the rays (3, rays, bundles).
        """
        order = np.argsort(self._kind[pairs.geom], kind="stable")
        bundle, geom = pairs.bundle[order], pairs.geom[order]
        offset = bundles.point.reshape(-1, 3)[bundle] - self._data.geom_xpos[geom]
        frame = self._data.geom_xmat[geom].T.copy().reshape(3, 3, 1, -1)
        point, axis = _turned(frame, offset.T[:, None]), _turned(frame, along[:, :1].take(bundle, 2))
        half = self._model.geom_aabb[geom, 3:].T[:, None]
        others = along - along[:, :1]
        chord = np.sqrt((others * others).sum(0).max(0))
        may_meet = cone_meets_box(LocalRays(point, axis, half), chord[bundle])[0]
        kept = np.flatnonzero((may_meet | (self._model.geom_rbound[geom] == 0.0)) & self._is_known[geom])
        bundle, geom = bundle[kept], geom[kept]
        turned = _turned(frame.take(kept, -1), along.take(bundle, 2))
        rays = LocalRays(point.take(kept, -1), turned, self._model.geom_size[geom].T[:, None].copy())
        return Pairs(bundle, geom), rays


def _dots(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the scalar products of vectors (..., 3) (...)."""
    return np.einsum("...i,...i->...", one, other)


def _turned(frame: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return vectors (3, rays, pairs) in frames (3, 3, 1, pairs), summed in MuJoCo's order."""
    return frame[0] * vector[0] + frame[1] * vector[1] + frame[2] * vector[2]
