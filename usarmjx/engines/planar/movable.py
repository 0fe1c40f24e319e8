"""Movable solids of a world: loose and hinged bodies, and geoms whose poses are inputs.

Limbs of victims move in every step. A robot's neighbor list stays valid unless a moved geom is near it, or
was when the list was built.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.rotations import matvec
from usarmjx.engines.base import GeomPoses
from usarmjx.engines.planar.bodies import FixedBodies
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.solids import SolidGeoms


class SolidPlacement(struct.PyTreeNode, kw_only=True):
    """Placement of a world's movable solids.

    Attributes:
        loose: Coordinates in qpos of loose and hinged bodies (..., n).
        geoms: Position, orientation and size of the geoms that are inputs (..., geoms, 10).
    """

    loose: Array
    geoms: Array


@dataclass(frozen=True, eq=False)
class MovableSolids:
    """Movable solids of a model.

    Attributes:
        loose: Indices in qpos of loose and hinged bodies (n,).
        pose_index: Indices in `GeomPoses` of the colliding ones (geoms,).
        size: Their sizes in the model [m] (geoms, 3).
        origin: Origins of their bodies [m] (geoms, 3).
        turn: Orientations of their bodies (geoms, 3, 3).
    """

    loose: np.ndarray
    pose_index: np.ndarray
    size: np.ndarray
    origin: np.ndarray
    turn: np.ndarray

    def placement(self, qpos: Array, poses: GeomPoses | None) -> SolidPlacement:
        """Return the placement in one world; zeros for geoms without input poses.

        Args:
            qpos: Positions (nq,).
            poses: Input poses of geoms.
        """
        loose, count = qpos[self.loose], len(self.pose_index)
        if poses is None or not count:
            return SolidPlacement(loose=loose, geoms=jnp.zeros((count, 10)))
        size = jnp.asarray(self.size, jnp.float32) if poses.size is None else poses.size[self.pose_index]
        parts = poses.pos[self.pose_index], poses.quat[self.pose_index], size
        return SolidPlacement(loose=loose, geoms=jnp.concatenate(parts, -1))

    def moved_nearby(self, then: Array, now: Array, footprints: Footprints, reach: Array) -> Array:
        """Return whether a geom near any robot of a world has moved, before or after its motion ().

        Args:
            then: Old position, orientation and size of the geoms that are inputs (geoms, 10).
            now: Current ones.
            footprints: The robots.
            reach: Distance from a robot's bounding circle that counts as near [m] (robots,).
        """
        moved = (then != now).any(-1)
        x, y = footprints.pos[:, :1], footprints.pos[:, 1:]
        out = jnp.linalg.norm(footprints.half, axis=-1) + reach
        near = jnp.zeros((len(out), len(moved)), bool)
        for geoms in (then, now):
            at = self.origin + matvec(jnp.asarray(self.turn, jnp.float32), geoms[:, :3])
            # The sum of a geom's sizes bounds its radius.
            far = out[:, None] + geoms[:, 7:].sum(-1)
            near |= (x - at[:, 0]) ** 2 + (y - at[:, 1]) ** 2 < far * far
        return (near & moved).any()


def movable_solids(model: mujoco.MjModel, fixed: FixedBodies, geoms: SolidGeoms) -> MovableSolids:
    """Return the movable solids.

    Args:
        model: The model.
        fixed: Its bodies other than robots.
        geoms: Its movable colliding geoms.
    """
    data = geoms.moved >= 0
    ids, bodies = geoms.ids[data], geoms.bodies[data]
    return MovableSolids(
        loose=np.concatenate([fixed.free_qpos.reshape(-1), fixed.hinge_qpos]),
        pose_index=geoms.moved[data],
        size=model.geom_size[ids],
        origin=fixed.pos[bodies].astype(np.float32),
        turn=fixed.mat[bodies],
    )
