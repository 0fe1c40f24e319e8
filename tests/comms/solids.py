"""Solids for wall counting, and a second opinion on which of them a segment crosses."""

from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.transforms import mat_from_angles
from usarmjx.comms.walls import count_walls
from usarmjx.sensors.rays.targets import make_geoms

Geom = mujoco.mjtGeom
COUNT = jax.jit(count_walls)


@dataclass
class Solids:
    """Solids in double precision: kind (n,), pos (n, 3), mat (n, 3, 3), size (n, 3)."""

    kind: np.ndarray
    pos: np.ndarray
    mat: np.ndarray
    size: np.ndarray

    @cached_property
    def _geoms(self):
        single = (jnp.asarray(part.astype(np.float32)) for part in (self.pos, self.mat, self.size))
        return make_geoms(self.kind, *single, jnp.full(len(self.kind), -1))

    def geoms(self):
        return self._geoms

    def count(self, start, end):
        points = (jnp.asarray(np.atleast_2d(p), jnp.float32) for p in (start, end))
        return np.asarray(COUNT(self._geoms, *points))


def solids(*members):
    """Solids of (kind, centre, size) or (kind, centre, size, (roll, pitch, yaw))."""
    full = [(kind, at, (*size, 0, 0)[:3], *(rest or [(0, 0, 0)])) for kind, at, size, *rest in members]
    return Solids(
        kind=np.array([m[0] for m in full], int),
        pos=np.array([m[1] for m in full], float),
        mat=np.array([mat_from_angles(*m[3]) for m in full], float),
        size=np.array([m[2] for m in full], float),
    )


def box(at, size, turn=(0, 0, 0)):
    return (Geom.mjGEOM_BOX, at, size, turn)


def random_boxes(rng, n, upright):
    """Walls of an arena 20 m wide, thin ones among them; `upright` ones turn about z only."""
    turn = rng.uniform(-np.pi, np.pi, (n, 3)) * ([0, 0, 1] if upright else [1, 1, 1])
    size = np.stack(
        [10 ** rng.uniform(-3, 0.3, n), 10 ** rng.uniform(-1, 0.6, n), rng.uniform(0.1, 1.5, n)], -1
    )
    pos = rng.uniform((-10, -10, 0), (10, 10, 2), (n, 3))
    mat = np.stack([mat_from_angles(*angles) for angles in turn])
    return Solids(np.full(n, int(Geom.mjGEOM_BOX)), pos, mat, size)


def slab_count(boxes, start, end, grow=0.0):
    """How many boxes each segment passes through, by the slab method in double precision (segments,).

    Along each axis of a box the segment is between its two faces for an interval of its parameter; it is
    inside where it is between all three pairs.
    """
    direction = end - start
    origin = np.einsum("gji,sgj->sgi", boxes.mat, start[:, None, :] - boxes.pos[None])
    along = np.einsum("gji,sj->sgi", boxes.mat, direction)
    size = boxes.size + grow
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (-size - origin) / along, (size - origin) / along
    parallel = along == 0
    between = np.abs(origin) < size
    enter = np.where(parallel, np.where(between, -np.inf, np.inf), np.minimum(a, b))
    leave = np.where(parallel, np.where(between, np.inf, -np.inf), np.maximum(a, b))
    first, last = np.maximum(enter.max(-1), 0.0), np.minimum(leave.min(-1), 1.0)
    return (first < last).sum(-1)


def ray_count(things, start, end, grow=0.0):
    """The same for any shapes by C MuJoCo's `mju_rayGeom`, which from inside tells where a ray leaves.

    A segment passes through a solid if it enters before its end, or starts inside.
    """
    counts = np.zeros(len(start), int)
    for s, (a, b) in enumerate(zip(start, end, strict=True)):
        length = np.linalg.norm(b - a)
        direction = (b - a) / length
        for kind, pos, mat, size in zip(things.kind, things.pos, things.mat, things.size, strict=True):
            # A plane has no inside, and is seen from its front only; this one is seen from both sides.
            if kind == Geom.mjGEOM_PLANE:
                counts[s] += ((a - pos) @ mat[:, 2]) * ((b - pos) @ mat[:, 2]) < 0
                continue
            far = mujoco.mju_rayGeom(pos, mat.ravel(), size + grow, a, direction, int(kind), None)
            counts[s] += 0 <= far < length or (far >= 0 and _inside(kind, mat.T @ (a - pos), size + grow))
    return counts


def _inside(kind, p, size):
    flat = np.hypot(p[0], p[1])
    if kind == Geom.mjGEOM_BOX:
        return bool((np.abs(p) < size).all())
    if kind == Geom.mjGEOM_SPHERE:
        return np.linalg.norm(p) < size[0]
    if kind == Geom.mjGEOM_ELLIPSOID:
        return np.linalg.norm(p / size) < 1
    if kind == Geom.mjGEOM_CYLINDER:
        return flat < size[0] and abs(p[2]) < size[1]
    return np.linalg.norm([p[0], p[1], p[2] - np.clip(p[2], -size[1], size[1])]) < size[0]
