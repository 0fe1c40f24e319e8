"""Rays cast by C MuJoCo in one world, as the sensors ask for them: nothing is compiled.

What `sensors.rays.raycast` promises holds here too (materials, the robot's own geoms, reach, incidence). Grid
fenders, which C MuJoCo does not know, are cast by their kernel.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import pairwise

import jax
import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import numpy_backend
from usarmjx.models.compile.layout import RobotIndex
from usarmjx.models.compile.ray_geoms import FENDER_KIND
from usarmjx.models.types.shapes import FENDER, MATERIALS
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.kernels import surface_normal
from usarmjx.sensors.rays.raycast import DEFAULT_QUERY, Hits, RayQuery, distance_to
from usarmjx.sensors.rays.targets import GeomBlock

HIDDEN_GROUP = len(MATERIALS)
"""The geom group of what rays pass, as the robot that looks; the groups before are the materials."""

FEW_RAYS = 12
"""Fewer rays from a point are cast one by one at all geoms: to cast them together begins with all bounds."""
MANY_RAYS = 32
"""More rays from a point are cast at all geoms: to find those within reach would not pay."""
MARGIN = 1e-4
"""By how much a geom's bounding sphere counts as larger than it is, against what is rounded [m]."""
MIN_COSINE = 0.1
"""Rays from a point are in a cone about the first of them if all are nearer to it than this cosine."""


class CRayCaster:
    """Casts rays in a world of C MuJoCo, whose kinematics must be current.

    Args:
        model: The model; its geom groups are set to the geoms' materials.
        data: Its state.
        materials: What each geom is made of (ngeom,); see `models.build.materials.materials_of`.
        robots: Where each robot is in the model, by slot.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        materials: Sequence[str],
        robots: Mapping[int, RobotIndex],
    ) -> None:
        self._model, self._data = model, data
        model.geom_group[:] = [MATERIALS.index(material) for material in materials]
        self._own = {
            slot: np.flatnonzero(np.isin(model.geom_bodyid, index.body_ids)) for slot, index in robots.items()
        }
        is_fender = model.geom_group == MATERIALS.index(FENDER)
        self._fenders, self._is_fender = np.flatnonzero(is_fender), np.append(is_fender, False)

    def __call__(
        self, origin: Array, direction: Array, query: RayQuery = DEFAULT_QUERY, fans: Fans | None = None
    ) -> Hits:
        """Return the first surface that each ray meets, as `cast_rays` does; float32."""
        del fans  # the rays are all there
        count = len(origin)
        if query.wanted is not None and not query.wanted:
            return Hits(distance=np.full(count, np.inf, np.float32), cosine=np.zeros(count, np.float32))
        start, along = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
        hidden = self.geoms_of(int(query.exclude_owner))
        distance, normal, _ = self.meet(start, along, query, hidden)
        met = distance <= query.max_distance
        cosine = np.abs(_dot(normal, along)) if query.incidence else np.zeros(count)
        return Hits(
            distance=np.where(met, distance, np.inf).astype(np.float32),
            cosine=np.where(met, cosine, 0.0).astype(np.float32),
        )

    def geoms_of(self, slot: int) -> np.ndarray:
        """Return a robot's geoms (n,); none for what is no robot's slot."""
        return self._own.get(slot, np.zeros(0, int))

    def meet(
        self, start: np.ndarray, along: np.ndarray, query: RayQuery, hidden: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return distances (rays,), infinite without a hit, normals (rays, 3) and geoms (rays,).

        Args:
            start: Where rays start [m] (rays, 3).
            along: Unit vectors (rays, 3).
            query: What they pass, and whether normals are wanted.
            hidden: Geoms that they pass too (n,).
        """
        groups = self._model.geom_group
        before = groups.copy()
        groups[hidden] = HIDDEN_GROUP
        try:
            distance, normal, geom = self._cast(start, along, query)
            # Where the first that a ray meets is a fender, it may pass it whole.
            caged = self._is_fender[geom]  # no geom is the last
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
        if 0 < count <= MANY_RAYS * (len(bounds) - 1) and math.isfinite(query.max_distance):
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
            mujoco.mj_multiRay(
                model,
                data,
                start[first],
                lines[3 * first : 3 * end],
                solid,
                1,
                -1,
                geom[first:end],
                distance[first:end],
                normals[3 * first : 3 * end] if query.incidence else None,
                end - first,
                mujoco.mjMAXVAL,  # a shorter reach leaves out floors that are within it
            )
        groups[:] = before
        return np.where(geom >= 0, distance, np.inf), normal, geom

    def _near(
        self, start: np.ndarray, along: np.ndarray, bounds: np.ndarray, reach: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return which geoms rays from each point might meet: by bounding spheres, and cones about the rays.

        Args:
            start: Where rays start [m] (rays, 3), point by point.
            along: Unit vectors (rays, 3).
            bounds: The first ray from each point, and how many rays there are (points + 1,).
            reach: How far they go [m].

        Returns:
            Geoms that any might meet (n,), and whether those from each point might meet them (points, n).
        """
        firsts, rays = bounds[:-1], bounds[1:] - bounds[:-1]
        point = start[firsts] - start[0]
        middle, bound = self._data.geom_xpos - start[0], self._model.geom_rbound
        out = _dot(point, point)[:, None]
        most, square = reach + MARGIN + math.sqrt(out.max()), _dot(middle, middle)
        geoms = np.flatnonzero((square <= (most + bound) ** 2) | (bound == 0))  # planes have no bound
        middle, square, bound = middle[geoms], square[geoms], bound[geoms]
        axis = along[firsts]
        cosine = np.minimum.reduceat(_dot(along, axis.repeat(rays, 0)), firsts)[:, None]
        ahead = axis @ middle.T - _dot(axis, point)[:, None]
        far = out + square - 2 * (point @ middle.T)
        aside, radius = np.sqrt(np.maximum(far - ahead * ahead, 0.0)), bound + MARGIN
        # How far the middle is from the side of the cone.
        outside = aside * cosine - ahead * np.sqrt(np.maximum(1 - cosine * cosine, 0.0)) > radius
        missed = (far > (reach + radius) ** 2) | (outside & (cosine > MIN_COSINE))
        return geoms, ~missed | (bound == 0)

    def _with_fenders(
        self,
        start: np.ndarray,
        along: np.ndarray,
        hidden: np.ndarray,
        distance: np.ndarray,
        normal: np.ndarray,
        geom: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return distances, normals and geoms where fenders are looked at too."""
        ids = np.setdiff1d(self._fenders, hidden)
        pos, mat = self._data.geom_xpos[ids], self._data.geom_xmat[ids].reshape(-1, 3, 3)
        block = GeomBlock(pos=pos, mat=mat, size=self._model.geom_size[ids], owner=np.full(len(ids), -1))
        closest, fender, turned = nearest_of_block(FENDER_KIND, block, start, along)
        closer = closest < distance
        return (
            np.where(closer, closest, distance),
            np.where(closer[:, None], turned, normal),
            np.where(closer, ids[fender], geom),
        )


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the products of vectors (n, 3) with each other (n,)."""
    return np.einsum("ij,ij->i", a, b)


@cache
def _solid_groups(transparent: frozenset[str]) -> np.ndarray:
    """Return which geom groups rays do not pass that pass some materials (groups,)."""
    solid = np.zeros(mujoco.mjNGROUP, np.uint8)
    solid[: len(MATERIALS)] = [material not in transparent for material in MATERIALS]
    return solid


def nearest_of_block(
    kind: int, block: GeomBlock, start: np.ndarray, along: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how far rays (rays, 3) are from a few geoms that C MuJoCo does not know, by their kernel.

    Returns:
        Distances to the nearest, infinite without a hit (rays,); which it is (rays,); normals (rays, 3).
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
