"""Motion of a step: robots as proposed, packed for Warp kernels, and the movable solids.

Movable are loose and hinged bodies, and geoms whose poses are inputs. Limbs of victims move in every step. A
robot's neighbor list stays valid unless a moved geom is near it, or was when the list was built.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.backend import Array
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
            # As below: position, quaternion and size.
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
        # Exactly: a geom that stands still has the same bits in every step.
        moved = (then != now).any(-1)
        x, y = footprints.pos[:, :1], footprints.pos[:, 1:]
        out = jnp.linalg.norm(footprints.half, axis=-1) + reach
        near = jnp.zeros((len(out), len(moved)), bool)
        # Both places count: a door that opens uncovers what the list does not hold.
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


POSE_FIELDS = ("x", "y", "cos", "sin", "yaw", "low", "high")
"""Fields of a row for the old and the proposed pose."""
BODY_FIELDS = ("length", "width", "mass", "moves", "step")
"""Further fields, before the height limits of the four feet."""
ROW_FIELDS = (
    *(f"{time}_{name}" for time in ("before", "there") for name in POSE_FIELDS),
    *BODY_FIELDS,
    *(f"limit_{i}" for i in range(4)),
)
"""All fields of a row, in order."""
MACROS = {f"FIELD_{name.upper()}": place for place, name in enumerate(ROW_FIELDS)}
"""Macros of native code: index of each field."""


class ProposedMotion(NamedTuple):
    """Proposed motion of the robots of all worlds, and the placement of movable solids.

    Attributes:
        left: Old footprints (worlds, robots).
        there: Proposed footprints, with the height range of the whole step.
        moves: Which robots may move (worlds, robots).
        stacked: Which robots are above each other (worlds, robots, robots); None: no robot flies.
        limit: Height limits of ground under the feet [m] (worlds, 4, robots).
        scene: Placement of the movable solids.
        qpos: Positions (worlds, nq).
        poses: Input poses of geoms; None: none.
    """

    left: Footprints
    there: Footprints
    moves: Array
    stacked: Array | None
    limit: Array
    scene: SolidPlacement
    qpos: Array
    poses: GeomPoses | None


def pack_motion(proposed: ProposedMotion) -> Array:
    """Return the packed motion (fields * worlds * robots,), field by field."""
    there = proposed.there
    places = [number for footprints in (proposed.left, there) for number in _place(footprints)]
    body = [there.half[..., 0], there.half[..., 1], there.mass, proposed.moves, proposed.left.step]
    numbers = [*places, *body, *(proposed.limit[:, i] for i in range(4))]
    rows = [jnp.broadcast_to(number, proposed.moves.shape).astype(jnp.float32) for number in numbers]
    # Field by field, so that neighbouring threads of a GPU read neighbouring numbers.
    return jnp.stack(rows).reshape(-1)


def _place(footprints: Footprints) -> list[Array]:
    """Return a robot's values in the order of `POSE_FIELDS`."""
    one = footprints.outlines
    return [one.x, one.y, one.cos, one.sin, footprints.yaw, footprints.low, footprints.high]
