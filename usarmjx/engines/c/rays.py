"""Sensor rays cast by C MuJoCo in one world, without compilation.

The semantics are those of `sensors.rays.raycast` (materials, exclusion of the robot's own geoms, range,
incidence). Grid fenders, which C MuJoCo does not have, are cast by their kernel.
"""

import math
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from itertools import pairwise
from typing import Any

import jax
import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import numpy_backend
from usarmjx.engines.c.ray_pairs import RayPairs
from usarmjx.models.compile.compose import RobotIndex
from usarmjx.models.compile.ray_geoms import FENDER_KIND
from usarmjx.models.types.shapes import FENDER, MATERIALS
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.kernels import surface_normal
from usarmjx.sensors.rays.raycast import DEFAULT_QUERY, Hits, RayQuery, distance_to
from usarmjx.sensors.rays.targets import GeomBlock

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
        model.geom_group[:] = [MATERIALS.index(material) for material in materials]
        self._robot_state = {
            slot: np.flatnonzero(np.isin(model.geom_bodyid, index.body_ids)) for slot, index in robots.items()
        }
        is_fender = model.geom_group == MATERIALS.index(FENDER)
        self._fenders, self._is_fender = np.flatnonzero(is_fender), np.append(is_fender, False)
        self._pairs = RayPairs(model, data, self._robot_state)

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
        return self._robot_state.get(slot, np.zeros(0, int))

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
        distance, normal, geom = np.empty(count), np.zeros((count, 3)), np.full(count, -1, np.int32)
        solid = _solid_groups(query.transparent)
        turns = np.flatnonzero((start[1:] != start[:-1]).any(-1)) + 1
        bounds = [0, *turns.tolist(), count]  # of the rays from each point
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
        here = np.where(np.isfinite(closest), closest, 0.0)
        pos, mat, size = (np.asarray(x)[nearest] for x in (block.pos, block.mat, block.size))
        offset = start + here[:, None] * along - pos
        local = surface_normal(kind, (mat * offset[:, :, None]).sum(1), size)
    return closest, nearest, (mat * np.asarray(local)[:, None]).sum(2)
