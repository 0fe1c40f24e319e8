"""What solids of a world can be elsewhere: what lies loose or hangs on a hinge, and geoms that are data.

Limbs of victims move in every step. What is known of what is around robots holds all the same, unless a geom
has moved that is near one of them, or was when it was looked up.
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
    """Where the solids of a world are that can be elsewhere.

    Attributes:
        loose: Numbers in qpos of bodies that lie loose or hang on hinges (..., n).
        geoms: Position, orientation and size of the geoms that are data (..., geoms, 10).
    """

    loose: Array
    geoms: Array


@dataclass(frozen=True, eq=False)
class MovableSolids:
    """The solids of a model that can be elsewhere.

    Attributes:
        loose: Where in qpos bodies are that lie loose or hang on hinges (n,).
        places: Which of `GeomPoses` touch (geoms,).
        size: Their sizes in the model [m] (geoms, 3).
        origin: Where the bodies are that they are fixed to [m] (geoms, 3).
        turn: How these are turned (geoms, 3, 3).
    """

    loose: np.ndarray
    places: np.ndarray
    size: np.ndarray
    origin: np.ndarray
    turn: np.ndarray

    def where(self, qpos: Array, poses: GeomPoses | None) -> SolidPlacement:
        """Return where they are in one world; geoms of which nothing is told are at zero.

        Args:
            qpos: Positions (nq,).
            poses: Where the geoms are that are data.
        """
        loose, count = qpos[self.loose], len(self.places)
        if poses is None or not count:
            return SolidPlacement(loose=loose, geoms=jnp.zeros((count, 10)))
        size = jnp.asarray(self.size, jnp.float32) if poses.size is None else poses.size[self.places]
        parts = poses.pos[self.places], poses.quat[self.places], size
        return SolidPlacement(loose=loose, geoms=jnp.concatenate(parts, -1))

    def came_near(self, then: Array, now: Array, prints: Footprints, reach: Array) -> Array:
        """Return whether geoms of one world have moved that are near a robot now, or were ().

        Args:
            then: Position, orientation and size of the geoms that are data (geoms, 10).
            now: The same now.
            prints: The robots.
            reach: What is no farther from a circle around a robot is near [m] (robots,).
        """
        moved = (then != now).any(-1)
        x, y = prints.pos[:, :1], prints.pos[:, 1:]
        out = jnp.linalg.norm(prints.half, axis=-1) + reach
        near = jnp.zeros((len(out), len(moved)), bool)
        for geoms in (then, now):
            at = self.origin + matvec(jnp.asarray(self.turn, jnp.float32), geoms[:, :3])
            # No geom is larger than all of its numbers together.
            far = out[:, None] + geoms[:, 7:].sum(-1)
            near |= (x - at[:, 0]) ** 2 + (y - at[:, 1]) ** 2 < far * far
        return (near & moved).any()


def movable_solids(model: mujoco.MjModel, fixed: FixedBodies, geoms: SolidGeoms) -> MovableSolids:
    """Return the solids that can be elsewhere.

    Args:
        model: The model.
        fixed: Its bodies that are no robot's.
        geoms: Those of its geoms that touch and can be elsewhere.
    """
    data = geoms.moved >= 0
    ids, bodies = geoms.ids[data], geoms.bodies[data]
    return MovableSolids(
        loose=np.concatenate([fixed.free_qpos.reshape(-1), fixed.hinge_qpos]),
        places=geoms.moved[data],
        size=model.geom_size[ids],
        origin=fixed.pos[bodies].astype(np.float32),
        turn=fixed.mat[bodies],
    )
