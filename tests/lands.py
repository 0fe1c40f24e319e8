"""Random arenas of meshes and terrain, and how C MuJoCo sees them."""

import mujoco
import numpy as np

from usarmjx.models.compile.compose import new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import HeightField, Mesh, Shape

GRAZE = 1e-4  # m: what changes when a ray is moved by this is left out ...
JUMP = 3e-3  # ... if by more than this: distance [m] or normal


def stones(rng, n=5, reach=3.0):
    """Meshes of 12 random corners, some of which lie inside the hull of the others."""
    return tuple(
        Shape(
            kind="mesh",
            mesh=Mesh(vertices=rng.normal(size=(12, 3)) * rng.uniform(0.1, 0.8, 3)),
            at=tuple(rng.uniform(-reach, reach, 3)),
            rotation=tuple(rng.uniform(-3, 3, 3)),
        )
        for _ in range(n)
    )


def hills(rng, tilted=True, at=None):
    """A terrain of 8 by 5 cells, of which no height is like another."""
    return Shape(
        kind="hfield",
        size=(2.0, 1.5, 0.3),
        heights=HeightField(heights=rng.uniform(0.1, 1.0, (6, 9))),
        at=tuple(rng.uniform(-2, 2, 3)) if at is None else at,
        rotation=tuple(rng.uniform(-0.5, 0.5, 3)) if tilted else (0.0, 0.0, 0.0),
    )


def land(*shapes, name="land"):
    """An arena of some solids without a floor."""
    return ArenaSpec(name=name, has_floor=False, shapes=shapes, starts=(), extent=((-4, 4), (-4, 4)))


class Land:
    """An arena, as C MuJoCo has it."""

    def __init__(self, arena, model=None):
        self.arena, self.model = arena, new_spec(arena, Physics()).compile() if model is None else model
        self.data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self.data)

    def c(self, origins, directions):
        """Distance (infinite for none) and normal of C's first hit for each ray."""
        distance, normal = np.zeros(len(origins)), np.zeros((len(origins), 3))
        for i, (o, d) in enumerate(zip(origins, directions, strict=True)):
            hit = np.zeros(1, np.int32)
            distance[i] = mujoco.mj_ray(self.model, self.data, o, d, None, 1, -1, hit, normal[i])
        return np.where(distance < 0, np.inf, distance), normal

    def oracle(self, origins, directions):
        """C's distances and cosines, and which rays graze nothing."""
        distance, normal = self.c(origins, directions)
        clear = np.ones(len(origins), bool)
        for nudge in np.random.default_rng(3).choice([-GRAZE, GRAZE], (4, 3)):
            moved, turned = self.c(origins + nudge, directions)
            with np.errstate(invalid="ignore"):
                clear &= ~(np.abs(moved - distance) > JUMP) & (np.isinf(distance) == np.isinf(moved))
            clear &= np.abs(turned - normal).max(-1) < JUMP * 3
        return distance, np.abs((normal * directions).sum(-1)), clear

    def local(self, geom, points):
        """Points (n, 3) in the frame of a geom."""
        return (points - self.data.geom_xpos[geom]) @ self.data.geom_xmat[geom].reshape(3, 3)

    def inside(self, geom, points, grow=0.0):
        """Whether points (n, 3) are inside a mesh or a terrain: below its surface and above its bottom."""
        if self.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            return self._in_mesh(geom, points, grow)
        data = self.model.geom_dataid[geom]
        x, y, top, bottom = self.model.hfield_size[data]
        local = self.local(geom, points)
        within = (np.abs(local[:, :2]) < (x + grow, y + grow)).all(-1) & (local[:, 2] > -bottom - grow)
        turn, pos = self.data.geom_xmat[geom].reshape(3, 3), self.data.geom_xpos[geom]
        above = local.copy()
        above[:, 2] = top + 1.0
        # From right above it, straight down: its own axes.
        depth = [
            mujoco.mj_rayHfield(self.model, self.data, geom, pos + turn @ p, -turn[:, 2], None) for p in above
        ]
        return within & (local[:, 2] < top + 1.0 - np.array(depth) + grow)

    def _in_mesh(self, geom, points, grow):
        """By the half spaces of the hull's faces as MuJoCo has them."""
        data = self.model.geom_dataid[geom]
        first, count = self.model.mesh_vertadr[data], self.model.mesh_vertnum[data]
        corners = self.model.mesh_vert[first : first + count]
        faces = self.model.mesh_face[self.model.mesh_faceadr[data] :][: self.model.mesh_facenum[data]]
        a, b, c = (corners[faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        height = np.einsum("pfk,fk->pf", self.local(geom, points)[:, None] - a[None], normal)
        return (height < grow).all(-1)


def rays_at(rng, land, count):
    """Rays from anywhere near to near the geoms, as the device sees them: single precision, in doubles."""
    origins = rng.uniform(-4, 4, (count, 3))
    geoms = rng.integers(land.model.ngeom, size=count)
    targets = land.data.geom_xpos[geoms] + rng.uniform(-1.2, 1.2, (count, 3))
    origins = origins.astype(np.float32).astype(float)
    directions = targets - origins
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return origins, directions.astype(np.float32).astype(float)
