"""Sensor rays cast by C MuJoCo in one world, without compilation.

The semantics are those of `sensors.rays.raycast` (materials, exclusion of the robot's own geoms, range,
incidence). Grid fenders, which C MuJoCo does not have, are cast by their kernel.

`RayPairs` takes several robots at once. MuJoCo looks at every body of the world for every ray; here
bounding spheres pick pairs of a ray and a geom, for all robots in a few array operations. The formulas for
single solids are those of `mj_ray`, in double precision: the distance to the first surface crossed, also from
inside a solid; a plane is met only from its front.
"""

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np

from usarmjx.base.backend import Array, numpy_backend
from usarmjx.models.compile.compose import RobotIndex
from usarmjx.models.compile.ray_geoms import FENDER_KIND
from usarmjx.models.types.shapes import FENDER, MATERIALS
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.kernels import surface_normal
from usarmjx.sensors.rays.raycast import DEFAULT_QUERY, Hits, RayQuery, distance_to
from usarmjx.sensors.rays.targets import GeomBlock

MARGIN = 1e-4
"""Enlargement of bounding spheres and boxes against rounding [m]."""
MIN_LENGTH = 1e-15
"""MuJoCo's mjMINVAL."""
BOX = int(mujoco.mjtGeom.mjGEOM_BOX)


class LocalRays(NamedTuple):
    """Rays of pairs of a bundle and a geom, in the geom's frame.

    Attributes:
        point: Origins [m] (3, 1, pairs).
        along: Unit vectors (3, rays, pairs).
        size: Sizes of the geoms [m] (3, 1, pairs).
    """

    point: np.ndarray
    along: np.ndarray
    size: np.ndarray

    def part(self, index: Any) -> "LocalRays":  # noqa: ANN401 - what indexes arrays
        """Return some of the rays."""
        return LocalRays(self.point[index], self.along[index], self.size[index])


def cone_to_box(axes: LocalRays, chord: np.ndarray) -> np.ndarray:
    """Return a distance before which no ray of a bundle is in a box, infinite where none meets it (pairs,).

    Args:
        axes: The first rays of the bundles.
        chord: Largest distance of the other unit vectors' ends from its end (pairs,).
    """
    low, high = np.zeros((1, len(chord))), np.full((1, len(chord)), np.inf)
    for point, along, size in zip(*axes, strict=True):
        # Within this distance along the rays none of them is above the box, or none below it.
        for speed, room in ((along - chord, size + MARGIN - point), (-along - chord, size + MARGIN + point)):
            end = room / speed
            low = np.where(speed < 0.0, np.maximum(low, end), low)
            high = np.where(speed > 0.0, np.minimum(high, end), high)
    return np.where(low <= high, low, np.inf)[0]


# Kernels: rays of pairs -> distance, infinite without a hit (rays, pairs).


def _plane(rays: LocalRays) -> np.ndarray:
    point, along, size = rays
    met = -point[2] / along[2]
    # Planes are met from above only.
    is_met = (along[2] <= -MIN_LENGTH) & (met >= 0.0)
    for i in (0, 1):
        # A plane of size 0 is infinite.
        is_met &= (size[i] <= 0.0) | (np.abs(point[i] + met * along[i]) <= size[i])
    return np.where(is_met, met, np.inf)


def _box(rays: LocalRays) -> np.ndarray:
    point, along, size = rays
    low, high = (-size - point) / along, (size - point) / along
    first, last = np.minimum(low, high), np.maximum(low, high)
    # Parallel to a pair of faces the ray has no entry: it is between them everywhere or nowhere.
    flat: np.ndarray = np.abs(along) <= MIN_LENGTH
    if flat.any():
        away: np.ndarray = np.where(np.abs(point) <= size, -np.inf, np.inf)
        first, last = np.where(flat, away, first), np.where(flat, -away, last)
    enters: np.ndarray = np.maximum(np.maximum(first[0], first[1]), first[2])
    leaves: np.ndarray = np.minimum(np.minimum(last[0], last[1]), last[2])
    # From inside a box a ray meets the far face, as with `mj_ray`.
    is_met = (enters <= leaves) & (leaves >= 0.0)
    return np.where(is_met, np.where(enters >= 0.0, enters, leaves), np.inf)


def _roots(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return both solutions of a x^2 + 2 b x + c = 0, the smaller first; -1 without."""
    square = b * b - a * c
    # As in MuJoCo's ray_quad: a ray that only grazes a surface misses it.
    root, exists = np.sqrt(square), square >= MIN_LENGTH
    return np.where(exists, (-b - root) / a, -1.0), np.where(exists, (-b + root) / a, -1.0)


def _nearest(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the smaller of two distances, the first being the smaller, that is not negative."""
    return np.where(first >= 0.0, first, np.where(second >= 0.0, second, np.inf))


def _row_dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the scalar products of vectors (3, ...), summed in MuJoCo's order."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _sphere(rays: LocalRays) -> np.ndarray:
    point, along, size = rays
    radius = size[0]
    return _nearest(
        *_roots(_row_dot(along, along), _row_dot(along, point), _row_dot(point, point) - radius * radius)
    )


def _round_side(rays: LocalRays) -> np.ndarray:
    """Return the distance to the round side of a cylinder: radius and half length."""
    point, along, size = rays
    a = along[0] * along[0] + along[1] * along[1]
    b = along[0] * point[0] + along[1] * point[1]
    c = point[0] * point[0] + point[1] * point[1] - size[0] * size[0]
    met = _nearest(*_roots(a, b, c))
    return np.where(np.abs(point[2] + met * along[2]) <= size[1], met, np.inf)


def _cylinder(rays: LocalRays) -> np.ndarray:
    point, along, size = rays
    nearest = _round_side(rays)
    for side in (-1.0, 1.0):
        met = (side * size[1] - point[2]) / along[2]
        x, y = point[0] + met * along[0], point[1] + met * along[1]
        is_met = (np.abs(along[2]) > MIN_LENGTH) & (met >= 0.0) & (x * x + y * y <= size[0] * size[0])
        nearest = np.where(is_met, np.minimum(nearest, met), nearest)
    return nearest


def _capsule(rays: LocalRays) -> np.ndarray:
    point, along, size = rays
    nearest = _round_side(rays)
    for side in (1.0, -1.0):
        end = np.stack([point[0], point[1], point[2] - side * size[1]])
        a, b = _row_dot(along, along), _row_dot(along, end)
        for met in _roots(a, b, _row_dot(end, end) - size[0] * size[0]):
            # Of each ball only the half beyond the cylinder is surface.
            is_met = (met >= 0.0) & (side * (point[2] + met * along[2]) >= size[1])
            nearest = np.where(is_met, np.minimum(nearest, met), nearest)
    return nearest


# Cosines: rays and the distances at which they meet, both (..., pairs) -> cosine of incidence (pairs,).


def _ends(rays: LocalRays, met: np.ndarray) -> np.ndarray:
    return rays.point + met * rays.along


def _cosine_to(normal: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return the cosines of the angles to normals of any length."""
    return np.abs(_row_dot(normal, along)) / np.sqrt(_row_dot(normal, normal))


def _plane_cosine(rays: LocalRays, met: np.ndarray) -> np.ndarray:
    del met
    return np.abs(rays.along[2])


def _box_cosine(rays: LocalRays, met: np.ndarray) -> np.ndarray:
    # On a face that coordinate is nearest to its half length.
    face = (np.abs(_ends(rays, met)) / rays.size).argmax(0)
    return np.abs(np.take_along_axis(rays.along, face[None], 0)[0])


def _sphere_cosine(rays: LocalRays, met: np.ndarray) -> np.ndarray:
    return _cosine_to(_ends(rays, met), rays.along)


def _cylinder_cosine(rays: LocalRays, met: np.ndarray) -> np.ndarray:
    x, y, z = _ends(rays, met)
    is_flat = np.abs(z) / rays.size[1] > np.sqrt(x * x + y * y) / rays.size[0]
    side = _cosine_to(np.stack([x, y, np.zeros_like(z)]), rays.along)
    return np.where(is_flat, np.abs(rays.along[2]), side)


def _capsule_cosine(rays: LocalRays, met: np.ndarray) -> np.ndarray:
    x, y, z = _ends(rays, met)
    half = rays.size[1]
    return _cosine_to(np.stack([x, y, z - np.clip(z, -half, half)]), rays.along)


class Solid(NamedTuple):
    """Functions of a type of geom.

    Attributes:
        distance: Distances of rays, infinite without a hit [m] (rays, pairs).
        cosine: Cosines of incidence of rays that meet it at some distances (pairs,).
    """

    distance: Callable[[LocalRays], np.ndarray]
    cosine: Callable[[LocalRays, np.ndarray], np.ndarray]


SOLIDS = {
    int(mujoco.mjtGeom.mjGEOM_PLANE): Solid(_plane, _plane_cosine),
    int(mujoco.mjtGeom.mjGEOM_SPHERE): Solid(_sphere, _sphere_cosine),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): Solid(_capsule, _capsule_cosine),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): Solid(_cylinder, _cylinder_cosine),
    BOX: Solid(_box, _box_cosine),
}
"""Known types of geoms."""


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
        # The cone is about the first ray, not the middle one: any ray bounds the others.
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
        # A geom without a material has index -1 and picks the 1 that is appended.
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
            Both, and the robots for which they are right: not those that may see geoms of other kinds, and
            none if the rays are not bundled alike (robots,).
        """
        is_right, bundles = np.ones(len(start), bool), Bundles.of(start, along)
        if bundles is None:
            return np.full(start.shape[:2], np.inf), np.zeros(start.shape[:2]), ~is_right
        stops = (solid[self._material] != 0) & self._is_drawn & (self._owner != slots[:, None])
        # Rays parallel to faces divide by zero on purpose: `where` drops what comes of it.
        with np.errstate(all="ignore"):
            distance, cosine, unknown = self._cast(bundles, self._pairs(bundles, stops, reach))
        is_right[unknown // bundles.point.shape[1]] = False
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
        # Squared distances by one matrix product; in double precision the cancellation does no harm here.
        apart = _dots(centre, centre) + _dots(first, first)[:, None] - 2.0 * (first @ centre.T)
        robot, geom = np.nonzero(stops & ((apart <= most * most) | (bound == 0.0)))  # planes have no bound
        offset, both = centre[geom] - first[robot], np.concatenate([axis, away], 1)
        ends = np.searchsorted(robot, np.arange(len(first) + 1))
        products = np.empty((len(geom), 2 * origins))
        for i in range(len(first)):
            # Robot by robot: one product of all would compute the pairs of every robot with every other's
            # axes.
            np.matmul(offset[ends[i] : ends[i + 1]], both[i].T, out=products[ends[i] : ends[i + 1]])
        ahead = products[:, :origins] - _dots(axis, away)[robot]
        square = _dots(offset, offset)[:, None] + far[robot] - 2.0 * products[:, origins:]
        aside = np.sqrt(np.maximum(square - ahead * ahead, 0.0))
        cosine, radius = bundles.cosine, (bound[geom] + MARGIN)[:, None]
        sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
        # Distance of the centre from the side of the cone.
        missed = (square > (reach + radius) ** 2) | (aside * cosine[robot] - ahead * sine[robot] > radius)
        # Planes have no bound, so their radius is the margin alone: they are never left out.
        pair, origin = np.nonzero(~missed | (radius == MARGIN))
        return Pairs(robot[pair] * origins + origin, geom[pair])

    def _cast(self, bundles: Bundles, pairs: Pairs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the distances to the nearest geoms of known kinds, and cosines, both (rays, bundles).

        The third array has the bundles of which a ray may meet a geom of another kind first (n,).
        """
        along = bundles.along.reshape(-1, *bundles.along.shape[2:]).transpose(2, 1, 0).copy()
        nearest, cosine = np.full(along.shape[1:], np.inf), np.zeros(along.shape[1:])
        pairs, rays, (others, entry) = self._near_pairs(bundles, pairs, along)
        if not len(pairs.geom):
            return nearest, cosine, others
        kinds = self._kind[pairs.geom]
        # Pairs are sorted by kind, and SOLIDS has its kinds in ascending order: keep both.
        ends = np.searchsorted(kinds, [*SOLIDS, max(SOLIDS) + 1])
        met = np.full(rays.along.shape[1:], np.inf)
        for first, end, solid in zip(ends, ends[1:], SOLIDS.values(), strict=False):
            if first < end:
                met[:, first:end] = solid.distance(rays.part(np.s_[..., first:end]))
        # NumPy's reduceat needs the pairs of each bundle side by side.
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
        # A geom behind the farthest hit of a bundle is hidden, whatever its shape.
        return nearest, cosine, others[entry <= nearest.max(0)[others]]

    def _near_pairs(
        self, bundles: Bundles, pairs: Pairs, along: np.ndarray
    ) -> tuple[Pairs, LocalRays, tuple[np.ndarray, np.ndarray]]:
        """Return the pairs whose rays may meet the geom's bounding box, sorted by kind, and their rays.

        Those of known kinds; of the others the bundles, and the distances before which no ray meets the geom
        (n,).

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
        middle, half = self._model.geom_aabb[geom].T.reshape(2, 3, 1, -1)
        # All rays of a bundle are in a cone around its first one, as wide as the largest chord between them.
        others = along - along[:, :1]
        chord = np.sqrt((others * others).sum(0).max(0))
        entry = cone_to_box(LocalRays(point - middle, axis, half), chord[bundle])
        may_meet, known = np.isfinite(entry), self._is_known[geom]
        unknown = np.flatnonzero(may_meet & ~known)
        behind = bundle[unknown], entry[unknown]
        # Planes have neither a bounding box nor a radius.
        kept = np.flatnonzero((may_meet | (self._model.geom_rbound[geom] == 0.0)) & known)
        bundle, geom = bundle[kept], geom[kept]
        turned = _turned(frame.take(kept, -1), along.take(bundle, 2))
        rays = LocalRays(point.take(kept, -1), turned, self._model.geom_size[geom].T[:, None].copy())
        return Pairs(bundle, geom), rays, behind


def _dots(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the scalar products of vectors (..., 3) (...)."""
    return np.einsum("...i,...i->...", one, other)


def _turned(frame: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return vectors (3, rays, pairs) in frames (3, 3, 1, pairs), summed in MuJoCo's order."""
    return frame[0] * vector[0] + frame[1] * vector[1] + frame[2] * vector[2]


HIDDEN_GROUP = len(MATERIALS)
"""Geom group that rays pass, for instance of the robot that casts them; lower groups are the materials."""

FEW_ROBOTS = 2
"""Number of robots up to which their rays are cast robot by robot."""
FEW_RAYS = 12
"""Ray count per origin below which rays are cast one by one: `mj_multiRay` first tests all bounding boxes."""
TOO_FEW_RAYS = 4
"""Ray count up to which culling by range does not pay either."""
MANY_RAYS = 32
"""Ray count per origin above which culling by range does not pay."""
SPHERE_MARGIN = 1e-4
"""Enlargement of bounding spheres against rounding [m]."""
MIN_NORMAL = 1e-9
"""Shortest product of two rays that counts as a normal of their plane."""
NO_GEOMS = np.zeros(0, bool)
"""No mask of geoms."""
MIN_COSINE = 0.1
"""Lowest cosine to the first ray for which a cone test is valid."""


class CRayCaster:
    """Ray caster for a world of C MuJoCo with current kinematics.

    Args:
        model: The model; its geom groups are set to the geoms' materials.
        data: Its state.
        materials: Material of each geom (ngeom,); see `models.compile.compose.materials_of`.
        robots: Indices of each robot in the model, by slot.

    Attributes:
        met: Geoms that rays met within their range when last cast, -1 for none, by slot of the casting robot
            and name of the query (rays,).
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        materials: Sequence[str],
        robots: Mapping[int, RobotIndex],
    ) -> None:
        self._model, self._data = model, data
        self.met = dict[tuple[int, str], np.ndarray]()
        # MuJoCo's rays choose geoms by group, so that groups stand for materials here.
        model.geom_group[:] = [MATERIALS.index(material) for material in materials]
        self._robot_geoms = {
            slot: np.flatnonzero(np.isin(model.geom_bodyid, index.body_ids)) for slot, index in robots.items()
        }
        is_fender = model.geom_group == MATERIALS.index(FENDER)
        self._fenders, self._is_fender = np.flatnonzero(is_fender), np.append(is_fender, False)
        self._pairs = RayPairs(model, data, self._robot_geoms)

    def __call__(
        self, origin: Array, direction: Array, query: RayQuery = DEFAULT_QUERY, fans: Fans | None = None
    ) -> Hits:
        """Return the first hit of each ray, as `cast_rays` does; float32."""
        del fans  # directions are already expanded
        count = len(origin)
        if query.wanted is not None and not query.wanted:
            return Hits(distance=np.full(count, np.inf, np.float32), cosine=np.zeros(count, np.float32))
        start, along = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
        hidden = self.geoms_of(int(query.exclude_owner))
        distance, normal, geom = self.hit_geoms(start, along, query, hidden)
        met = distance <= query.max_distance
        if query.kept_as:
            self.met[int(query.exclude_owner), query.kept_as] = np.where(met, geom, -1)
        cosine = np.abs(_dot(normal, along)) if query.incidence else np.zeros(count)
        return Hits(
            distance=np.where(met, distance, np.inf).astype(np.float32),
            cosine=np.where(met, cosine, 0.0).astype(np.float32),
        )

    def of_robots(self, origin: Array, direction: Array, query: RayQuery) -> Hits:
        """Return the first hits of rays of several robots (robots, rays); a zero direction hits nothing.

        Args:
            origin: Ray origins [m] (robots, rays, 3).
            direction: Unit vectors, or zeros (robots, rays, 3).
            query: Options; its `exclude_owner` are the robots' slots (robots,).
        """
        slots, aimed = np.asarray(query.exclude_owner), (np.asarray(direction) != 0.0).any(-1)
        distance, cosine = np.full(aimed.shape, np.inf, np.float32), np.zeros(aimed.shape, np.float32)
        left = np.ones(len(slots), bool)
        if len(slots) > FEW_ROBOTS and aimed.all() and not query.kept_as:  # pairs do not say which geom
            rays = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
            solid = _solid_groups(query.transparent)
            far, facing, is_right = self._pairs.nearest(*rays, slots, solid, query.max_distance)
            met = (far <= query.max_distance) & is_right[:, None]
            # Robots that may see geoms of other kinds are cast one by one below.
            distance[met], left = far[met], ~is_right
            if query.incidence:
                cosine[met] = facing[met]
        for robot in np.flatnonzero(left & aimed.any(-1)).tolist():
            rays = origin[robot, aimed[robot]], direction[robot, aimed[robot]]
            hits = self(*rays, query.replace(exclude_owner=slots[robot]))
            distance[robot, aimed[robot]], cosine[robot, aimed[robot]] = hits.distance, hits.cosine
        return Hits(distance=distance, cosine=cosine)

    def geoms_of(self, slot: int) -> np.ndarray:
        """Return a robot's geoms (n,); empty for any other slot."""
        return self._robot_geoms.get(slot, np.zeros(0, int))

    def hit_geoms(
        self, start: np.ndarray, along: np.ndarray, query: RayQuery, hidden: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return distances (rays,), infinite without a hit, normals (rays, 3) and geoms (rays,).

        Args:
            start: Ray origins [m] (rays, 3).
            along: Unit vectors (rays, 3).
            query: Materials that the rays pass, and whether normals are needed.
            hidden: Further geoms that they pass (n,).
        """
        groups = self._model.geom_group
        before = groups.copy()
        # `mj_ray` can exclude a single body only, and a robot has many; it does skip whole groups.
        groups[hidden] = HIDDEN_GROUP
        try:
            distance, normal, geom = self._cast(start, along, query)
            # MuJoCo has a fender as a solid cylinder; the ray may pass between its bars.
            caged = self._is_fender[geom]  # geom -1 (no hit) reads the appended False
            if caged.any():
                rays = start[caged], along[caged]
                open_query = query.replace(transparent=query.transparent | {FENDER})
                behind = self._cast(*rays, open_query)
                distance[caged], normal[caged], geom[caged] = self._with_fenders(*rays, hidden, *behind)
        finally:
            groups[:] = before
        return distance, normal, geom

    def _cast(
        self, start: np.ndarray, along: np.ndarray, query: RayQuery
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return distances (rays,), infinite without a hit, normals (rays, 3) and geoms (rays,)."""
        model, data, count = self._model, self._data, len(start)
        # MuJoCo marks a ray that meets nothing by geom -1.
        distance, normal, geom = np.empty(count), np.zeros((count, 3)), np.full(count, -1, np.int32)
        solid = _solid_groups(query.transparent)
        turns = np.flatnonzero((start[1:] != start[:-1]).any(-1)) + 1
        bounds = [0, *turns.tolist(), count]  # of the rays from each point
        # Views: `mj_multiRay` takes flat arrays and writes the normals through them.
        lines, normals = along.reshape(-1), normal.reshape(-1)
        groups, shown, few = model.geom_group, None, FEW_RAYS
        before = groups.copy()
        if TOO_FEW_RAYS < count <= MANY_RAYS * (len(bounds) - 1) and math.isfinite(query.max_distance):
            geoms, near = self._near(start, along, np.array(bounds), query.max_distance)
            shown, few = np.full((len(near), len(before)), HIDDEN_GROUP, before.dtype), 1
            shown[:, geoms] = np.where(near, before[geoms], HIDDEN_GROUP)
        for i, (first, end) in enumerate(pairwise(bounds)):
            if shown is not None:
                groups[:] = shown[i]
            if end - first < few:
                for ray in range(first, end):
                    # In the call below, 1 includes static geoms and -1 excludes no body.
                    out = geom[ray : ray + 1], normal[ray]
                    distance[ray] = mujoco.mj_ray(model, data, start[ray], along[ray], solid, 1, -1, *out)
                continue
            here = slice(first, end)
            unmet = self._beside(start[first], along[here]) if end - first >= MANY_RAYS else NO_GEOMS
            with _emptied(model, unmet):
                mujoco.mj_multiRay(
                    model,
                    data,
                    start[first],
                    lines[3 * first : 3 * end],
                    solid,
                    1,
                    -1,
                    geom[here],
                    distance[here],
                    normals[3 * first : 3 * end] if query.incidence else None,
                    end - first,
                    mujoco.mjMAXVAL,  # with a shorter cutoff MuJoCo omits floors within it
                )
        groups[:] = before
        return np.where(geom >= 0, distance, np.inf), normal, geom

    def _near(
        self, start: np.ndarray, along: np.ndarray, bounds: np.ndarray, reach: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return which geoms the rays of each origin may meet, by bounding spheres and cones about the rays.

        Args:
            start: Ray origins [m] (rays, 3), grouped.
            along: Unit vectors (rays, 3).
            bounds: First ray of each origin, and the number of rays (origins + 1,).
            reach: Range [m].

        Returns:
            Geoms that any ray may meet (n,), and whether those of each origin may meet them (origins, n).
        """
        firsts, rays = bounds[:-1], bounds[1:] - bounds[:-1]
        # From the first origin: squares of coordinates far from the world's origin would cancel below.
        point = start[firsts] - start[0]
        middle, bound = self._data.geom_xpos - start[0], self._model.geom_rbound
        out = _dot(point, point)[:, None]
        most, square = reach + SPHERE_MARGIN + math.sqrt(out.max()), _dot(middle, middle)
        geoms = np.flatnonzero((square <= (most + bound) ** 2) | (bound == 0))  # planes have no bound
        middle, square, bound = middle[geoms], square[geoms], bound[geoms]
        axis = along[firsts]
        cosine = np.minimum.reduceat(_dot(along, axis.repeat(rays, 0)), firsts)[:, None]
        ahead = axis @ middle.T - _dot(axis, point)[:, None]
        far = out + square - 2 * (point @ middle.T)
        aside, radius = np.sqrt(np.maximum(far - ahead * ahead, 0.0)), bound + SPHERE_MARGIN
        # Distance of the centre from the side of the cone.
        outside = aside * cosine - ahead * np.sqrt(np.maximum(1 - cosine * cosine, 0.0)) > radius
        missed = (far > (reach + radius) ** 2) | (outside & (cosine > MIN_COSINE))
        return geoms, ~missed | (bound == 0)

    def _beside(self, point: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Return the geoms that no ray of a fan meets, by bounding spheres: (ngeom,) bool.

        A fan of rays (rays, 3) from a point [m] is nearly in a plane, and mostly on one side of another.
        """
        offset, bound = self._data.geom_xpos - point, self._model.geom_rbound
        radius, middle = bound + SPHERE_MARGIN, along[len(along) // 2]
        normal = along[0, [1, 2, 0]] * middle[[2, 0, 1]] - along[0, [2, 0, 1]] * middle[[1, 2, 0]]
        normal /= max(math.sqrt(normal @ normal), MIN_NORMAL)
        farthest = np.sqrt(_dot(offset, offset)) + radius
        missed = np.abs(offset @ normal) > radius + farthest * np.abs(along @ normal).max()
        # Farther back than any ray of the fan gets within that distance.
        missed |= offset @ middle < farthest * min((along @ middle).min(), 0.0) - radius
        return missed & (bound > 0.0)  # planes have no bound

    def _with_fenders(
        self,
        start: np.ndarray,
        along: np.ndarray,
        hidden: np.ndarray,
        distance: np.ndarray,
        normal: np.ndarray,
        geom: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return distances, normals and geoms with fenders included."""
        ids = np.setdiff1d(self._fenders, hidden)
        pos, mat = self._data.geom_xpos[ids], self._data.geom_xmat[ids].reshape(-1, 3, 3)
        block = GeomBlock(pos=pos, mat=mat, size=self._model.geom_size[ids], owner=np.full(len(ids), -1))
        closest, fender, turned = nearest_in_block(FENDER_KIND, block, start, along)
        closer = closest < distance
        return (
            np.where(closer, closest, distance),
            np.where(closer[:, None], turned, normal),
            np.where(closer, ids[fender], geom),
        )


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the scalar products of vectors (n, 3) (n,)."""
    return np.einsum("ij,ij->i", a, b)


@contextmanager
def _emptied(model: mujoco.MjModel, unmet: np.ndarray) -> Generator[None]:
    """Hide geoms (ngeom,) bool within the context, and let rays skip the bodies that are left with none."""
    if not len(unmet):
        yield
        return
    groups, counts, trees = model.geom_group, model.body_geomnum, tree_addresses(model)
    before = groups.copy(), counts.copy(), trees.copy()
    groups[unmet] = HIDDEN_GROUP
    empty = np.ones(len(counts), bool)
    empty[model.geom_bodyid[groups != HIDDEN_GROUP]] = False
    counts[empty], trees[empty] = 0, -1
    # The model is the engine's, too: it comes back whole, whatever a cast raises.
    try:
        yield
    finally:
        groups[:], counts[:], trees[:] = before


def tree_addresses(model: Any) -> np.ndarray:  # noqa: ANN401 - MuJoCo's types leave it out
    """Return the first node of each body's bounding volumes, -1 without (bodies,)."""
    return model.body_bvhadr


@cache
def _solid_groups(transparent: frozenset[str]) -> np.ndarray:
    """Return which geom groups block rays that pass some materials (groups,)."""
    # Groups beyond the materials' stay 0, `HIDDEN_GROUP` among them: rays pass them.
    solid = np.zeros(mujoco.mjNGROUP, np.uint8)
    solid[: len(MATERIALS)] = [material not in transparent for material in MATERIALS]
    return solid


def nearest_in_block(
    kind: int, block: GeomBlock, start: np.ndarray, along: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the nearest hits of rays (rays, 3) on a few geoms without support in C MuJoCo, by their kernel.

    Returns:
        Distances, infinite without a hit (rays,); indices of the geoms (rays,); normals (rays, 3).
    """
    with numpy_backend():
        rows = [jax.tree.map(lambda x, i=i: x[i], block) for i in range(len(block.owner))]
        reach = np.stack([distance_to(kind, row, start, along) for row in rows])
        nearest = reach.argmin(0)
        closest = reach.min(0)
        # Finite for misses, whose normals nobody reads.
        here = np.where(np.isfinite(closest), closest, 0.0)
        pos, mat, size = (np.asarray(x)[nearest] for x in (block.pos, block.mat, block.size))
        offset = start + here[:, None] * along - pos
        local = surface_normal(kind, (mat * offset[:, :, None]).sum(1), size)
    return closest, nearest, (mat * np.asarray(local)[:, None]).sum(2)
